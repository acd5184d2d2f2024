"""Veil of all orders of scattering over that of a single one, by a table of Monte Carlo.

Lengths count in scattering lengths, so that a table in (b times distance, share of scattering in attenuation, angle,
ratio of distances) holds for every water. veil_table.py says how it was made.
"""

from __future__ import annotations

import math

from agent.capabilities.light.veil_table import ANGLE_DEG, LOG_TIMES, RATIO, SCATTERING_SHARE, TAU
from agent.core.config import WaterOptics


def all_orders(depth_m: float, ahead_m: float, aside_m: float, water: WaterOptics) -> tuple[float, float, float]:
    """Factor on model.single_veil for each colour. depth_m: camera to target; the lamp, aimed at the target, is so far
    ahead of the camera and beside its axis. Beyond the table's ends its last values hold."""
    range_m = math.hypot(depth_m - ahead_m, aside_m)
    angle_deg = math.degrees(math.atan2(aside_m, depth_m - ahead_m))
    at_angle = _between(ANGLE_DEG, angle_deg)
    at_ratio = _between(RATIO, range_m / depth_m)
    blue, green, red = (
        _times(b * depth_m, b / (a + b), at_angle, at_ratio)
        for a, b in zip(water.absorption_per_m, water.scattering_per_m, strict=True)
    )
    return blue, green, red


def _times(tau: float, share: float, at_angle: tuple[int, float], at_ratio: tuple[int, float]) -> float:
    thin = min(tau / TAU[0], 1.0)  # in water so clear there is but one order
    corners = (_between(TAU, tau), _between(SCATTERING_SHARE, share), at_angle, at_ratio)
    total = 0.0
    for corner in range(16):
        weight, index = 1.0, 0
        for axis, ((i, part), size) in enumerate(zip(corners, SIZES, strict=True)):
            up = corner >> axis & 1
            weight *= part if up else 1.0 - part
            index = index * size + i + up
        total += weight * LOG_TIMES[index]
    return math.exp(total * thin)


def _between(nodes: tuple[float, ...], x: float) -> tuple[int, float]:
    """Index of the node below, and how far x is towards the next, 0 to 1."""
    for i in range(len(nodes) - 2):
        if x < nodes[i + 1]:
            break
    else:
        i = len(nodes) - 2
    return i, min(max((x - nodes[i]) / (nodes[i + 1] - nodes[i]), 0.0), 1.0)


SIZES = (len(TAU), len(SCATTERING_SHARE), len(ANGLE_DEG), len(RATIO))
