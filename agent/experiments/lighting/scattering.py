"""Particles as the Monte Carlo draws them: Fournier-Forand from its own closed cumulative, apart from the kernel's and
the twin's, so that neither proves itself.

Fournier and Forand 1994; the cumulative after Fournier and Jonasz, Proc. SPIE 3761 (1999).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INDEX, SLOPE = 1.10, 3.5835
SMALLEST_RAD = 1e-3
ANGLES = 4096  # of the tables, even in the logarithm of the angle
DRAWS = 1 << 16


class Particles(NamedTuple):
    """Tables for the kernels."""

    log_phase: Array  # (ANGLES,) of the phase function per steradian, from SMALLEST_RAD to pi
    drawn_cos: Array  # (DRAWS,) cosines of scattering angles, equally likely
    kept: float  # share of the scattering coefficient that is left


def phase(angle_rad: Array) -> Array:
    """(n,) per steradian."""
    nu, k = (3 - SLOPE) / 2, 4 / (3 * (INDEX - 1) ** 2)
    u = np.sin(angle_rad / 2) ** 2
    d = k * u
    d = np.where(np.abs(d - 1) < 1e-5, 1 + 1e-5, d)
    first = nu * (1 - d) - (1 - d**nu) + (d * (1 - d**nu) - nu * (1 - d)) / u
    rest = (1 - k**nu) / (16 * np.pi * (k - 1) * k**nu) * (3 * np.cos(angle_rad) ** 2 - 1)
    return np.asarray(first / (4 * np.pi * (1 - d) ** 2 * d**nu) + rest)


def within(angle_rad: Array) -> Array:
    """(n,) share that goes less than so far aside."""
    nu, k = (3 - SLOPE) / 2, 4 / (3 * (INDEX - 1) ** 2)
    u = np.sin(angle_rad / 2) ** 2
    d = k * u
    d = np.where(np.abs(d - 1) < 1e-5, 1 + 1e-5, d)
    front = ((1 - d ** (nu + 1)) - (1 - d**nu) * u) / ((1 - d) * d**nu)
    back = (1 - k**nu) / (8 * (k - 1) * k**nu) * np.cos(angle_rad) * np.sin(angle_rad) ** 2
    return np.asarray(front + back)


@lru_cache
def particles(straight_rad: float = SMALLEST_RAD) -> Particles:
    """`straight_rad`: what is scattered by less goes on as if it were not. For light of all orders that changes nothing
    that shows, and the peak of the phase function, whence outliers come, is gone."""
    angle = np.geomspace(SMALLEST_RAD, np.pi, ANGLES)
    kept = 1 - float(within(np.array([straight_rad]))[0]) if straight_rad > SMALLEST_RAD else 1.0
    share = within(angle)
    # what goes straight on, within the smallest angle, keeps its way
    drawn = np.interp(1 - kept * (1 - (np.arange(DRAWS) + 0.5) / DRAWS), share, angle, left=0.0)
    flat = phase(np.maximum(angle, straight_rad)) / kept
    return Particles(np.log(flat), np.cos(drawn), kept)
