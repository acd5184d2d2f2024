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
SMALLEST_RAD = 1e-6
AIM_RAD = 5e-3
NONE = -60.0  # stands for the logarithm of nothing
ANGLES = 4096  # of the tables, even in the logarithm of the angle
DRAWS = 1 << 18


class Particles(NamedTuple):
    """Tables for the kernels."""

    log_phase: Array  # (ANGLES,) of the phase function per steradian, from SMALLEST_RAD to pi
    drawn_cos: Array  # (DRAWS,) cosines of scattering angles, equally likely
    log_aim: (
        Array  # (ANGLES,) as log_phase, of directions that are drawn about the lamp's: the same without a peak or hole
    )
    aimed_cos: Array  # (DRAWS,)
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
    even = (np.arange(DRAWS) + 0.5) / DRAWS
    straight = float(within(np.array([straight_rad]))[0])
    drawn = np.interp(straight + (1 - straight) * even, within(angle), angle)
    log_phase = np.where(angle >= straight_rad, np.log(phase(angle) / (1 - straight)), NONE)
    filled = phase(np.maximum(angle, max(straight_rad, AIM_RAD)))
    ring = np.pi * np.diff(-np.cos(angle)) * (filled[1:] + filled[:-1])
    share = np.concatenate([[0.0], np.cumsum(ring)])
    aimed = np.interp(even * share[-1], share, angle)
    return Particles(log_phase, np.cos(drawn), np.log(filled / share[-1]), np.cos(aimed), 1 - straight)
