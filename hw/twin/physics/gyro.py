"""The yaw gyro of each robot that has one: an ICM-42688-P lying flat in the hull, 100 readings a second.

Figures of its data sheet (TDK InvenSense DS-000347): noise, zero offset and its drift with temperature, error of scale.
How straight it is mounted, what the thrusters shake and how fast the offset wanders are estimates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hw.firmware.wire import NO_RATE
from hw.twin.physics.tank import TICK_NS
from hw.twin.scene import generator

TICK_S = TICK_NS * 1e-9
ZERO_DEG_S = 0.5  # standard deviation of the offset
SCALE = 0.005  # and of the scale
MOUNTED_RAD = math.radians(1.0)  # and of either tilt of its axis, by which it hears roll and pitch
LOW_PASS_HZ = 25.0  # as the firmware sets it
FOLLOWS = 1.0 - math.exp(-2.0 * math.pi * LOW_PASS_HZ * TICK_S)  # share of a change that has passed after a reading
NOISE_DEG_S = math.hypot(0.0028 * math.sqrt(LOW_PASS_HZ), 0.05)  # of one reading: its own, and the thrusters'
WALK_DEG_S = 0.002  # per root second, of the offset: 0.005 deg/s for each kelvin by which it warms
FULL_SCALE_CDEG_S = 25_013
BLOCK = 256  # readings whose noise is drawn at a time


class Gyros:
    """Those of a fleet; each robot's errors come from a stream of its own."""

    def __init__(self, seed: int, robots: Sequence[str], fitted: bool) -> None:
        self._rngs = [generator(seed, robot, "gyro") for robot in robots] if fitted else []
        rows = [(rng.normal(0, ZERO_DEG_S), rng.normal(0, SCALE), *rng.normal(0, MOUNTED_RAD, 2)) for rng in self._rngs]
        errors = np.array(rows).reshape(-1, 4)
        self._zero_deg_s, scale, about = errors[:, 0].copy(), errors[:, 1], errors[:, 2:]
        self._axes = np.column_stack([about, 1.0 + scale])  # (n, 3), body frame
        self._passed_deg_s = np.zeros(len(self._rngs))
        self._draws = np.zeros((BLOCK, len(self._rngs), 2))
        self._drawn = 0
        self._robots = list(robots)
        self._failed: dict[int, int] = {}  # what those say that are broken
        self._told = [NO_RATE] * len(robots)

    def read(self, rates_rad_s: NDArray[np.float64]) -> list[int]:
        """What each says a tick after the last: hundredths of a degree a second, NO_RATE of a robot without one.

        rates_rad_s: (n, 3), body frame.
        """
        if not self._rngs:
            return self._told
        if self._drawn % BLOCK == 0:
            self._draws[:] = np.stack([rng.standard_normal((BLOCK, 2)) for rng in self._rngs], axis=1)
        noise, walk = self._draws[self._drawn % BLOCK].T
        self._drawn += 1
        self._zero_deg_s += WALK_DEG_S * math.sqrt(TICK_S) * walk
        turning_deg_s = np.degrees((self._axes * rates_rad_s).sum(axis=1))
        self._passed_deg_s += FOLLOWS * (turning_deg_s - self._passed_deg_s)
        says = np.rint(100.0 * (self._passed_deg_s + self._zero_deg_s + NOISE_DEG_S * noise))
        told = np.clip(says, -FULL_SCALE_CDEG_S, FULL_SCALE_CDEG_S).astype(int).tolist()
        self._told = [self._failed.get(i, rate) for i, rate in enumerate(told)]
        return self._told

    def fail(self, robot: str, stuck: bool) -> None:
        """It does not answer any more, or repeats its last reading."""
        i = self._robots.index(robot)
        self._failed[i] = self._told[i] if stuck else NO_RATE
