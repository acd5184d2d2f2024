"""The lamp of each robot: what it takes from the pack, how warm it gets, and what is left of its light then.

A lamp of 15 W in the water that cools it. Its driver keeps to that power, and to less where it is hot or the pack low.
Figures are assumed, of the size of small underwater lamps; each robot's differs a little.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hw.twin.scene import generator

Array = NDArray[np.float64]

FULL_W = 15.0
LIGHT_SPREAD = 0.05  # of the light of one lamp and another at one power
WATER_C = 12.0
K_PER_W, K_SPREAD = 3.6, 0.15  # of the LED's plate above the water, through glue and housing
SETTLING_S = 90.0
HOT_C, HOTTEST_C = 60.0, 90.0  # light falls between them, in a straight line to nothing: a lamp settles before that
LOW_V, DEAD_V = 12.0, 10.0  # of the pack, between which the driver gives less and less


class Lamps:
    """All of a fleet. Dark and as warm as the water at the start."""

    def __init__(self, seed: int, robots: Sequence[str]) -> None:
        drawn = np.array([generator(seed, name, "lamp").uniform(-1, 1, 2) for name in robots]).reshape(-1, 2)
        self._brightness = 1 + LIGHT_SPREAD * drawn[:, 0]
        self._k_per_w = K_PER_W * (1 + K_SPREAD * drawn[:, 1])
        self.asked = np.zeros(len(robots))  # share of full power, by the pin
        self.output = np.zeros(len(robots))  # light, as a share of a mean lamp's at full power
        self.temperature_c = np.full(len(robots), WATER_C)
        self.current_a = np.zeros(len(robots))  # that they draw from their packs

    def tick(self, battery_v: Array, dt_s: float) -> None:
        """dt_s on packs (n,) of so many volts."""
        if not self.asked.any() and not self.current_a.any() and self.temperature_c.max() < WATER_C + 0.01:
            self.output[:] = 0.0
            return
        cool = np.clip((HOTTEST_C - self.temperature_c) / (HOTTEST_C - HOT_C), 0, 1)
        fed = np.clip((battery_v - DEAD_V) / (LOW_V - DEAD_V), 0, 1)
        share = np.clip(self.asked, 0, 1) * np.minimum(cool, fed)
        power_w = FULL_W * share
        self.current_a = power_w / np.maximum(battery_v, DEAD_V)
        self.output = self._brightness * share
        end_c = WATER_C + self._k_per_w * power_w
        self.temperature_c += (end_c - self.temperature_c) * -np.expm1(-dt_s / SETTLING_S)
