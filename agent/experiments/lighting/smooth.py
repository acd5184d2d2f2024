"""A table of drawn values made smooth: as near to them as their errors ask, and bent as little as that allows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BEND = 0.15  # standard deviation of a second difference between neighbours, in the logarithm: what real ones have
ROUNDS = 4000
WORST = 3.0  # errors: what lies further off, counts as that far (Huber), so that an outlier pulls no neighbour along


def smoothed(values: Array, error: Array) -> Array:
    """Least squares of (value - drawn) / error and second differences / BEND along each axis, by conjugate gradients;
    three passes with new weights for outliers."""
    fitted = values.copy()
    weight = 1.0 / np.maximum(error, 0.01) ** 2
    for _ in range(3):
        off = np.abs(values - fitted) * np.sqrt(1.0 / np.maximum(error, 0.01) ** 2)
        trust = weight * np.minimum(1.0, WORST / np.maximum(off, 1e-9))
        fitted = _solved(values, trust)
    return fitted


def _solved(values: Array, trust: Array) -> Array:
    def apply(x: Array) -> Array:
        return trust * x + _bending(x) / BEND**2

    x = values.copy()
    rest = trust * values - apply(x)
    way = rest.copy()
    norm = float((rest * rest).sum())
    start = norm
    for _ in range(ROUNDS):
        if norm <= 1e-16 * max(start, 1e-300):
            break
        pushed = apply(way)
        step = norm / float((way * pushed).sum())
        x += step * way
        rest -= step * pushed
        after = float((rest * rest).sum())
        way = rest + after / norm * way
        norm = after
    return x


def _bending(x: Array) -> Array:
    """The second differences' transpose times themselves, along each axis of three nodes or more."""
    total = np.zeros_like(x)
    for axis in range(x.ndim):
        if x.shape[axis] < 3:
            continue
        second = np.diff(x, 2, axis=axis)
        pad = [(0, 0)] * x.ndim
        for shift, factor in ((0, 1.0), (1, -2.0), (2, 1.0)):
            pad[axis] = (shift, 2 - shift)
            total += factor * np.pad(second, pad)
    return total
