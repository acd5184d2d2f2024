"""What each robot has measured of a target at rest: a map that only grows, to the same from any order of news.

Each robot writes one entry for each of its starts (its incarnation), the sum of all it measured since. Newer replaces
older, so merging is commutative, associative and idempotent: loss, repeats, reordering and loops among the relays
cannot count a sample twice. Of two entries with the same count, which no honest robot writes, every robot keeps the one
with the larger numbers. After a restart a robot writes under a new incarnation, and its old entry comes back to it from
the neighbours.
"""

from __future__ import annotations

import math
from struct import pack
from typing import Any, NamedTuple
from zlib import crc32

from agent.core.estimation.fuse import AGREE, NONE, Opinion, Shared
from agent.core.estimation.interface import NOTHING, Bearing, Prior
from agent.core.estimation.track import chord, line
from agent.core.linear_algebra import (
    ZERO,
    add,
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
from agent.core.link_clocks import CLOCKS_NS
from agent.core.messages import Entry, Sample, Symmetric, Vector
from agent.core.step_transaction import Revertible

Key = tuple[str, int]  # origin, incarnation

ALIKE = 4.0  # times a covariance may differ from one start of a robot to the next: targets are seen from other places
NOTHING_M2 = 1e-12  # a micrometre
INCARNATIONS = 4  # of one origin, the newest: a robot that restarts all day must not fill the memory of the others


class Table(Revertible):
    """All entries of one epoch of one target: a state-based CRDT, whose join is `merge`."""

    def __init__(self, shared: Shared = NONE) -> None:
        self._shared = shared
        self.entries: dict[Key, Entry] = {}
        self.marks: dict[Key, int] = {}  # of each entry a checksum, by which neighbours see whether theirs is the same
        self.hearsay: set[Key] = set()  # entries that came from others than their origin
        self.removed = 0  # entries so far
        self._of: dict[str, tuple[Key, ...]] = {}  # the entries of each origin, the newest first
        self._own: Key | None = None  # the entry that we add to
        self._opinions: dict[str, Opinion | None] = {}  # None: to be made again, or not yet possible

    def measure(self, key: Key, prior: Prior | Bearing) -> Symmetric:
        """Add a sample of our own; returns its information R^-1 in 1/m^2.

        Raises ValueError where the covariance of the prior has no inverse.
        """
        if isinstance(prior, Bearing):
            information, fixed_m2, lever_m = prior.information, NOTHING, (0.0, 0.0, 0.0)
        else:
            found, fixed_m2, lever_m = inverse(floored(prior.random_m2)), prior.systematic_m2, prior.lever_m
            if found is None:
                raise ValueError(f"covariance of the prior {prior.random_m2} is singular")
            information = found
        x, y, z = apply(information, prior.x_m)
        old = self.entries.get(key)
        if old is None:
            entry = Entry(*key, 1, information, (x, y, z), fixed_m2, lever_m=lever_m)
        else:
            count, (ox, oy, oz) = old.count + 1, old.vector
            drift = times((count - 1) / count, old.systematic_m2)
            systematic = plus(drift, times(1.0 / count, fixed_m2))
            sums = plus(old.information, information), (ox + x, oy + y, oz + z)
            lever_m = add(old.lever_m, 1.0 / count, difference(lever_m, old.lever_m))
            entry = Entry(*key, count, *sums, systematic, lever_m=lever_m)
        self._own = key
        self._put(entry)
        return information

    def is_news(self, entry: Entry) -> bool:
        """Whether merging it would change anything."""
        old = self.entries.get((entry.origin, entry.incarnation))
        if old is not None:
            return _rank(entry) > _rank(old)
        newest = self._newest(entry.origin)
        return len(newest) < INCARNATIONS or entry.incarnation > newest[-1][1]

    def merge(self, entry: Entry, hearsay: bool = False) -> str | None:
        """Take in a neighbour's entry that is news and is believed; returns the kind of its fault, or None."""
        key = (entry.origin, entry.incarnation)
        old = self.entries.get(key)
        self._put(entry)
        if hearsay:
            self.hearsay.add(key)
        else:
            self.hearsay.discard(key)
        return "equivocates" if old is not None and old.count == entry.count else None

    def drop(self, key: Key) -> None:
        """Remove an entry that is believed no more."""
        self._remove(key)
        if self._of[key[0]]:
            self._opinions[key[0]] = None
        else:
            del self._of[key[0]], self._opinions[key[0]]

    def opinions(self) -> list[Opinion]:
        """The opinion of each origin, in the order of their names, without those that cannot place the target yet."""
        return [opinion for name in sorted(self._opinions) if (opinion := self._opinion(name)) is not None]

    def _put(self, entry: Entry) -> None:
        key = (entry.origin, entry.incarnation)
        if key not in self.entries:
            self._of[key[0]] = tuple(sorted((*self._of.get(key[0], ()), key), reverse=True))
        self.entries[key], self.marks[key] = entry, mark(entry)
        self._opinions[key[0]] = None
        for old in self._newest(key[0])[INCARNATIONS:]:
            self._remove(old)

    def _remove(self, key: Key) -> None:
        del self.entries[key], self.marks[key]
        self.hearsay.discard(key)
        self._of[key[0]] = tuple(other for other in self._of[key[0]] if other != key)
        self.removed += 1

    def _newest(self, origin: str) -> list[Key]:
        """Entries of an origin, the newest first, without the one that we add to: that is never let go."""
        return [key for key in self._of.get(origin, ()) if key != self._own]

    def _opinion(self, origin: str) -> Opinion | None:
        if self._opinions[origin] is None:
            self._opinions[origin] = opinion(origin, [self.entries[key] for key in self._of[origin]], self._shared)
        return self._opinions[origin]


def opinion(origin: str, entries: list[Entry], shared: Shared = NONE) -> Opinion | None:
    """One origin's mean over its incarnations, given newest first; None while some direction is unseen.

    The newest counts; older ones are added as long as their means agree with it. One that claims to have seen
    better, or with other systematic errors, says no more than the newest does. So a robot that was knocked, repaired
    and started again is believed at once, one that merely started again has lost nothing, and one that lied is not
    held to its lie, unless the lie looked like its own samples.

    Its systematic error is the same in every sample and in every incarnation, so it enters once and is never divided.
    So does the error of its lever, though it is the same on all robots: between two of them it shows (see fuse.py).
    """
    information, vector, systematic, total = ZERO, (0.0, 0.0, 0.0), ZERO, 0.0
    lever_m = entries[0].lever_m if entries else (0.0, 0.0, 0.0)
    most = trace(entries[0].information) if entries else 0.0
    for entry in entries:
        if total and not _agrees(information, vector, entry):
            break
        share = 1.0 if _alike(entries[0], entry) else min(1.0, most / trace(entry.information))
        information = plus(information, times(share, entry.information))
        vector = add(vector, share, entry.vector)
        systematic = plus(systematic, times(share * entry.count, entry.systematic_m2))
        total += share * entry.count
    random = inverse(information)
    if random is None:
        return None
    covariance = plus(plus(random, times(1.0 / total, systematic)), shared.scale_m2(lever_m))
    precision = inverse(covariance)
    return None if precision is None else Opinion(origin, apply(random, vector), covariance, precision, lever_m, random)


def _agrees(information: Symmetric, vector: Vector, older: Entry) -> bool:
    """Whether what an origin measured before may be the same place as what it measured since."""
    random, before = inverse(information), inverse(older.information)
    if random is None or before is None:
        return True  # nothing is known against it
    x, y, z = apply(random, vector)
    ox, oy, oz = apply(before, older.vector)
    return distance2(plus(random, before), (x - ox, y - oy, z - oz)) < AGREE


def _alike(newest: Entry, older: Entry) -> bool:
    """Whether the same camera can have measured both: samples as good, and the same systematic errors."""
    new, old = newest.systematic_m2, older.systematic_m2
    return (
        trace(older.information) * newest.count <= ALIKE * trace(newest.information) * older.count
        and semidefinite(minus(times(ALIKE, new), old), NOTHING_M2)
        and semidefinite(minus(times(ALIKE, old), new), NOTHING_M2)
    )


def mark(entry: Entry) -> int:
    """A checksum of what an entry says of the place, 32 bits."""
    return crc32(pack("<15d", *entry.information, *entry.vector, *entry.systematic_m2))


def _rank(entry: Entry) -> tuple[Any, ...]:
    return entry.count, entry.information, entry.vector, entry.systematic_m2, entry.lever_m


# --- checks of evidence ---
# What of a neighbour's evidence can be: limits that follow from cameras, tank and clocks, not from what is usual.
#
# Each entry and each sample is judged alone, by itself and the time, and never by what came before it: robots that hear
# the same in another order believe the same. Whether the source may say it is for `Authority` to judge.

R_FLOOR_M = 0.001  # no camera knows the target better than this in one sample; guards against over-confident vision
MARGIN_M = 0.2  # a place may lie this far outside the tank before it is nonsense
LEAST = 1e-6  # 1/m^2, trace of an information that says anything: a sigma of a kilometre
SLACK = 1e-9  # of the trace: rounding of sums that travelled
RATE = 1.25  # samples for each iteration of the origin, at most: iterations are not exactly even
FIRST = 2  # samples that may come before the first iteration is over


class Bounds(NamedTuple):
    """What evidence about a target can be."""

    origins: frozenset[str]  # the robots of the fleet
    tank_m: Vector
    iteration_ns: int


def entry_fault(entry: Entry, bounds: Bounds, now_ns: int) -> str | None:
    """Why an entry is not believed, as a kind to count by; None when it is."""
    return (
        _sums_fault(entry.origin, entry.count, entry.information, entry.vector, bounds)
        or (None if is_covariance(entry.systematic_m2, bounds.tank_m) else "not a covariance")
        or (None if _is_lever(entry.lever_m, bounds.tank_m) else "outside the tank")
        or _time_fault(entry.incarnation, entry.count, bounds, now_ns)
    )


def sample_fault(sample: Sample, bounds: Bounds, now_ns: int) -> str | None:
    """Why a sample is not believed; None when it is. A bearing, which knows only a line, must pass through the tank."""
    return (
        _sums_fault(sample.origin, 1, sample.information, sample.vector, bounds)
        or (None if inverse(sample.information) is not None else _line_fault(sample, bounds.tank_m))
        or _time_fault(sample.incarnation, sample.number, bounds, now_ns)
    )


def is_covariance(covariance_m2: Symmetric, tank_m: Vector) -> bool:
    """Whether this can be a covariance of a place: semidefinite, and not wider than that the place is in the tank."""
    return (
        finite(covariance_m2)
        and semidefinite(covariance_m2, 0.0)
        and trace(covariance_m2) <= widest_m2(tank_m) * (1.0 + SLACK)
    )


def widest_m2(tank_m: Vector) -> float:
    """Trace of the widest covariance that a place can have which is inside the tank."""
    return sum((size + 2.0 * MARGIN_M) ** 2 for size in tank_m)


def floored(random_m2: Symmetric) -> Symmetric:
    """A covariance none of whose axes is below R_FLOOR_M: it is raised as a whole where one is."""
    floor = times(R_FLOOR_M * R_FLOOR_M, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
    if semidefinite(minus(random_m2, floor), 0.0):
        return random_m2
    xx, xy, xz, yy, yz, zz = random_m2
    return xx + floor[0], xy, xz, yy + floor[3], yz, zz + floor[5]


def finite(*groups: tuple[float, ...]) -> bool:
    return all(math.isfinite(x) for group in groups for x in group)


def inside(place_m: Vector, tank_m: Vector) -> bool:
    """Whether a place can be meant: in the tank, or a little outside it."""
    return all(-MARGIN_M <= x <= size + MARGIN_M for x, size in zip(place_m, tank_m, strict=True))


def _sums_fault(origin: str, count: int, information: Symmetric, vector: Vector, bounds: Bounds) -> str | None:
    """Why no robot of the fleet can know so much from so many samples, of a place in the tank; None where one can."""
    size = trace(information)
    if not finite(information, vector):
        return "not finite"
    if origin not in bounds.origins:
        return "unknown origin"
    if size > 3.0 * count / (R_FLOOR_M * R_FLOOR_M) * (1.0 + SLACK):
        return "too sure"
    if size < LEAST or not semidefinite(information, SLACK * size):
        return "not a covariance"
    reach_m = math.sqrt(widest_m2(bounds.tank_m))
    if max(map(abs, vector)) > size * reach_m:
        return "outside the tank"
    covariance = inverse(information)
    if covariance is None:
        return None  # a direction not yet seen: nothing to place
    return None if inside(apply(covariance, vector), bounds.tank_m) else "outside the tank"


def _is_lever(lever_m: Vector, tank_m: Vector) -> bool:
    """Whether a camera and what it sees can be so far apart."""
    return finite(lever_m) and sum(part * part for part in lever_m) <= widest_m2(tank_m)


def _line_fault(sample: Sample, tank_m: Vector) -> str | None:
    of = line(sample.information, sample.vector)
    if of is None:
        return "not a covariance"
    low, high = (-MARGIN_M,) * 3, (tank_m[0] + MARGIN_M, tank_m[1] + MARGIN_M, tank_m[2] + MARGIN_M)
    return None if chord(of, low, high) else "outside the tank"


def _time_fault(incarnation: int, count: int, bounds: Bounds, now_ns: int) -> str | None:
    """Why an origin that started at `incarnation` cannot have taken so many samples by now; None where it can. It holds
    after any partition, whatever was heard before."""
    if incarnation > now_ns + CLOCKS_NS:
        return "from the future"
    if count > RATE * (now_ns - incarnation + CLOCKS_NS) / bounds.iteration_ns + FIRST:
        return "too many samples"
    return None
