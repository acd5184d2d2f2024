"""Water that flows, and tethers that pull: what each moment brings, as random processes with streams of their own.

The current is one velocity everywhere, walls or not: its constant part, and in x and y a gust that comes and goes
(Ornstein-Uhlenbeck, GUST_S). Water has mass: it follows both with a lag, so that its acceleration, which pushes a hull
as hard as it pushes the water that the hull displaces, is finite.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.kernel.messages import Vector
from hw.twin.scene import Current, Pull, generator

GUST_S = 4.0  # correlation time of what drives the gust; assumed
LAG_S = 1.0  # of the water behind it, and behind a current that is changed; assumed


class Flow:
    """The current of a tank and the pull at each robot's tether; `tick` writes both into the robots' states."""

    def __init__(self, seed: int, robots: Sequence[str], current: Current, pull: Pull) -> None:
        self.active = bool(any(current.velocity_m_s) or current.gust_m_s or pull.force_n)  # else `tick` does nothing
        self._mean_m_s = np.array(current.velocity_m_s)
        self._gust_m_s = current.gust_m_s * math.sqrt((GUST_S + LAG_S) / GUST_S)  # of the drive, whose lag takes a part
        self._drive_m_s = np.zeros(3)
        self._now_m_s = self._mean_m_s.copy()
        self._gusts = generator(seed, "gust")
        self._pulls = [Pulls(generator(seed, robot, "pull"), pull) for robot in robots]

    def set_current(self, velocity_m_s: Vector) -> None:
        """Another constant part from now on."""
        self._mean_m_s, self.active = np.array(velocity_m_s), True

    def pull(self, robot: int, pull: Pull, for_s: float) -> None:
        """Another pull at one tether, for so long."""
        self._pulls[robot].change(pull, for_s)
        self.active = True

    def tick(self, states: NDArray[np.void], dt_s: float) -> None:
        """What flows and pulls for the next dt_s."""
        if self._gust_m_s:
            self._drive_m_s[:2] = _wandered(self._drive_m_s[:2], self._gust_m_s, GUST_S, dt_s, self._gusts)
        speeding_m_s2 = (self._mean_m_s + self._drive_m_s - self._now_m_s) / LAG_S
        states["stirred"] = 1
        states["water_m_s"], states["water_m_s2"] = self._now_m_s, speeding_m_s2
        self._now_m_s += speeding_m_s2 * dt_s
        for i, pulls in enumerate(self._pulls):
            states[i]["pull_n"][:2] = pulls.tick(dt_s)


class Pulls:
    """The pull at one tether: horizontal, Ornstein-Uhlenbeck in each direction."""

    def __init__(self, rng: np.random.Generator, usual: Pull) -> None:
        self._rng, self._usual, self._now = rng, usual, usual
        self._force_n = np.zeros(2)
        self._left_s = math.inf

    def change(self, pull: Pull, for_s: float) -> None:
        self._now, self._left_s = pull, for_s

    def tick(self, dt_s: float) -> NDArray[np.float64]:
        if self._left_s <= 0:
            self._now, self._left_s = self._usual, math.inf
        self._left_s -= dt_s
        if self._now.force_n or self._force_n.any():
            each_n = self._now.force_n / math.sqrt(2)
            self._force_n = _wandered(self._force_n, each_n, self._now.correlation_s, dt_s, self._rng)
        return self._force_n


def _wandered(
    x: NDArray[np.float64], sigma: float, correlation_s: float, dt_s: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """An Ornstein-Uhlenbeck process dt_s later; exact, so that sigma holds whatever the step."""
    kept = math.exp(-dt_s / correlation_s)
    return kept * x + sigma * math.sqrt(1 - kept * kept) * rng.standard_normal(x.shape)
