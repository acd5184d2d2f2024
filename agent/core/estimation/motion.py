"""Does the target rest or move? Each robot asks its own samples, and tells the others by how far it moved.

At rest the mean of the newest m own samples is held against the mean of those before them, for several m:

    g_m = D' (s^2 R (1/m + 1/n) + c^2 I + t^2 V)^-1 D    D: the difference, R: random covariance of a sample

The own mean is the reference, not the agreed place: what stays wrong of a robot is in both, and raises no alarm. s^2 is
by how much more samples scatter than they say: the median of squared differences of neighbouring samples, for a jump is
one difference of many. V is of how fast a robot's own height and level drift, as it says, and t the time between the
means; c is what its place drifts by besides.

Moving turns to rest when the track has stayed in one place for half a minute.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from functools import reduce
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from agent.core.estimation.evidence_table import floored
from agent.core.estimation.interface import Prior
from agent.core.linear_algebra import IDENTITY, ZERO, difference, distance2, inner, minus, plus, times
from agent.core.messages import Symmetric, Vector
from agent.core.step_transaction import Revertible

SPANS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48)  # m: newest samples that may be of another place
BEFORE, FEWEST, FEW = 120, 6, 40  # n: at most, at least; with fewer than FEW one that stands apart counts
ALARM = 26.0  # g: 0.05 false alarms a robot and hour, in samples that scatter twice as much as they say
DRIFT_M = 0.0004  # c
AGREE = 16.27  # chi^2, 3 degrees of freedom, 0.999: two samples that are of one place
MEDIAN = 2.366  # of chi^2, 3 degrees of freedom
SCATTER, BLOCK = 32, 4  # differences whose median is taken: of samples, and of means of BLOCK samples
SEVERAL = 4  # of them, at least

STEP_M, STEP_SHARE = 0.001, 0.15  # how well a step is known that another robot saw
SURE = 13.8  # log likelihood ratio, twice, from which on own samples speak for a step or against it: a thousand to one
NEUTRAL_NS = 3_000_000_000  # samples taken so long before a step is told of may be of either place

NORMAL = 25.00  # chi^2, 15 degrees of freedom, 0.95: of BATCH innovations
BATCH = 5
RESTED_NS = 30_000_000_000  # this long in one place is rest
REST_SPEED_M_S = 0.002  # mean speed over that time below which the target counts as resting


class Innovation(NamedTuple):
    """An own sample against what the own samples before it said."""

    step_m: Vector
    covariance_m2: Symmetric  # of that, if nothing changed
    nis: float  # that step, normalised and squared


class Moved(NamedTuple):
    """The target is elsewhere, by own samples."""

    step_m: Vector
    since_ns: int  # the exposure of the first sample of the new place


class Motion(Revertible):
    """Evidence for and against motion, of one robot in one epoch."""

    def __init__(self) -> None:
        self._own: deque[Own] = deque(maxlen=BEFORE + SPANS[-1])
        self._sums: deque[Sum] = deque((NONE,), maxlen=BEFORE + SPANS[-1] + 1)  # of all up to each
        self._batch: list[float] = []
        self._normal = False  # the last full batch scattered no more than it should
        self._path: deque[tuple[int, Vector]] = deque()

    # --- at rest ---

    def rested(self, prior: Prior) -> Moved | None:
        """Take note of one own sample of a target at rest; whether it rests no more."""
        self._own.append(Own(prior.t_ns, prior.x_m, floored(prior.random_m2), prior.drift_m2_s2))
        self._sums.append(_add(self._sums[-1], self._own[-1]))
        own, sums = tuple(self._own), tuple(self._sums)
        spans = [m for m in SPANS if len(own) - m >= FEWEST]
        odd = [m for m in spans if _g(_between(sums, -m), _between(sums, -m - BEFORE, -m), 1.0) > ALARM]
        s2 = _scatter(own) if odd else 1.0  # what follows makes g smaller
        g, moved = max((_moved(own, m, s2) for m in odd), default=(0.0, None), key=lambda each: each[0])
        return moved if g > ALARM else None

    def judge(self, step_m: Vector, told_ns: int) -> bool | None:
        """Whether own samples since a step was told of say that it happened; None: they cannot tell yet."""
        since = [own for own in self._own if own.t_ns > told_ns]
        before = _sum([own for own in self._own if own.t_ns <= told_ns - NEUTRAL_NS][-BEFORE:])
        if len(since) < 2 or not before.samples:
            return None
        step_m2 = STEP_M * STEP_M + STEP_SHARE * STEP_SHARE * inner(step_m, step_m)
        s2, odds = _scatter(tuple(self._own)), []
        for k in range(len(since)):  # any one of them may be odd
            D, S = _apart(_sum([*since[:k], *since[k + 1 :]]), before, s2)
            gone = plus(S, times(step_m2, IDENTITY))
            odds.append(distance2(S, D) - distance2(gone, difference(D, step_m)))
        least = min(odds, key=abs)
        return None if abs(least) < SURE else least > 0.0

    # --- in motion ---

    def tracked(self, innovation: Innovation) -> None:
        """Take note of one own sample of a target that moves."""
        self._batch.append(innovation.nis)
        if len(self._batch) == BATCH:
            self._normal, self._batch = sum(self._batch) < NORMAL, []

    def place(self, now_ns: int, x_m: Vector) -> None:
        """Take note of where the track is."""
        self._path.append((now_ns, x_m))
        while len(self._path) > 1 and now_ns - self._path[1][0] >= RESTED_NS:
            self._path.popleft()

    def rests(self, now_ns: int) -> bool:
        """Whether the track stayed in one place for half a minute, and own samples agree with it."""
        if not self._normal or not self._path or now_ns - self._path[0][0] < RESTED_NS:
            return False
        here, reach = self._path[-1][1], REST_SPEED_M_S * RESTED_NS * 1e-9
        return all(sum((a - b) ** 2 for a, b in zip(x, here, strict=True)) < reach * reach for _, x in self._path)


def _moved(own: Sequence[Own], m: int, s2: float) -> tuple[float, Moved | None]:
    """g of the newest m against those before, and the step: the least that is left without one that stands apart."""
    new, old = own[-m:], own[-m - BEFORE : -m]
    if m == 2 and _g(_sum(new[1:]), _sum(new[:1]), s2, 0.0) > AGREE:
        return 0.0, None
    news = [new] if m == 2 else [new, _without_farthest(new)]
    olds = [old] if len(old) >= FEW else [old, _without_farthest(old)]
    ways = [_apart(_sum(some), _sum(before), s2) for some in news for before in olds]
    g, step_m = min((distance2(S, D), D) for D, S in ways)
    return g, Moved(step_m, new[0].t_ns)


def _scatter(own: Sequence[Own]) -> float:
    """s^2, of samples and of means of a few: errors that are alike for seconds show in the latter."""
    late = own[-SCATTER - 1 :]
    blocks = [_sum(late[k : k + BLOCK]) for k in range(len(late) % BLOCK, len(late), BLOCK)]
    found = [1.0]
    for of in ([_sum([one]) for one in late], blocks):
        steps = [_g(b, a, 1.0, 0.0) for a, b in pairwise(of)]
        found += [median(steps) / MEDIAN] if len(steps) >= SEVERAL else []
    return max(found)


# --- means ---


class Own(NamedTuple):
    """One own sample."""

    t_ns: int
    x_m: Vector
    random_m2: Symmetric
    drift_m2_s2: Symmetric


class Sum(NamedTuple):
    """Of several own samples."""

    samples: int
    t_ns: int
    x_m: Vector
    random_m2: Symmetric
    drift_m2_s2: Symmetric


NONE = Sum(0, 0, (0.0, 0.0, 0.0), ZERO, ZERO)


def _add(to: Sum, own: Own) -> Sum:
    (x, y, z), (u, v, w) = to.x_m, own.x_m
    spread, drift = plus(to.random_m2, own.random_m2), plus(to.drift_m2_s2, own.drift_m2_s2)
    return Sum(to.samples + 1, to.t_ns + own.t_ns, (x + u, y + v, z + w), spread, drift)


def _sum(of: Iterable[Own]) -> Sum:
    return reduce(_add, of, NONE)


def _between(sums: Sequence[Sum], first: int, end: int | None = None) -> Sum:
    """The sum of some samples, of the sums of the first k: indices count from the end, as those of a slice do."""
    last = sums[-1 if end is None else end - 1]
    before = sums[max(first - 1, -len(sums))]
    return Sum(
        last.samples - before.samples,
        last.t_ns - before.t_ns,
        difference(last.x_m, before.x_m),
        minus(last.random_m2, before.random_m2),
        minus(last.drift_m2_s2, before.drift_m2_s2),
    )


def _apart(new: Sum, old: Sum, s2: float, drift_m: float = DRIFT_M) -> tuple[Vector, Symmetric]:
    """The difference of two means, and its covariance if both are of one place."""
    m, n = new.samples, old.samples
    (x, y, z), (u, v, w) = new.x_m, old.x_m
    spread = plus(times(s2 / (m * m), new.random_m2), times(s2 / (n * n), old.random_m2))
    t_s = (new.t_ns / m - old.t_ns / n) * 1e-9
    spread = plus(spread, times(t_s * t_s / (m + n), plus(new.drift_m2_s2, old.drift_m2_s2)))
    return (x / m - u / n, y / m - v / n, z / m - w / n), plus(spread, times(drift_m * drift_m, IDENTITY))


def _g(new: Sum, old: Sum, s2: float, drift_m: float = DRIFT_M) -> float:
    D, S = _apart(new, old, s2, drift_m)
    return distance2(S, D)


def _without_farthest(of: Sequence[Own]) -> Sequence[Own]:
    """All but the one that is farthest from the median, by its own covariance."""
    x, y, z = (median(axis) for axis in zip(*(own.x_m for own in of), strict=True))
    k = max(range(len(of)), key=lambda k: distance2(of[k].random_m2, difference(of[k].x_m, (x, y, z))))
    return [*of[:k], *of[k + 1 :]]
