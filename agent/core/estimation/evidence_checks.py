"""What of a neighbour's evidence can be: limits that follow from cameras, tank and clocks, not from what is usual.

Each entry and each sample is judged alone, by itself and the time, and never by what came before it: robots that hear
the same in another order believe the same. Who said it is authority.py's question.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.core.estimation.line import chord, line
from agent.core.matrix import apply, inverse, minus, semidefinite, times, trace
from agent.core.messages import Entry, Sample, Symmetric, Vector
from agent.core.transit import CLOCKS_NS

R_FLOOR_M = 0.001  # no camera of ours knows the target better than this in one sample; guards over-confident vision
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
    """Why an entry is not believed, in a word to count by; None when it is."""
    return (
        _sums_fault(entry.origin, entry.count, entry.information, entry.vector, bounds)
        or (None if is_covariance(entry.systematic_m2, bounds.tank_m) else "not a covariance")
        or _time_fault(entry.incarnation, entry.count, bounds, now_ns)
    )


def sample_fault(sample: Sample, bounds: Bounds, now_ns: int) -> str | None:
    """Why a sample is not believed; None when it is. One that knows but a line, a bearing, must pass the tank."""
    return (
        _sums_fault(sample.origin, 1, sample.information, sample.vector, bounds)
        or (None if inverse(sample.information) is not None else _line_fault(sample, bounds.tank_m))
        or _time_fault(sample.incarnation, sample.number, bounds, now_ns)
    )


def is_covariance(covariance_m2: Symmetric, tank_m: Vector) -> bool:
    """Whether this can be a covariance of a place: semidefinite, and not less sure than that it is in the tank."""
    return (
        finite(covariance_m2)
        and semidefinite(covariance_m2, 0.0)
        and trace(covariance_m2) <= widest_m2(tank_m) * (1.0 + SLACK)
    )


def widest_m2(tank_m: Vector) -> float:
    """Trace of the widest covariance that a place can have which is inside the tank."""
    return sum((size + 2.0 * MARGIN_M) ** 2 for size in tank_m)


def floored(random_m2: Symmetric) -> Symmetric:
    """A covariance none of whose axes is below R_FLOOR_M: raised as a whole where one is."""
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
    """Whether a robot of the fleet can know so much from so many samples, of a place in the tank."""
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


def _line_fault(sample: Sample, tank_m: Vector) -> str | None:
    of = line(sample.information, sample.vector)
    if of is None:
        return "not a covariance"
    low, high = (-MARGIN_M,) * 3, (tank_m[0] + MARGIN_M, tank_m[1] + MARGIN_M, tank_m[2] + MARGIN_M)
    return None if chord(of, low, high) else "outside the tank"


def _time_fault(incarnation: int, count: int, bounds: Bounds, now_ns: int) -> str | None:
    """Whether an origin that started at `incarnation` can have taken so many samples by now. True after any partition,
    whatever was heard before."""
    if incarnation > now_ns + CLOCKS_NS:
        return "from the future"
    if count > RATE * (now_ns - incarnation + CLOCKS_NS) / bounds.iteration_ns + FIRST:
        return "too many samples"
    return None
