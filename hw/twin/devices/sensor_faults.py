"""What is broken between the water and the firmware: sensors and the leak probe, robot by robot.

Sensors are counted from 1 to 4, as on the paper's drawings. A fault lasts until `mend`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hw.twin.devices.board import ALL_SENSORS


class SensorFaults:
    """The faults of all robots, none at first."""

    def __init__(self, robots: int) -> None:
        self.answered = [ALL_SENSORS] * robots  # bit masks of the sensors that do
        self.leak = [False] * robots
        self._stuck_pa = np.full((robots, 4), np.nan)
        self._offset_pa = np.zeros((robots, 4))
        self._last_pa = np.zeros((robots, 4))
        self._any = False

    def corrupt(self, readings_pa: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 4) readings as they arrive, from those of sensors that are well; a dead one reads 0."""
        if self._any:
            stuck = ~np.isnan(self._stuck_pa)
            readings_pa = np.where(stuck, self._stuck_pa, readings_pa + self._offset_pa)
            bits = (np.array(self.answered)[:, None] >> np.arange(4)) & 1
            readings_pa = readings_pa * bits
        self._last_pa = readings_pa
        return readings_pa

    def kill(self, robot: int, sensor: int) -> None:
        """The sensor does not answer any more."""
        self.answered[robot] &= ~(1 << self._index(sensor))
        self._any = True

    def stick(self, robot: int, sensor: int) -> None:
        """The sensor repeats its last reading."""
        k = self._index(sensor)
        self._stuck_pa[robot, k] = self._last_pa[robot, k]
        self._any = True

    def shift(self, robot: int, sensor: int, offset_pa: float) -> None:
        """The sensor reads too much, by more each time that this is called."""
        self._offset_pa[robot, self._index(sensor)] += offset_pa
        self._any = True

    def mend(self, robot: int, sensor: int) -> None:
        """The sensor is well again."""
        k = self._index(sensor)
        self.answered[robot] |= 1 << k
        self._stuck_pa[robot, k], self._offset_pa[robot, k] = np.nan, 0.0

    @staticmethod
    def _index(sensor: int) -> int:
        if sensor not in range(1, 5):
            raise ValueError(f"no sensor {sensor}; they are 1 to 4")
        return sensor - 1
