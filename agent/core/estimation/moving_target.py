"""The target moves: single samples are passed on with their ages, and the posterior is the track through them.

A robot that is wrong is found as at rest: each robot's own samples make a track of its own, the tracks vote (fuse.py),
and the agreed track runs over the samples of those that agree, raw as they came. Where one of these stands out, tracks
without it are mixed in as `fuse` mixes places. Tracks of one target share its accelerations, so they differ by less
than their covariances say, and vote and doubt are rather too patient than too strict.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from functools import partial
from statistics import median

from agent.core.estimation.evidence_table import Bounds, floored, inside, sample_fault
from agent.core.estimation.fuse import Ballot, Doubt, Opinion, distances2, doubts, mixture, vote
from agent.core.estimation.interface import Bearing, Posterior, Prior
from agent.core.estimation.modes import Conclusion, DeliveryLedger, Me, outliving
from agent.core.estimation.motion import Innovation
from agent.core.estimation.track import (
    Dynamics,
    FixedLagFilter,
    Held,
    Track,
    growth,
    image,
    nis,
    nis_of_bearing,
    outer,
    predict,
    product,
    square,
    symmetric_part,
)
from agent.core.linear_algebra import add, apply, difference, inverse, invert, minus, plus, times, trace
from agent.core.link_clocks import OriginClocks, Way
from agent.core.messages import Epoch, Explain, Gossip, Holding, Sample, Symmetric, Vector
from agent.core.step_transaction import Revertible
from agent.core.trust import HEARSAY, sample_bytes

# What is wrong in one robot's bearings, its own pose and where on a body it looks, is alike for as long as its track
# remembers: tracks of what swims stand farther apart than each says, by this factor of their covariance in the vote. In
# rendered dives none of three honest robots is left out from 1.5 on; at 1 it happens in up to one of twenty moments.
# The agreed track is surer than right by less, for what is alike in one robot's differs from another's: without the
# second factor the squared error was 2.1 to 5.8 of the 3 that are stated, on sixteen seeds. A dive in which the animal
# keeps away has the most.
ALIKE, AGREED = 2.0, 1.5
MATTERS = 0.02  # weight of a track without some robot, below which it is not worth running
SENT = 48  # samples in one message at most, 185 bytes each: half of what a message may hold


class MovingTarget(Revertible):
    """One robot's window of samples in one epoch, and what its neighbours hold of it."""

    def __init__(self, me: Me, epoch: Epoch) -> None:
        self._me, self._epoch = me, epoch
        self._filter = partial(FixedLagFilter, me.dynamics, me.bounds.tank_m)
        bearings = math.isfinite(me.dynamics.turn_s)  # else places, which say themselves what is alike in them
        self._alike, self._surer = (ALIKE, AGREED) if bearings else (1.0, 1.0)
        self._window = Window(me.bounds)
        self._ledgers: dict[str, DeliveryLedger[Key]] = {name: DeliveryLedger() for name in me.neighbours}
        self._change = 0
        self._agreed = self._filter()
        self._makers: frozenset[str] = frozenset()  # whose samples the agreed track was made of
        self._course: Track | None = None  # the agreed track as it was concluded last
        self._own: dict[str, FixedLagFilter] = {}
        self._mine: Track | None = None  # through our own samples alone
        self._nis: float | None = None
        self._newest: Held | None = None
        self.outlived: int | None = None

    def add(self, number: int, prior: Prior | Bearing, now_ns: int) -> Innovation | None:
        """Take in an own sample. Returns its innovation against the own track so far.

        A track remembers one or two samples of each robot at a sample a second, so the systematic error has no time to
        look as if it averaged out: random and systematic covariance count together. (Normalised error squared on the
        experiment's circle, with systematic errors: 2.7 for ten robots, 2.95 for three.) So does what the scale of all
        ranges makes of the lever.
        """
        if isinstance(prior, Bearing):
            self._add_bearing(number, prior)
            return None
        scale_m2 = self._me.shared.scale_m2(prior.lever_m)
        covariance = plus(plus(floored(prior.random_m2), prior.systematic_m2), scale_m2)
        information = inverse(covariance)
        if information is None:
            raise ValueError(f"covariance of the prior {covariance} is singular")
        innovation, self._nis = None, None
        if self._mine is not None:
            mine = predict(self._mine, prior.t_ns, self._me.dynamics)
            self._nis = nis(mine, prior.x_m, covariance)
            innovation = Innovation(difference(prior.x_m, mine.x_m), plus(mine.A, covariance), self._nis)
        self._measure(number, prior.x_m, information, prior.t_ns)
        return innovation

    def _add_bearing(self, number: int, bearing: Bearing) -> None:
        """Take in a bearing. It is no test of rest and motion: its innovation has fewer degrees of freedom."""
        self._nis = None
        if self._mine is not None:
            mine = predict(self._mine, bearing.t_ns, self._me.dynamics)
            self._nis = nis_of_bearing(mine, bearing.x_m, bearing.information)
        self._measure(number, bearing.x_m, bearing.information, bearing.t_ns)

    def _measure(self, number: int, x_m: Vector, information: Symmetric, t_ns: int) -> None:
        self._newest = Held(t_ns, information, apply(information, x_m), t_ns)
        self._window.measure((*self._me.key, number), self._newest)
        self._change += 1

    def hear(self, src: str, gossip: Gossip, arrived_ns: int, way: Way | None) -> list[str]:
        faults, ledger, samples = [], self._ledgers[src], self._window.samples
        # Samples whose age nobody knows are left, and come again with the first message that echoes a stamp of ours.
        timed = () if way is None else gossip.samples
        sent_ns, bound_ns = (arrived_ns, 0) if way is None else (arrived_ns - way.late_ns, way.bound_ns)
        for sample in sorted(timed, key=lambda s: (s.origin != src, s.origin not in self._ledgers)):
            key = (sample.origin, sample.incarnation, sample.number)
            if key in samples:
                self._window.earlier(sample, sent_ns)
                ledger.acknowledge(key, 1)
                continue
            fault = self._fault(src, sample, sent_ns)
            fault = fault or self._window.merge(sample, sent_ns, bound_ns, direct=src == sample.origin)
            if fault is None:
                ledger.acknowledge(key, 1)
                self._change += 1
            elif fault != HEARSAY:
                faults.append(fault)
        shown = {(line.origin, line.incarnation): line for line in gossip.digest}
        for key in samples:
            line = shown.get(key[:2])
            if line is not None:
                older = line.newest - 1 - key[2]
                ledger.acknowledge(key, int(older == -1 or (0 <= older < MASK and bool(line.older >> older & 1))))
        return faults

    def _fault(self, src: str, sample: Sample, now_ns: int) -> str | None:
        """Why a sample that we do not have does not count."""
        authority, own = self._me.authority, self._me.key
        if sample.origin == own[0] and (sample.incarnation >= own[1] or authority.keys is None):
            self.outlived = outliving(self.outlived, sample.incarnation, self._me, now_ns)
            return "own name"  # no other robot makes one; one of ours that we have let go is of no use any more
        says = partial(sample_bytes, *self._me.subject, self._epoch, sample)
        fault = self._window.fault(sample, now_ns)
        return fault or authority.fault(src, sample.origin, sample.signature, says, now_ns)

    def began(self, me: Me) -> None:
        self._me, self.outlived = me, None

    def distrust(self, origins: Collection[str]) -> None:
        self._window.drop(frozenset(origins) - {self._me.key[0]})
        for origin in origins:
            self._own.pop(origin, None)
        self._makers, self._agreed = frozenset(), self._filter()  # what they said is in the agreed track
        self._change += 1

    def measured_ns(self) -> Mapping[str, int]:
        found: dict[str, int] = {}
        for (origin, _, _), held in self._window.samples.items():
            found[origin] = max(held.t_ns, found.get(origin, held.t_ns))
        return found

    def restarted(self, src: str) -> None:
        self._ledgers[src].forget()

    def news(self, to: str) -> bool:
        return False  # what is pursued is spoken of as often as it is measured, all else in rounds

    def say(self, to: str, now_ns: int, between: bool = False) -> Gossip:
        ledger, signed = self._ledgers[to], self._me.authority.keys is not None
        owed = {key: 1 for key in self._window.sendable(now_ns) if signed or key[0] != to}
        chosen, lines = ledger.pending(owed, self._me.key, SENT), self._window.digest()
        return Gossip(
            self._epoch,
            samples=tuple(self._window.sample(key, now_ns) for key in chosen),
            digest=tuple(lines[ledger.due(len(lines), self._change, now_ns)]),
        )

    def conclude(self, valid: bool, before: Posterior | None, now_ns: int) -> Conclusion:
        fresh, horizon_ns = self._timed(self._window.fresh()), self._window.horizon_ns(now_ns)
        for ledger in self._ledgers.values():
            ledger.drop(self._window.samples)
        tracks = self._tracks(fresh, horizon_ns, now_ns)
        opinions = [Opinion(name, t.x_m, A, invert(A)) for name, t in tracks.items() for A in [times(self._alike, t.A)]]
        track, ballot, posterior, doubt = None, None, None, Doubt(0.0, [])
        if opinions:
            ballot = vote(opinions)
            track = self._agree(ballot, fresh, horizon_ns, now_ns)
            apart2 = distances2({name: track for name, track in tracks.items() if name in ballot.group})
            apart2 = {name: d2 / self._alike for name, d2 in apart2.items()}
            doubt = doubts([o for o in opinions if o.origin in ballot.group], self._me.liars, apart2)
        if track is not None and ballot is not None:
            posterior = _doubted(track, doubt, {n: fresh[n] for n in fresh if n in ballot.group}, self._filter, now_ns)
        self._window.freeze(horizon_ns)
        self._course = track or self._course
        believable = posterior is not None and inside(posterior.x_m, self._me.bounds.tank_m)
        if track is None or ballot is None or posterior is None or not believable:
            # Not seen for a whole window, or out of the tank: the last place is a better guess than an old speed.
            return Conclusion(before, "hold", 0.0, Explain(status="none", epoch=self._epoch))
        counted = doubt.factors([o for o in opinions if o.origin in ballot.group])
        factors = {o.origin: counted.get(o.origin, 0.0) for o in opinions}
        shares = _shares(fresh, {name: factor for name, factor in factors.items() if name in ballot.group})
        explain = Explain(
            status=ballot.verdict,
            weights=shares,
            votes=ballot.votes,
            doubted={name: factor for name, factor in factors.items() if factor < 1.0},
            epoch=self._epoch,
            nis=self._nis if valid else None,
            speed_m_s=math.sqrt(sum(v * v for v in track.v_m_s)),
        )
        alpha = factors[self._me.key[0]] * self._gain(track) if valid and self._me.key[0] in ballot.group else 0.0
        if ballot.verdict == "ambiguous":
            alone = _posterior(self._mine) if valid and self._mine is not None else before
            return Conclusion(alone or posterior, "ambiguous", alpha, explain)
        itself_m2 = times(self._surer, posterior.cov_m2)
        cov_m2 = plus(plus(itself_m2, _of_ways(track, fresh, shares)), self._me.shared.place_m2)
        return Conclusion(posterior._replace(cov_m2=cov_m2), "track", alpha, explain)

    def _timed(self, fresh: dict[str, list[Held]]) -> dict[str, list[Held]]:
        """Samples with what is not known of when they were taken. It weakens them here, and is never passed on."""
        v_m_s = (0.0, 0.0, 0.0) if self._course is None else self._course.v_m_s
        speed_m_s = 0.5 * self._me.dynamics.first_speed_m_s
        of_speed = plus(outer(v_m_s), times(speed_m_s * speed_m_s, self._me.dynamics.axes))
        return {name: [_blurred(held, of_speed) for held in of] for name, of in fresh.items()}

    def _tracks(self, fresh: dict[str, list[Held]], horizon_ns: int, now_ns: int) -> dict[str, Track]:
        """The track of each origin by its own samples alone, as of now."""
        self._own = {origin: self._own.get(origin, self._filter()) for origin in fresh}
        tracks = {origin: self._own[origin].run(held, horizon_ns, now_ns) for origin, held in fresh.items()}
        self._mine = tracks.get(self._me.key[0])
        return {name: track for name, track in tracks.items() if track is not None}

    def _agree(self, ballot: Ballot, fresh: dict[str, list[Held]], horizon_ns: int, now_ns: int) -> Track | None:
        """The track through the samples of those that agree. One made by others alone is not continued."""
        if not self._makers & ballot.group:
            self._agreed = self._filter()
        self._makers = ballot.group
        return self._agreed.run([h for name in fresh if name in ballot.group for h in fresh[name]], horizon_ns, now_ns)

    def _gain(self, track: Track) -> float:
        """Mean gain of the newest own sample: a third of the trace of P R^-1."""
        assert self._newest is not None
        a, b = track.A, self._newest.information
        return (a[0] * b[0] + a[3] * b[3] + a[5] * b[5] + 2.0 * (a[1] * b[1] + a[2] * b[2] + a[4] * b[4])) / 3.0


def unseen(believed: Posterior, dynamics: Dynamics, tank_m: Vector, now_ns: int) -> Posterior:
    """What is known at now_ns of where a target is that was last known at believed.t_ns: that place, and how far it can
    have gone since; nothing is assumed of its course, but that it is in the tank, in each axis anywhere alike."""
    h_s = (now_ns - believed.t_ns) * 1e-9
    if h_s <= 0.0:
        return believed
    reach_m, place_m2 = dynamics.first_speed_m_s * h_s, 0.0
    if math.isfinite(dynamics.turn_s):
        by = growth(dynamics, h_s)
        reach_m, place_m2 = by.reach_s * dynamics.first_speed_m_s, by.place_m2
    information = invert(plus(believed.cov_m2, times(place_m2 + reach_m * reach_m, dynamics.axes)))
    x, y, z = (12.0 / (size * size) for size in tank_m)
    covariance = invert(plus(information, (x, 0.0, 0.0, y, 0.0, z)))
    known = add(apply(information, believed.x_m), 1.0, (6.0 / tank_m[0], 6.0 / tank_m[1], 6.0 / tank_m[2]))
    return believed._replace(x_m=apply(covariance, known), cov_m2=covariance)


def _posterior(track: Track) -> Posterior:
    return Posterior(track.x_m, track.A, track.v_m_s, track.t_ns)


def _doubted(
    track: Track, doubt: Doubt, fresh: dict[str, list[Held]], new_filter: Callable[[], FixedLagFilter], now_ns: int
) -> Posterior:
    """The agreed track, and where a robot stands out the tracks without it, through what the window still holds.

    What is older than the window has faded, and a track of others cannot be taken out of it any more.
    """
    certain, places = 1.0, []
    for p, way in doubt.ways:
        weight = doubt.strength * p
        kept = [held for name in fresh if name not in way.out for held in fresh[name]] if weight > MATTERS else []
        other = new_filter().run(kept, now_ns, now_ns)
        if other is not None:
            certain -= weight
            places.append((weight, other.x_m, other.A))
    if not places:
        return _posterior(track)
    return Posterior(*mixture([(certain, track.x_m, track.A), *places]), track.v_m_s, track.t_ns)


# When a sample was taken is not known exactly, and where the target was then as little as it is fast. The ways of
# messages are as wrong in one sample as in the next, so this weakens each sample, and widens what is concluded of all.

SHORT_M = 0.0005  # no sample is made weaker for less


def _blurred(held: Held, of_speed: Symmetric) -> Held:
    """The sample with covariance R + tau^2 M, tau^2 = unsure^2 / 3: L' = L - L (L + (tau^2 M)^-1)^-1 L, for lines too.

    of_speed: M, m^2/s^2: the square of the speed as it is believed, and a part of what it may be.
    """
    m2 = times((held.unsure_ns * 1e-9) ** 2 / 3.0, of_speed)
    if trace(m2) < SHORT_M * SHORT_M:
        return held
    L = held.information
    taken = product(square(L), square(invert(plus(L, invert(m2)))))  # L (L + (tau^2 M)^-1)^-1
    x, y, z = image(taken, held.vector)
    vx, vy, vz = held.vector
    information = minus(L, symmetric_part(product(taken, square(L))))
    return held._replace(information=information, vector=(vx - x, vy - y, vz - z))


def _of_ways(track: Track, fresh: dict[str, list[Held]], shares: dict[str, float]) -> Symmetric:
    """What the ways of all samples together leave unknown of where the target is, m^2."""
    unsure_s = math.fsum(
        share * median(held.unsure_ns for held in fresh[name]) * 1e-9 for name, share in shares.items() if fresh[name]
    )
    return times(unsure_s * unsure_s / 3.0, plus(outer(track.v_m_s), track.D))


def _shares(fresh: dict[str, list[Held]], factors: dict[str, float]) -> dict[str, float]:
    """Share of each origin that agrees in the information of the window, times its factor; sum 1."""
    sizes = {name: factors[name] * math.fsum(trace(held.information) for held in fresh[name]) for name in factors}
    total = math.fsum(sizes.values())
    return {name: size / total for name, size in sizes.items()}


# --- window of samples ---
# The newest samples of every robot, for a target that moves: what is passed on, and what a track is made of.
#
# A sample may arrive late and out of order, over other robots. One that comes after its moment has left the window
# (`FixedLagFilter`) is of no use any more, neither here nor to a neighbour.
#
# Clocks need not agree. A sample carries its age; every robot that passes it on adds the time it lay there, and who
# hears it the time of its way, with what is not known of that (`LinkClock`). It also carries when it was taken on its
# origin's clock, which no relay can change: what we learn of that clock from one sample holds for the next
# (`OriginClocks`).

Key = tuple[str, int, int]  # origin, incarnation, number

WINDOW = 24  # length in iterations: the way across a swarm of some ten hops when a third of all messages is lost
KEPT = 48  # samples of one robot, those with the largest numbers: twice what an honest one has in a window
MASK = 32  # samples before the newest that one line of a digest can tell of; more than a window holds


class Window(Revertible):
    """All samples of one epoch of one target that can still matter."""

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._span_ns = WINDOW * bounds.iteration_ns
        self.samples: dict[Key, Held] = {}
        self._clocks = OriginClocks()
        self._frozen_ns = -(10**30)  # samples up to this moment are in the frozen tracks, or too late

    def measure(self, key: Key, held: Held) -> None:
        """Add a sample of our own."""
        if held.t_ns > self._frozen_ns:
            self.samples[key] = held

    def fault(self, sample: Sample, sent_ns: int) -> str | None:
        """Why a sample that left its sender at `sent_ns` of our clock is of no use, from any source."""
        fault = sample_fault(sample, self._bounds, sent_ns)
        if fault is None and sent_ns - sample.age_ns <= self._frozen_ns:
            return "too late"
        return fault

    def earlier(self, sample: Sample, sent_ns: int) -> None:
        """Take note of a copy of a sample. A larger age counts, where the sample has no time by its origin's clock."""
        key, t_ns = (sample.origin, sample.incarnation, sample.number), sent_ns - sample.age_ns
        old = self.samples[key]
        if not old.exposed_ns and self._frozen_ns < t_ns < old.t_ns:
            self.samples[key] = old._replace(t_ns=t_ns)

    def merge(self, sample: Sample, sent_ns: int, bound_ns: int, direct: bool) -> str | None:
        """Take in a sample that is believed; returns why it is of no use, if it is not.

        sent_ns: when its message was sent, on our clock, to within bound_ns. direct: from its own robot.
        """
        t_ns, unsure_ns = sent_ns - sample.age_ns, sample.unsure_ns + bound_ns
        if sample.t_ns:
            clock = self._clocks.offset(sample.origin, t_ns - sample.t_ns, unsure_ns, direct, sent_ns)
            t_ns, unsure_ns = min(sample.t_ns + clock.offset_ns, sent_ns), clock.bound_ns
        if t_ns <= self._frozen_ns:
            return "too late"
        key = (sample.origin, sample.incarnation, sample.number)
        self.samples[key] = Held(t_ns, sample.information, sample.vector, sample.t_ns, sample.signature, unsure_ns)
        numbers = sorted(k for k in self.samples if k[0] == sample.origin)
        for old in numbers[:-KEPT]:
            del self.samples[old]
        return None

    def drop(self, origins: Collection[str]) -> None:
        """Drop all samples of these origins."""
        self.samples = {key: held for key, held in self.samples.items() if key[0] not in origins}

    def fresh(self) -> dict[str, list[Held]]:
        """Samples of each origin since the horizon, in the order of their names and numbers."""
        found: dict[str, list[Held]] = {}
        for key in sorted(self.samples):
            if self.samples[key].t_ns > self._frozen_ns:
                found.setdefault(key[0], []).append(self.samples[key])
        return found

    def horizon_ns(self, now_ns: int) -> int:
        """Where the window begins."""
        return now_ns - self._span_ns

    def freeze(self, horizon_ns: int) -> None:
        """The window begins here from now on; what is older has its place in the tracks."""
        self._frozen_ns = max(self._frozen_ns, horizon_ns)
        # Frozen samples stay listed for another window: neighbours that still hold them must not send them again.
        oldest_ns = horizon_ns - self._span_ns
        self.samples = {key: held for key, held in self.samples.items() if held.t_ns > oldest_ns}

    def sendable(self, now_ns: int) -> dict[Key, int]:
        """Samples that a neighbour may still use, newest first."""
        fresh = [key for key, held in self.samples.items() if held.t_ns > self.horizon_ns(now_ns)]
        return {key: 1 for key in sorted(fresh, key=lambda key: (-self.samples[key].t_ns, key))}

    def sample(self, key: Key, now_ns: int) -> Sample:
        """A sample as it leaves now."""
        held = self.samples[key]
        age_ns = max(0, now_ns - held.t_ns)
        L, vector, when_ns = held.information, held.vector, held.exposed_ns
        return Sample(*key, age_ns, L, vector, when_ns, held.signature, held.unsure_ns)

    def digest(self) -> list[Holding]:
        """One line for each origin and incarnation."""
        numbers: dict[tuple[str, int], list[int]] = {}
        for origin, incarnation, number in sorted(self.samples):
            numbers.setdefault((origin, incarnation), []).append(number)
        return [
            Holding(*who, held[-1], sum(1 << (held[-1] - 1 - k) for k in held[:-1] if held[-1] - 1 - k < MASK))
            for who, held in numbers.items()
        ]
