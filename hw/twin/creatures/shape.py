"""The body that an attitude gives a creature: ellipsoids along a midline that bends as it swims.

The midline's offset to the side at s, from nose (0) to tail (1), is (C1 s + C2 s^2) sin(k s - phase), one wave in a
length, a tenth of the length wide at the tail (Barrett, Triantafyllou et al., J. Fluid Mech. 392, 1999, of a tuna).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.creatures.swimmer import Attitude
from hw.twin.optics.view import FISH_MATERIALS, Ellipsoid, Swimming
from hw.twin.physics.rotation import matrix, quaternion
from hw.twin.scene import Creature, generator

C1, C2, WAVES = 0.02, 0.08, 1.0


class Part(NamedTuple):
    """An ellipsoid in shares of the length: where on the midline, half its length, width and height, how far up."""

    s: float
    long: float
    wide: float
    high: float
    up: float = 0.0


PARTS = (
    Part(0.12, 0.12, 0.050, 0.080),  # head
    Part(0.28, 0.17, 0.065, 0.120),
    Part(0.46, 0.18, 0.060, 0.115),
    Part(0.63, 0.15, 0.042, 0.080),
    Part(0.78, 0.11, 0.022, 0.045),
    Part(0.92, 0.08, 0.008, 0.120),  # tail fin
    Part(0.42, 0.13, 0.006, 0.050, up=0.12),  # back fin
)


def swimming(creature: Creature, attitude: Attitude, seed: int) -> Swimming:
    """The ellipsoids of a creature, world frame. Its pattern is its own, or that of whom it looks like."""
    across_m, up_m = _pattern_m(seed, creature.like or creature.name)
    length_m, material = creature.length_m, FISH_MATERIALS[creature.colour]
    middle_m = np.array(attitude[:3])
    axes = np.asarray(matrix(quaternion(0.0, -attitude.pitch_rad, attitude.heading_rad)))
    parts = []
    for part in PARTS:
        ahead_m = (0.5 - part.s) * length_m
        side, slope = bend(part.s, attitude.beat_rad, attitude.width)
        centre_m = middle_m + axes @ np.array((ahead_m, side * length_m, part.up * length_m))
        radii_m = (part.long * length_m, part.wide * length_m, part.high * length_m)
        pattern_m = (across_m + ahead_m, up_m + part.up * length_m)
        parts.append(Ellipsoid(centre_m, axes @ _turned(slope), radii_m, material, pattern_m))
    return Swimming(creature.name, tuple(parts))


def bend(s: float, beat_rad: float, width: float) -> tuple[float, float]:
    """The midline's offset to the left at s, in lengths, and the angle (rad) by which it points to the left there."""
    wide, wider = width * (C1 * s + C2 * s * s), width * (C1 + 2 * C2 * s)
    k = 2 * math.pi * WAVES
    phase = k * s - beat_rad
    per_s = wider * math.sin(phase) + wide * k * math.cos(phase)
    return wide * math.sin(phase), math.atan(-per_s)  # s counts backwards


@lru_cache(maxsize=64)
def _pattern_m(seed: int, name: str) -> tuple[float, float]:
    """Which part of the texture a creature wears."""
    across_m, up_m = generator(seed, name, "pattern").uniform(0.0, 0.2, 2).tolist()
    return across_m, up_m


def _turned(angle_rad: float) -> NDArray[np.float64]:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
