"""What of a neighbour's evidence is believed: each entry and each sample is judged alone, and refused alone."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.kernel.estimation.matrix import apply, inverse, minus, semidefinite, times, trace
from agent.kernel.messages import Entry, Sample, Symmetric, Vector

R_FLOOR_M = 0.001  # no camera of ours knows the target better than this in one sample; guards over-confident vision
MARGIN_M = 0.2  # a place may lie this far outside the tank before it is nonsense
SLACK = 1e-9  # of the trace: rounding of sums that travelled
RATE = 3.0  # samples for each iteration of the origin, at most: iterations are not exactly even
BURST = 600  # samples that may come at once after a partition or through a late relay: ten minutes at 1 Hz


class Bounds(NamedTuple):
    """What evidence about a target can be."""

    origins: frozenset[str]  # the robots of the fleet
    tank_m: Vector
    iteration_ns: int


class First(NamedTuple):
    """When an origin's incarnation was first heard of, and how far it was then."""

    samples: int
    now_ns: int


def entry_fault(entry: Entry, old: Entry | None, first: First | None, bounds: Bounds, now_ns: int) -> str | None:
    """Why a newer entry cannot replace the older, in a word to count by; None when it can."""
    size = trace(entry.information)
    if not finite(entry.information, entry.vector, entry.systematic_m2):
        return "not finite"
    if entry.origin not in bounds.origins:
        return "unknown origin"
    if not semidefinite(entry.information, SLACK * size) or not semidefinite(entry.systematic_m2, 0.0):
        return "not a covariance"
    if size > 3.0 * entry.count / (R_FLOOR_M * R_FLOOR_M) * (1.0 + SLACK):
        return "too sure"
    if old is not None and not semidefinite(minus(entry.information, old.information), SLACK * size):
        return "information lost"
    if first is not None:
        allowed = BURST + RATE * (now_ns - first.now_ns) / bounds.iteration_ns
        if entry.count - first.samples > allowed:
            return "too fast"
    return _place_fault(entry.information, entry.vector, bounds.tank_m)


def sample_fault(sample: Sample, bounds: Bounds) -> str | None:
    """Why a sample is not believed; None when it is."""
    if not finite(sample.information, sample.vector):
        return "not finite"
    if sample.origin not in bounds.origins:
        return "unknown origin"
    size = trace(sample.information)
    if inverse(sample.information) is None:
        return "not a covariance"
    if size > 3.0 / (R_FLOOR_M * R_FLOOR_M) * (1.0 + SLACK):
        return "too sure"
    return _place_fault(sample.information, sample.vector, bounds.tank_m)


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


def _place_fault(information: Symmetric, vector: Vector, tank_m: Vector) -> str | None:
    covariance = inverse(information)
    if covariance is None:
        return None  # a direction not yet seen: nothing to place
    return None if inside(apply(covariance, vector), tank_m) else "outside the tank"
