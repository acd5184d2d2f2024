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

from agent.core.messages import Vector
from hw.twin.physics.tank import TICK_NS
from hw.twin.scene import Current, Pull, generator

GUST_S = 4.0  # correlation time of what drives the gust; assumed
BLOCK = 256  # steps drawn at a time: a tick costs no call into the generators
TICK_S = TICK_NS * 1e-9
LAG_S = 1.0  # of the water behind it, and behind a current that is changed; assumed


class Flow:
    """The current of a tank and the pull at each robot's tether; `tick` writes both into the robots' states."""

    def __init__(self, seed: int, robots: Sequence[str], current: Current, pull: Pull) -> None:
        self.active = bool(any(current.velocity_m_s) or current.gust_m_s or pull.force_n)  # else `tick` does nothing
        self._mean_m_s = np.array(current.velocity_m_s)
        self._now_m_s = self._mean_m_s.copy()
        self._usual, self._left_s = pull, np.full(len(robots), math.inf)
        # One process a row, in x and y: what drives the gust, and the pull at each robot. The lag takes of the former.
        self._rngs = [generator(seed, "gust"), *(generator(seed, robot, "pull") for robot in robots)]
        self._noise, self._drawn = np.zeros((BLOCK, len(self._rngs), 2)), 0
        self._x = np.zeros((len(self._rngs), 2))
        self._kept, self._gain = np.zeros((len(self._rngs), 1)), np.zeros((len(self._rngs), 1))
        self._wander(0, current.gust_m_s * math.sqrt((GUST_S + LAG_S) / GUST_S), GUST_S)
        for i in range(len(robots)):
            self._wander(1 + i, pull.force_n / math.sqrt(2), pull.correlation_s)

    @property
    def velocity_m_s(self) -> Vector:
        """Of the water now."""
        x, y, z = self._now_m_s.tolist()
        return x, y, z

    def set_current(self, velocity_m_s: Vector) -> None:
        """Another constant part from now on."""
        self._mean_m_s, self.active = np.array(velocity_m_s), True

    def pull(self, robot: int, pull: Pull, for_s: float) -> None:
        """Another pull at one tether, for so long."""
        self._wander(1 + robot, pull.force_n / math.sqrt(2), pull.correlation_s)
        self._left_s[robot] = for_s
        self.active = True

    def tick(self, states: NDArray[np.void]) -> None:
        """What flows and pulls in the next tick."""
        for robot in np.flatnonzero(self._left_s <= 0).tolist():
            self.pull(robot, self._usual, math.inf)
        self._left_s -= TICK_S
        if self._drawn % BLOCK == 0:
            for i, rng in enumerate(self._rngs):
                self._noise[:, i] = rng.standard_normal((BLOCK, 2))
        self._x = self._kept * self._x + self._gain * self._noise[self._drawn % BLOCK]
        self._drawn += 1
        speeding_m_s2 = (self._mean_m_s - self._now_m_s) / LAG_S
        speeding_m_s2[:2] += self._x[0] / LAG_S
        states["stirred"] = 1
        states["water_m_s"], states["water_m_s2"] = self._now_m_s, speeding_m_s2
        states["pull_n"][:, :2] = self._x[1:]
        self._now_m_s += speeding_m_s2 * TICK_S

    def _wander(self, row: int, sigma: float, correlation_s: float) -> None:
        """Let a row be an Ornstein-Uhlenbeck process; exact, so that sigma holds whatever the step."""
        kept = math.exp(-TICK_S / correlation_s)
        self._kept[row], self._gain[row] = kept, sigma * math.sqrt(1 - kept * kept)
