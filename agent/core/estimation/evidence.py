"""Robots exchange what each has measured, not what each believes; every robot draws the conclusion for itself.

Beliefs that are averaged lose their origin: a sample counted twice, a robot that is wrong, a restart cannot be told
any more. Here each robot's samples travel under its name: as a sum while the target rests (static_target,
evidence_table), one by one while it moves (moving_target, window). Any robot passes them on, with or without a view of
its own, until the neighbour shows that it holds them (delivery_ledger). The posterior is a function of what is held
(fuse, track): equal tables give equal posteriors, on every robot, to the last bit.

The posterior is concluded when it is read, and again only after news: what arrived since the last iteration counts as
soon as somebody asks. `Update.explain` tells of the conclusion at the iteration itself.

A target that starts or stops moving opens a new epoch, on the word of two robots (epoch_vote). It empties the table:
nothing measured before the change is mixed with what came after, except the newest samples of each robot, which it
brings along.

A robot that is doubted by all others, or that alone saw the target move, was probably knocked: it begins a new
incarnation of its entry, which owes nothing to the one before.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from functools import partial

from msgspec.structs import replace

from agent.core.authority import HEARSAY, Authority, Verify
from agent.core.epoch_vote import EpochVote, epoch_of
from agent.core.estimation.dynamics import ROLLING, Dynamics
from agent.core.estimation.evidence_checks import Bounds
from agent.core.estimation.interface import NOTHING, Bearing, Posterior, Prior, Update, Word
from agent.core.estimation.mailbox import Mailbox
from agent.core.estimation.mode import Me, Mode
from agent.core.estimation.motion import Motion
from agent.core.estimation.moving_target import MovingTarget
from agent.core.estimation.static_target import StaticTarget
from agent.core.estimation.window import WINDOW
from agent.core.letters import Letter
from agent.core.messages import Epoch, Estimate, Gossip, Proposal, Symmetric
from agent.core.savepoint import Revertible
from agent.core.signed import proposal_bytes, verify

CARRIED = 8  # own samples that a new epoch begins with: fewer than it takes to notice a motion
ENTRIES = 14  # in one message: two datagrams, and all there is in a swarm of that size
DOUBTED = 10  # iterations in a row, after which a robot begins anew
ANEW_NS = 10_000_000_000  # and not again before this


class Evidence(Revertible):
    """State of one robot for one target. `incarnation` must differ from that of every earlier start.

    subject: fleet and target, as they are signed. verify: how signatures are checked. dynamics: of the target; where it
    swims, which a fleet file says, it moves from the first epoch on, and nobody asks whether it rests.
    """

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
        subject: tuple[str, str] = ("", ""),
        verify: Verify = verify,
        dynamics: Dynamics = ROLLING,
    ) -> None:
        self._authority = Authority(neighbours, verify)
        key = (me, incarnation)
        self._me = Me(key, neighbours, bounds, max_entries, common_m2, self._authority, subject, liars, dynamics)
        self._validity_ns = validity_ns
        self.t = 0
        self.valid = False
        self._believed: Posterior | None = None
        self._now_ns = 0  # the latest moment that we were told of
        self._stale = False  # something came in since `_believed` was concluded
        self._measured = 0  # own samples of this incarnation
        self._recent: deque[tuple[int, Prior | Bearing]] = deque(maxlen=CARRIED)
        self._starts: dict[str, int] = {}  # the incarnation of each neighbour
        self._swims = math.isfinite(dynamics.turn_s)
        self.epoch = epoch_of(1) if self._swims else Epoch()
        self._vote = EpochVote(me)
        self._motion = Motion()
        self._doubted = 0  # iterations in a row
        self._anew_ns = 0  # when we last began anew
        self._mode: Mode = self._mode_of(self.epoch)

    @property
    def posterior(self) -> Posterior | None:
        """x by all that is held now; of a target that moves, where it is at the latest moment we were told of."""
        if self._stale:
            self._believed = self._mode.conclude(self.valid, self._believed, self._now_ns).posterior
            self._stale = False
        return self._believed

    def by_others(self) -> Posterior | None:
        return self._mode.by_others()

    def trust(self, keys: Mapping[str, bytes]) -> None:
        """Public keys, as they are from now on: who lost or changed his is believed no more, from this moment."""
        before, self._authority.keys = self._authority.keys, dict(keys)
        known = self._me.bounds.origins if before is None else before.keys()
        if gone := {name for name in known if before is None or before[name] != keys.get(name)}:
            self._mode.distrust(gone)
            self._stale = True

    def adopt(self, t: int) -> None:
        if t > self.t + 1:  # see Paper.adopt
            self.t = t - 1

    def hear(self, letter: Letter[Estimate]) -> tuple[str, ...]:
        said, src = letter.message, letter.message.src
        self._authority.heard(src, letter.arrived_ns)
        if self._starts.get(src, said.incarnation) != said.incarnation:
            self._mode.restarted(src)
        self._starts[src] = said.incarnation
        if said.gossip is None:
            return ()
        faults = self._hear_epochs(src, said.gossip, letter.arrived_ns)
        if said.gossip.epoch.counter != self.epoch.counter:
            return faults  # our next message tells the sender of ours, or comes its witnesses to us
        self._pass(letter.arrived_ns)
        self._stale |= bool(said.gossip.entries or said.gossip.samples)
        return (*faults, *self._mode.hear(src, said.gossip, letter.arrived_ns - letter.late_ns))

    def _hear_epochs(self, src: str, gossip: Gossip, now_ns: int) -> tuple[str, ...]:
        """Which epoch a neighbour is in, and who wants another."""
        faults = []
        for proposal in gossip.proposals:
            if proposal.proposer == self._me.key[0] or not self._vote.is_news(proposal, self.epoch):
                continue
            fault = self._proposal_fault(src, proposal, now_ns)
            if fault is None:
                self._vote.hear(proposal, now_ns)
            elif fault != HEARSAY:
                faults.append(fault)
        self._vote.neighbour(src, gossip.epoch, now_ns)
        self._follow(now_ns)
        return tuple(faults)

    def _proposal_fault(self, src: str, proposal: Proposal, now_ns: int) -> str | None:
        if proposal.proposer not in self._me.bounds.origins:
            return "unknown origin"
        says = partial(proposal_bytes, *self._me.subject, proposal)
        return self._authority.fault(src, proposal.proposer, proposal.signature, says, now_ns)

    def tick(self, prior: Prior | Bearing | None, mailbox: Mailbox, now_ns: int) -> Update:
        self.valid = prior is not None
        self._pass(now_ns)
        self._outlive(now_ns)
        if prior is not None:
            self._measured += 1
            innovation = self._mode.add(self._measured, prior, now_ns)
            self._recent.append((self._measured, prior))
            if innovation is not None:
                self._motion.sample(innovation)
            if self._motion.moves and not self.epoch.moving:
                self._vote.propose(self.epoch, now_ns)
        concluded = self._mode.conclude(self.valid, self._believed, now_ns)
        self._believed, self._stale = concluded.posterior, False
        if self.epoch.moving and not self._swims and self._believed is not None:
            self._motion.place(now_ns, self._believed.x_m)
            if self._motion.rests(now_ns):
                self._vote.propose(self.epoch, now_ns)
        self._look_at_oneself(self.valid and concluded.doubts_itself, now_ns)
        self._follow(now_ns)
        self.t += 1
        used = tuple(name for name, _ in mailbox.usable(now_ns, self._validity_ns))
        explain = replace(concluded.explain, ages_s=mailbox.ages_s(now_ns))
        return Update(self.t, concluded.rule, concluded.alpha, used, explain)

    def say(self, to: str, now_ns: int) -> Word:
        self._pass(now_ns)
        x_m, cov_m2 = self.posterior[:2] if self.posterior else (None, None)
        gossip = replace(self._mode.say(to, now_ns), proposals=self._vote.shown(now_ns))
        return Word(x_m, cov_m2, gossip=gossip)

    def _pass(self, now_ns: int) -> None:
        """Time goes on: a target that moves is elsewhere by now."""
        if now_ns > self._now_ns:
            self._now_ns = now_ns
            self._stale |= self.epoch.moving

    def _look_at_oneself(self, doubted: bool, now_ns: int) -> None:
        """Begin anew when all others think that we are wrong, or nobody else saw what we saw."""
        self._doubted = self._doubted + 1 if doubted else 0
        alone = self._vote.unseconded(self.epoch, now_ns)
        if alone:
            self._motion = Motion()
        if (alone and not self.epoch.moving) or self._doubted >= DOUBTED:
            self._begin_anew(now_ns)

    def _outlive(self, now_ns: int) -> None:
        """An earlier life of ours is dated later than this one: our clock was set back."""
        outlived = self._mode.outlived
        if outlived is not None and outlived >= self._me.key[1] and now_ns - self._anew_ns >= ANEW_NS:
            self._begin_anew(max(now_ns, outlived + 1))
            self._anew_ns = now_ns

    def _begin_anew(self, incarnation: int) -> None:
        """From now on our samples count under another incarnation; those before it stay, as far as they agree."""
        self._doubted, self._measured = 0, 0
        self._recent.clear()
        self._me = self._me._replace(key=(self._me.key[0], max(incarnation, self._me.key[1] + 1)))
        self._mode.began(self._me)

    def _follow(self, now_ns: int) -> None:
        """Begin the epoch that enough robots witness."""
        if (epoch := self._vote.next(self.epoch, self._mode.seeing(now_ns), now_ns)) is not None:
            self.begin(epoch, now_ns)

    def begin(self, epoch: Epoch, now_ns: int) -> None:
        """A new epoch begins, with the newest own samples."""
        self.epoch, self._motion, self._stale = epoch, Motion(), True
        self._vote.begin(epoch, now_ns)
        self._mode = self._mode_of(epoch)
        oldest_ns = now_ns - WINDOW * self._me.bounds.iteration_ns
        for number, prior in self._recent:
            if prior.t_ns > oldest_ns:
                self._mode.add(number, prior, now_ns)

    def _mode_of(self, epoch: Epoch) -> Mode:
        return MovingTarget(self._me, epoch) if epoch.moving else StaticTarget(self._me, epoch)
