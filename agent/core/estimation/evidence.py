"""Robots exchange what each has measured, not what each believes; every robot draws the conclusion for itself.

Beliefs that are averaged lose their origin: a sample counted twice, a robot that is wrong, a restart cannot be told
apart any more. Here each robot's samples travel under its name: as a sum while the target rests (`StaticTarget`,
`Table`), one by one while it moves (`MovingTarget`, `Window`). Any robot passes them on, with or without a view of its
own, until the neighbour shows that it holds them (`DeliveryLedger`). The posterior is a function of what is held
(`fuse`, `Track`): equal tables give equal posteriors, on every robot, to the last bit.

The posterior is concluded when it is read, and again only after news: what arrived since the last iteration counts at
the next reading. `Update.explain` tells of the conclusion at the iteration itself.

A target that starts or stops moving opens a new epoch, on the word of two robots (`EpochVote`). It empties the table:
nothing measured before the change is mixed with what came after, except the newest samples of each robot, which it
brings along.

A robot that is doubted by all others, or that alone saw the target move, was probably knocked: it begins a new
incarnation of its entry, which is independent of the one before.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping
from functools import partial

from msgspec.structs import replace

from agent.core.estimation.evidence_table import NOTHING_M2, Bounds, Key, Table, entry_fault, floored, mark
from agent.core.estimation.fuse import NONE, Fused, Shared, fuse, parts, stretch
from agent.core.estimation.interface import Bearing, EstimateCache, Posterior, Prior, Update, Word
from agent.core.estimation.modes import Conclusion, DeliveryLedger, Links, Me, Mode, outliving
from agent.core.estimation.motion import Innovation, Motion
from agent.core.estimation.moving_target import WINDOW, MovingTarget, unseen
from agent.core.estimation.track import ROLLING, Dynamics, outer
from agent.core.linear_algebra import (
    apply,
    difference,
    distance2,
    inverse,
    minus,
    plus,
    semidefinite,
    times,
    trace,
)
from agent.core.link_clocks import Way
from agent.core.messages import Entry, Epoch, Estimate, Explain, Gossip, Holding, Proposal, Vector
from agent.core.step_transaction import Revertible
from agent.core.trust import (
    HEARSAY,
    WITNESSES,
    Authority,
    CachedMessage,
    EpochVote,
    Verify,
    entry_bytes,
    epoch_of,
    proposal_bytes,
    verify_signature,
)

CARRIED = 8  # own samples that a new epoch begins with: fewer than it takes to notice a motion
ENTRIES = 14  # in one message: two datagrams, and all there is in a swarm of that size
DOUBTED = 10  # iterations in a row, after which a robot begins anew
ANEW_NS = 10_000_000_000  # and not again before this
ODD = 30.0  # NIS of an own sample, 3 degrees of freedom, beyond which the target may have moved: one in a million
HEDGE = 1.0 / 3.0  # of D D', what a step D that is not settled adds: NEES is 6 at most, whichever is true


class Evidence(Revertible):
    """State of one robot for one target. `incarnation` must differ from that of every earlier start.

    subject: fleet and target, as they are signed. verify: how signatures are checked. dynamics: of the target; one
    that swims by the fleet file moves from the first epoch on, and no robot tests whether it rests. links: of all
    robots, so that none passes on what a neighbour was told by the same robot.
    """

    def __init__(
        self,
        me: str,
        incarnation: int,
        neighbours: tuple[str, ...],
        validity_ns: int,
        bounds: Bounds,
        max_entries: int = ENTRIES,
        shared: Shared = NONE,
        liars: int = 1,
        subject: tuple[str, str] = ("", ""),
        verify: Verify = verify_signature,
        dynamics: Dynamics = ROLLING,
        links: Links = frozenset(),
    ) -> None:
        self._authority = Authority(neighbours, verify)
        key = (me, incarnation)
        self._me = Me(key, neighbours, bounds, max_entries, shared, self._authority, subject, liars, dynamics, links)
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
        self._odd_m: Vector | None = None  # the step of our newest sample, where it is hardly of the same place
        self._changed_ns = 0  # since when our samples are of the new place, as far as we know
        self._alone = False  # in an epoch that one robot's word began, and no other has measured in
        self._step_m: Vector | None = None  # by which the target may have moved: not settled yet
        self._doubted = 0  # iterations in a row
        self._anew_ns = 0  # when we last began anew
        self._mode: Mode = self._mode_of(self.epoch)

    @property
    def posterior(self) -> Posterior | None:
        """x by all that is held now; of a target that moves, where it is at the latest moment we were told of."""
        if self._stale:
            self._believed = self._mode.conclude(self.valid, self._believed, self._now_ns).posterior
            self._stale = False
        return self._hedged(self._believed)

    def trust(self, keys: Mapping[str, bytes]) -> None:
        """Take over public keys. A robot that lost or changed its key is believed no more, from this moment."""
        before = self._authority.replace_keys(keys)
        known = self._me.bounds.origins if before is None else before.keys()
        if gone := {name for name in known if before is None or before[name] != keys.get(name)}:
            self._mode.distrust(gone)
            self._stale = True

    def adopt(self, t: int) -> None:
        if t > self.t + 1:  # see Paper.adopt
            self.t = t - 1

    def hear(self, letter: CachedMessage[Estimate]) -> tuple[str, ...]:
        said, src = letter.message, letter.message.src
        self._authority.heard(src, letter.arrived_ns)
        if self._starts.get(src, said.incarnation) != said.incarnation:
            self._mode.restarted(src)
        self._starts[src] = said.incarnation
        if said.gossip is None:
            return ()
        faults = self._hear_epochs(src, said.gossip, letter.arrived_ns)
        if said.gossip.epoch.counter != self.epoch.counter:
            return faults  # our next message tells it of our epoch, or its next one brings us the proposals
        self._pass(letter.arrived_ns)
        self._stale |= bool(said.gossip.entries or said.gossip.samples)
        return (*faults, *self._mode.hear(src, said.gossip, letter.arrived_ns, letter.way))

    def _hear_epochs(self, src: str, gossip: Gossip, now_ns: int) -> tuple[str, ...]:
        """Which epoch a neighbour is in, and which robots propose another."""
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
        self._step_m = self._unsettled(now_ns)
        return tuple(faults)

    def _proposal_fault(self, src: str, proposal: Proposal, now_ns: int) -> str | None:
        if proposal.proposer not in self._me.bounds.origins:
            return "unknown origin"
        says = partial(proposal_bytes, *self._me.subject, proposal)
        return self._authority.fault(src, proposal.proposer, proposal.signature, says, now_ns)

    def tick(self, prior: Prior | Bearing | None, cache: EstimateCache, now_ns: int) -> Update:
        self.valid = prior is not None
        self._pass(now_ns)
        self._outlive(now_ns)
        if prior is not None:
            self._measured += 1
            innovation = self._mode.add(self._measured, prior, now_ns)
            self._recent.append((self._measured, prior))
            self._notice(prior, innovation, now_ns)
        concluded = self._mode.conclude(self.valid, self._believed, now_ns)
        self._believed, self._stale = concluded.posterior, False
        if self.epoch.moving and not self._swims and self._believed is not None:
            self._motion.place(now_ns, self._believed.x_m)
            if self._motion.rests(now_ns):
                self._vote.propose(self.epoch, now_ns)
        self._look_at_oneself(self.valid and concluded.doubts_itself, now_ns)
        self._follow(now_ns)
        self._step_m = self._unsettled(now_ns)
        self.t += 1
        used = tuple(name for name, _ in cache.usable(now_ns, self._validity_ns))
        explain = replace(concluded.explain, ages_s=cache.ages_s(now_ns), moved_m=self._step_m)
        return Update(self.t, concluded.rule, concluded.alpha, used, explain)

    def _notice(self, prior: Prior | Bearing, innovation: Innovation | None, now_ns: int) -> None:
        """Whether the target moved, by our newest sample and those before it; and what we say to another's word."""
        if self.epoch.moving:
            if innovation is not None:
                self._motion.tracked(innovation)
        elif isinstance(prior, Prior):
            self._odd_m = innovation.step_m if innovation is not None and innovation.nis > ODD else None
            moved, told = self._motion.rested(prior), self._vote.pending(self.epoch, now_ns)
            if moved is not None:
                self._vote.propose(self.epoch, now_ns, moved.step_m)
                self._changed_ns = moved.since_ns
            elif told is not None and told.proposal.step_m is not None and told.proposal.proposer != self._me.key[0]:
                seconds = self._motion.judge(told.proposal.step_m, told.heard_ns)
                if seconds is not None:
                    self._vote.propose(self.epoch, now_ns, told.proposal.step_m, against=not seconds)

    def _unsettled(self, now_ns: int) -> Vector | None:
        """By how much the target may have moved, as long as nobody can know: by a word that is neither seconded nor
        refuted, by our newest sample, or by the word of one robot alone."""
        told = self._vote.pending(self.epoch, now_ns)
        if told is not None:
            return told.proposal.step_m
        if self._odd_m is not None:
            return self._odd_m
        words = [each.step_m for each in self._vote.witnesses if each.step_m is not None]
        measured = len(self._mode.measured_ns())
        self._alone = self._alone and measured < WITNESSES and not (measured and len(words) >= WITNESSES)
        return words[0] if self._alone and words else None

    def _hedged(self, believed: Posterior | None) -> Posterior | None:
        """What we believe, as wide as it has to be: for the target is not seen, or may have moved."""
        if believed is None:
            return None
        if believed.t_ns:
            believed = unseen(believed, self._me.dynamics, self._me.bounds.tank_m, self._now_ns)
        if self._step_m is None:
            return believed
        return believed._replace(cov_m2=plus(believed.cov_m2, times(HEDGE, outer(self._step_m))))

    def news(self, to: str) -> bool:
        return self._mode.news(to)

    def say(self, to: str, now_ns: int, between: bool = False) -> Word:
        self._pass(now_ns)
        # Between two rounds what was concluded last will do: to conclude takes longer than to pass on.
        believed = self._hedged(self._believed) if between else self.posterior
        x_m, cov_m2 = believed[:2] if believed else (None, None)
        gossip = replace(self._mode.say(to, now_ns, between), proposals=self._vote.shown(now_ns))
        return Word(x_m, cov_m2, gossip=gossip)

    def _pass(self, now_ns: int) -> None:
        """Take note of the time: a target that moves is elsewhere by now."""
        if now_ns > self._now_ns:
            self._now_ns = now_ns
            self._stale |= self.epoch.moving

    def _look_at_oneself(self, doubted: bool, now_ns: int) -> None:
        """Begin anew when all others find that we are wrong, or no other robot saw what we saw."""
        self._doubted = self._doubted + 1 if doubted else 0
        alone = self._vote.unseconded(self.epoch, now_ns)
        if alone:
            self._motion, self._odd_m = Motion(), None
        if (alone and not self.epoch.moving) or self._doubted >= DOUBTED:
            self._begin_anew(now_ns)

    def _outlive(self, now_ns: int) -> None:
        """Begin anew where an earlier start of ours is dated later than this one: our clock was set back."""
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
        """Begin the epoch that enough robots propose or are in."""
        if (epoch := self._vote.next(self.epoch, self._mode.measured_ns(), now_ns)) is not None:
            self.begin(epoch, now_ns)

    def begin(self, epoch: Epoch, now_ns: int) -> None:
        """A new epoch begins, with the newest own samples: of a target that moved, those since it did."""
        told, changed_ns = self._vote.pending(self.epoch, now_ns), self._changed_ns
        if told is not None and not changed_ns:
            changed_ns = told.heard_ns
        self.epoch, self._motion, self._stale = epoch, Motion(), True
        self._odd_m, self._changed_ns, self._alone = None, 0, True
        self._vote.begin(epoch, now_ns)
        self._mode = self._mode_of(epoch)
        oldest_ns = max(now_ns - WINDOW * self._me.bounds.iteration_ns, changed_ns if epoch.moving else 0)
        for number, prior in self._recent:
            if prior.t_ns >= oldest_ns:
                self._mode.add(number, prior, now_ns)

    def _mode_of(self, epoch: Epoch) -> Mode:
        return MovingTarget(self._me, epoch) if epoch.moving else StaticTarget(self._me, epoch)


# --- target at rest ---
# Sums of samples are passed on, and the posterior is their robust mean.

LET_GO_NS = 10_000_000_000  # for so long neighbours are told that an entry is here no more, and may send a better one


class StaticTarget(Revertible):
    """One robot's table in one epoch, and what its neighbours hold of it."""

    def __init__(self, me: Me, epoch: Epoch) -> None:
        self._me, self._epoch = me, epoch
        self._table = Table(me.shared)
        self._ledgers: dict[str, DeliveryLedger[Key]] = {name: DeliveryLedger() for name in me.neighbours}
        self._change = 0
        self._news_ns: dict[str, int] = {}  # when each origin was last known to have measured
        self._cleaned = 0  # removals from the table that the ledgers know of
        self._let_go: dict[Key, int] = {}  # until when neighbours are told so
        self.outlived: int | None = None  # an incarnation of ours that is newer than the one we write under
        self._gain = 0.0  # share of the newest own sample in the own sum
        self._nis: float | None = None

    def add(self, number: int, prior: Prior | Bearing, now_ns: int) -> Innovation | None:
        """Take in an own sample. Returns its innovation against the own samples before it."""
        before = self._table.entries.get(self._me.key)
        information = self._table.measure(self._me.key, prior)
        self._gain = trace(information) / trace(self._table.entries[self._me.key].information)
        self._changed(self._me.key, "")
        self._news_ns[self._me.key[0]] = now_ns
        random = None if before is None else inverse(before.information)
        self._nis = None
        if before is None or random is None or not isinstance(prior, Prior):
            return None
        step, covariance = difference(prior.x_m, apply(random, before.vector)), plus(random, floored(prior.random_m2))
        # By so much at most what is wrong of this robot is another by now: it never falls as sensors warm up.
        grown = minus(prior.systematic_m2, before.systematic_m2)
        covariance = plus(covariance, grown) if semidefinite(grown, NOTHING_M2) else covariance
        self._nis = distance2(covariance, step)
        return Innovation(step, covariance, self._nis)

    def hear(self, src: str, gossip: Gossip, arrived_ns: int, way: Way | None) -> list[str]:
        faults, ledger, table = [], self._ledgers[src], self._table
        if self._me.authority.keys is None:  # a robot that speaks to us voids what others said in its name
            for key in [key for key in table.hearsay if key[0] == src]:
                self._drop(key, arrived_ns + LET_GO_NS)
        # Where the budget of a neighbour does not last, its own entries come first, then those of our other neighbours.
        for entry in sorted(gossip.entries, key=lambda e: (e.origin != src, e.origin not in self._ledgers)):
            key = (entry.origin, entry.incarnation)
            if table.is_news(entry):
                fault = self._fault(src, entry, arrived_ns)
                if fault is None:
                    fault = table.merge(entry, self._me.authority.keys is None and src != entry.origin)
                    self._changed(key, src)
                    self._let_go.pop(key, None)
                    self._news_ns[entry.origin] = arrived_ns
                if fault is not None and fault != HEARSAY:
                    faults.append(fault)
            self._acknowledge(ledger, key, entry.count, mark(entry))
        for line in gossip.digest:
            if line.origin == self._me.key[0] and self._me.authority.keys is None:  # which nobody tells us otherwise
                self.outlived = outliving(self.outlived, line.incarnation, self._me, arrived_ns)
            self._acknowledge(ledger, (line.origin, line.incarnation), line.newest, line.older)
        return faults

    def _acknowledge(self, ledger: DeliveryLedger[Key], key: Key, count: int, mark_: int) -> None:
        """A neighbour holds this. Where its entry is as new as ours but differs, it does not hold ours yet."""
        ours = self._table.entries.get(key)
        if ours is not None:
            ledger.acknowledge(key, count - (count == ours.count and mark_ != self._table.marks[key]))

    def _fault(self, src: str, entry: Entry, now_ns: int) -> str | None:
        """Why an entry that is news does not count."""
        authority, (me, incarnation) = self._me.authority, self._me.key
        if entry.origin == me and (entry.incarnation == incarnation or authority.keys is None):
            self.outlived = outliving(self.outlived, entry.incarnation, self._me, now_ns)
            return "own name"  # no other robot writes it, and without a signature no other can know what we wrote
        says = partial(entry_bytes, *self._me.subject, self._epoch, entry)
        fault = entry_fault(entry, self._me.bounds, now_ns)
        fault = fault or authority.fault(src, entry.origin, entry.signature, says, now_ns)
        if fault is None and entry.origin == me and entry.incarnation > incarnation:
            self.outlived = outliving(self.outlived, entry.incarnation, self._me, now_ns)
            return "own name"
        return fault

    def _drop(self, key: Key, until_ns: int) -> None:
        self._table.drop(key)
        self._let_go[key] = until_ns
        self._change += 1

    def began(self, me: Me) -> None:
        self._me, self.outlived = me, None

    def distrust(self, origins: Collection[str]) -> None:
        for key in [key for key in self._table.entries if key[0] in origins and key[0] != self._me.key[0]]:
            self._drop(key, 0)

    def measured_ns(self) -> Mapping[str, int]:
        return self._news_ns

    def restarted(self, src: str) -> None:
        self._ledgers[src].forget()

    def _changed(self, key: Key, src: str) -> None:
        """An entry is new here, by the word of src: news for all neighbours that src does not speak to itself. Of our
        own samples src is empty."""
        self._change += 1
        version, links = self._table.entries[key].count, self._me.links
        for name, ledger in self._ledgers.items():
            ledger.changed(key, version, told=name in (src, key[0]) or (src, name) in links)

    def news(self, to: str) -> bool:
        return bool(self._ledgers[to].news)

    def say(self, to: str, now_ns: int, between: bool = False) -> Gossip:
        entries, marks, ledger = self._table.entries, self._table.marks, self._ledgers[to]
        if self._cleaned != self._table.removed:
            self._cleaned = self._table.removed
            for each in self._ledgers.values():
                each.drop(entries)
        # Without signatures no robot is told what it measured itself.
        untold = None if self._me.authority.keys is not None else to
        told = ledger.news if between else entries
        owed = {key: entries[key].count for key in told if key[0] != untold}
        chosen = ledger.pending(owed, self._me.key, self._me.max_entries, between)
        if between:
            return Gossip(self._epoch, entries=tuple(entries[key] for key in chosen))
        self._let_go = {key: until_ns for key, until_ns in self._let_go.items() if until_ns > now_ns}
        keys = [*entries, *(key for key in self._let_go if key not in entries)]
        shown = keys[ledger.due(len(keys), self._change, now_ns)]
        digest = (
            Holding(*key, entries[key].count, marks[key]) if key in entries else Holding(*key, 0) for key in shown
        )
        return Gossip(self._epoch, entries=tuple(entries[key] for key in chosen), digest=tuple(digest))

    def conclude(self, valid: bool, before: Posterior | None, now_ns: int) -> Conclusion:
        opinions = self._table.opinions()
        fused = fuse(opinions, self._me.shared, self._me.liars)
        if fused is None:
            return Conclusion(before, "hold", 0.0, Explain(status="none", epoch=self._epoch))
        alpha = self._gain * fused.shares.get(self._me.key[0], 0.0) if valid else 0.0
        explain = Explain(
            status=fused.verdict,
            weights=fused.shares,
            votes=fused.votes,
            doubted={name: factor for name, factor in fused.factors.items() if factor < 1.0},
            epoch=self._epoch,
            nis=self._nis if valid else None,
            sway_m=fused.sway_m,
            stretch=stretch([o for o in opinions if fused.factors[o.origin] > 0.0], self._me.shared),
            parts_m2=parts([o for o in opinions if o.origin in fused.shares], self._me.shared),
        )
        if fused.verdict == "ambiguous":
            return Conclusion(self._alone(valid) or before or _agreed(fused), "ambiguous", alpha, explain)
        doubted = fused.factors.get(self._me.key[0], 1.0) < 0.5
        return Conclusion(_agreed(fused), "fuse", alpha, explain, doubted)

    def _alone(self, valid: bool) -> Posterior | None:
        """What our own samples say, while we see the target."""
        for opinion in self._table.opinions() if valid else ():
            if opinion.origin == self._me.key[0]:
                return Posterior(opinion.x_m, plus(opinion.cov_m2, self._me.shared.place_m2))
        return None


def _agreed(fused: Fused) -> Posterior:
    return Posterior(fused.x_m, fused.cov_m2)
