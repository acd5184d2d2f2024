"""Where robots and creatures were during the last two seconds, for cameras that expose at a time of their own."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw.camera.camera import CameraGone
from hw.twin.creatures.swimmer import Attitude
from hw.twin.physics.rotation import matrix
from hw.twin.physics.tank import TICK_NS

SPAN = 200  # ticks kept


class RobotPose(NamedTuple):
    position_m: NDArray[np.float64]  # (3,) centre of the hull, world
    rotation: NDArray[np.float64]  # (3, 3) body -> world
    pan_deg: float  # where the camera's gimbal truly points
    tilt_deg: float
    lamp_pan_deg: float = 0.0
    lamp_tilt_deg: float = 0.0
    lamp: float = 0.0  # its light, as a share of a mean lamp's at full power


class History:
    """A ring of the states at each tick. One thread appends; any number of threads wait and look."""

    def __init__(self, robots: int, start_ns: int, creatures: int = 0) -> None:
        self._rows = np.zeros((SPAN, robots, 12))  # position, quaternion, pan and tilt of camera and lamp, light
        self._swum = np.zeros((SPAN, creatures, len(Attitude._fields)))
        self._start_ns = start_ns
        self._newest = -1
        self._closed = False
        self._changed = threading.Condition()
        self._awaited_ns: float = np.inf  # waking nobody costs nothing: notify only when somebody's time has come

    def append(self, states: NDArray[np.void], creatures: Sequence[Attitude] = (), lamps: ArrayLike = 0.0) -> None:
        """The states one tick after those appended before; `lamps` (robots,): their light."""
        with self._changed:
            self._newest += 1
            row = self._rows[self._newest % SPAN]
            row[:, :3], row[:, 3:7], row[:, 7:11] = states["position_m"], states["quaternion"], states["shaft_deg"]
            row[:, 11] = lamps
            if creatures:
                self._swum[self._newest % SPAN] = creatures
            if self.newest_ns >= self._awaited_ns:
                self._awaited_ns = np.inf
                self._changed.notify_all()

    @property
    def newest_ns(self) -> int:
        return self._start_ns + self._newest * TICK_NS

    def wait(self, t_ns: int) -> None:
        """Return once the water has moved on to t_ns. Raises CameraGone when the twin ends before."""
        with self._changed:
            while self.newest_ns < t_ns and not self._closed:
                self._awaited_ns = min(self._awaited_ns, t_ns)
                self._changed.wait()
            if self._closed:
                raise CameraGone("the twin has ended; start it again")

    def at(self, t_ns: int) -> list[RobotPose]:
        """The pose of each robot at t_ns, interpolated between ticks.

        Raises CameraGone for a time that is not, or no longer, kept: the reader was stopped for too long.
        """
        # A tick turns a robot by a degree at most: the quaternions' mean is as good as the arc between them.
        rows = self._between(self._rows, t_ns)
        return [RobotPose(row[:3], matrix(row[3:7]), *row[7:].tolist()) for row in rows]

    def creatures_at(self, t_ns: int) -> list[Attitude]:
        """The attitude of each creature, as `at`."""
        return [Attitude(*row) for row in self._between(self._swum, t_ns).tolist()]

    def _between(self, kept: NDArray[np.float64], t_ns: int) -> NDArray[np.float64]:
        with self._changed:
            k, rest_ns = divmod(t_ns - self._start_ns, TICK_NS)
            oldest = max(self._newest - SPAN + 1, 0)
            if not oldest <= k < self._newest + (rest_ns == 0):
                raise CameraGone(f"no pose is kept of {t_ns} ns; ask again")
            before, after = kept[k % SPAN], kept[(k + (rest_ns > 0)) % SPAN]
            return np.asarray(before + (rest_ns / TICK_NS) * (after - before))

    def close(self) -> None:
        """Send everybody who waits home."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
