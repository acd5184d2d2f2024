"""What really happened in a dive, for who judges it and never for an agent: truth.json, and of robots that swim paths.

truth.json is there from the start. paths.csv grows and separation.json is written at the end; both stay until the
folder's next twin. Lengths in metres, angles in degrees, times in ns of the dive's clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from hw.twin.landmarks import PaintedTag
from hw.twin.physics.body import HULL_M
from hw.twin.physics.forces import RING_M
from hw.twin.physics.rotation import euler_rad

PATHS, SEPARATION = "paths.csv", "separation.json"
HEAD = "t_ns,robot,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg,pan_deg,tilt_deg"
WATCH_TICKS = 5  # from look to look, 50 ms: two that pass each other at 0.5 m/s are seen within 0.3 mm of their closest
FLUSH = 20  # looks, a second


class Separation(msgspec.Struct):
    """How close robots came to each other and to walls; horizontal distances, for tethers do not pass each other."""

    least_m: float | None = None  # centre to centre; None: nobody was alone with anybody
    between: tuple[str, str] | None = None
    at_ns: int | None = None
    ring_overlaps: int = 0  # times that the thruster rings of two robots came to overlap
    hull_contacts: int = 0  # times that two hulls met, wherever in height
    wall_contacts: int = 0  # times that a hull came to a wall


class Watch:
    """Looks at a dive every WATCH_TICKS and keeps count; with a folder it writes the two files there too."""

    def __init__(self, robots: Sequence[str], size_m: Sequence[float], folder: Path | None = None) -> None:
        self.robots, self.separation = list(robots), Separation()
        self._size_m = np.array(size_m[:2])
        self._pairs = np.triu_indices(len(self.robots), 1)
        self._near = np.zeros((2, len(self._pairs[0])), bool)  # rings, hulls at the last look
        self._at_wall = np.zeros((len(self.robots), 4), bool)
        self._looks = 0
        self._folder = folder
        self._out: TextIO | None = (folder / PATHS).open("w", encoding="utf-8") if folder else None
        if self._out is not None:
            self._out.write(HEAD + "\n")

    def see(self, states: NDArray[np.void], t_ns: int) -> None:
        """The states at t_ns."""
        place_m = states["position_m"]
        first, second = self._pairs
        apart_m = place_m[first] - place_m[second]
        level_m = np.hypot(apart_m[:, 0], apart_m[:, 1])
        kept = self.separation
        if len(level_m) and (least_m := float(level_m.min())) < (np.inf if kept.least_m is None else kept.least_m):
            k = int(level_m.argmin())
            kept.least_m, kept.at_ns = least_m, t_ns
            kept.between = (self.robots[first[k]], self.robots[second[k]])
        near = np.stack([level_m < 2 * RING_M, np.linalg.norm(apart_m / HULL_M, axis=1) < 2])
        rings, hulls = np.sum(near & ~self._near, axis=1)
        at_wall = np.hstack([place_m[:, :2] < HULL_M[0], place_m[:, :2] > self._size_m - HULL_M[0]])
        kept.ring_overlaps += int(rings)
        kept.hull_contacts += int(hulls)
        kept.wall_contacts += int(np.sum(at_wall & ~self._at_wall))
        self._near, self._at_wall = near, at_wall
        if self._out is not None:
            for name, state in zip(self.robots, states, strict=True):
                self._out.write(f"{t_ns},{name},{','.join(f'{number:.5f}' for number in _pose(state))}\n")
            self._looks += 1
            if self._looks % FLUSH == 0:
                self._out.flush()

    def close(self) -> None:
        if self._out is None or self._folder is None:
            return
        self._out.close()
        self._out = None
        data = msgspec.json.format(msgspec.json.encode(self.separation), indent=1)
        (self._folder / SEPARATION).write_bytes(data + b"\n")


def _pose(state: np.void) -> list[float]:
    angles_deg = np.degrees(euler_rad(state["quaternion"]))
    return [*state["position_m"], *angles_deg, *state["shaft_deg"][:2]]


def tags_as_json(tags: Sequence[PaintedTag]) -> dict[str, Any]:
    """Where the tags truly are, by id: middle, axes (right, up, out as columns) and black edge to black edge."""
    return {
        str(tag.id): {"position_m": tag.position_m.tolist(), "rotation": tag.rotation.tolist(), "size_m": tag.size_m}
        for tag in tags
    }
