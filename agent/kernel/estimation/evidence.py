"""Robots exchange what each has measured, not what each believes; every robot draws the conclusion for itself.

Beliefs that are averaged lose their origin: a sample counted twice, a robot that is wrong, a restart cannot be told
any more. Here each robot's samples travel under its name: as a sum while the target rests (static_target,
evidence_table), one by one while it moves (moving_target, window). Any robot passes them on, with or without a view of
its own, until the neighbour shows that it holds them (delivery_ledger). The posterior is a function of what is held
(fuse, track): equal tables give equal posteriors, on every robot, to the last bit.

The posterior is concluded when it is read, and again only after news: what arrived since the last iteration counts as
soon as somebody asks. `Update.explain` tells of the conclusion at the iteration itself.

A target that starts or stops moving opens a new epoch. The larger epoch wins and empties the table: nothing measured
before the change is mixed with what came after, except the newest samples of each robot, which it brings along.
"""

from __future__ import annotations

from collections import deque

from msgspec.structs import replace

from agent.kernel.estimation.evidence_checks import Bounds
from agent.kernel.estimation.interface import NOTHING, Posterior, Prior, Update, Word
from agent.kernel.estimation.mailbox import Letter, Mailbox
from agent.kernel.estimation.mode import Me, Mode
from agent.kernel.estimation.motion import Motion
from agent.kernel.estimation.moving_target import MovingTarget
from agent.kernel.estimation.static_target import StaticTarget
from agent.kernel.estimation.window import WINDOW
from agent.kernel.messages import Epoch, Symmetric

CARRIED = 8  # own samples that a new epoch begins with: fewer than it takes to notice a motion
ENTRIES = 14  # in one message: two datagrams, and all there is in a swarm of that size


class Evidence:
    """State of one robot for one target. `incarnation` must differ from that of every earlier start."""

    def __init__(
        self,
        me: str,
        incarnation: int,
        neighbours: tuple[str, ...],
        validity_ns: int,
        bounds: Bounds,
        max_entries: int = ENTRIES,
        common_m2: Symmetric = NOTHING,
        liars: int = 1,
    ) -> None:
        self._me = Me((me, incarnation), neighbours, bounds, max_entries, common_m2, liars)
        self._validity_ns = validity_ns
        self.t = 0
        self.valid = False
        self._believed: Posterior | None = None
        self._now_ns = 0  # the latest moment that we were told of
        self._stale = False  # something came in since `_believed` was concluded
        self._measured = 0  # own samples since the start
        self._recent: deque[tuple[int, Prior]] = deque(maxlen=CARRIED)
        self._starts: dict[str, int] = {}  # the incarnation of each neighbour
        self.epoch = Epoch()
        self._motion = Motion()
        self._mode: Mode = StaticTarget(self._me, self.epoch)

    @property
    def posterior(self) -> Posterior | None:
        """x by all that is held now; of a target that moves, where it is at the latest moment we were told of."""
        if self._stale:
            self._believed = self._mode.conclude(self.valid, self._believed, self._now_ns).posterior
            self._stale = False
        return self._believed

    def adopt(self, t: int) -> None:
        if t > self.t + 1:  # see Paper.adopt
            self.t = t - 1

    def hear(self, letter: Letter) -> tuple[str, ...]:
        said, src = letter.estimate, letter.estimate.src
        if self._starts.get(src, said.incarnation) != said.incarnation:
            self._mode.restarted(src)
        self._starts[src] = said.incarnation
        if said.gossip is None:
            return ()
        epoch = said.gossip.epoch
        if epoch.counter > 0 and epoch.proposer not in self._me.bounds.origins:
            return ("unknown origin",)
        if epoch > self.epoch:
            self.begin(epoch, letter.arrived_ns)
        if epoch < self.epoch:
            return ()  # our next message tells the sender of the newer epoch
        self._pass(letter.arrived_ns)
        self._stale |= bool(said.gossip.entries or said.gossip.samples)
        return tuple(self._mode.hear(src, said.gossip, letter.arrived_ns - letter.late_ns))

    def tick(self, prior: Prior | None, mailbox: Mailbox, now_ns: int) -> Update:
        self.valid = prior is not None
        self._pass(now_ns)
        if prior is not None:
            self._measured += 1
            nis = self._mode.add(self._measured, prior, now_ns)
            self._recent.append((self._measured, prior))
            if nis is not None:
                self._motion.sample(nis)
            if self._motion.moves and not self.epoch.moving:
                self.begin(Epoch(self.epoch.counter + 1, True, self._me.key[0]), now_ns)
        self._believed, rule, alpha, explain = self._mode.conclude(self.valid, self._believed, now_ns)
        self._stale = False
        if self.epoch.moving and self._believed is not None:
            self._motion.place(now_ns, self._believed.x_m)
            if self._motion.rests(now_ns):
                self.begin(Epoch(self.epoch.counter + 1, False, self._me.key[0]), now_ns)
        self.t += 1
        used = tuple(name for name, _ in mailbox.usable(now_ns, self._validity_ns))
        return Update(self.t, rule, alpha, used, replace(explain, ages_s=mailbox.ages_s(now_ns)))

    def say(self, to: str, now_ns: int) -> Word:
        self._pass(now_ns)
        x_m, cov_m2 = self.posterior or (None, None)
        return Word(x_m, cov_m2, gossip=self._mode.say(to, now_ns))

    def _pass(self, now_ns: int) -> None:
        """Time goes on: a target that moves is elsewhere by now."""
        if now_ns > self._now_ns:
            self._now_ns = now_ns
            self._stale |= self.epoch.moving

    def begin(self, epoch: Epoch, now_ns: int) -> None:
        """A new epoch begins, with the newest own samples."""
        self.epoch, self._motion = epoch, Motion()
        self._mode = MovingTarget(self._me, epoch) if epoch.moving else StaticTarget(self._me, epoch)
        oldest_ns = now_ns - WINDOW * self._me.bounds.iteration_ns
        for number, prior in self._recent:
            if prior.t_ns > oldest_ns:
                self._mode.add(number, prior, now_ns)
