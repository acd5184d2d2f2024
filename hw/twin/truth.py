"""The truth about a dive: where tags, solids and targets really are, and where robots that swim really went.

It is for the twin itself and for the evaluation of a dive, never for an agent. Of the files in the twin's folder,
truth.json is there from the start, paths.csv grows, and separation.json is written at the end; the last two stay until
the folder's next twin. Lengths in metres, angles in degrees, times in ns of the dive's clock.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.config import Face, Fleet, Landmarks, Tag
from agent.core.messages import Vector
from hw.twin.physics.body import HULL_M, euler_rad, matrix, quaternion
from hw.twin.physics.forces import RING_M
from hw.twin.scene import Scene, Solid, generator

# --- tags: where the fleet file says, give or take its survey's errors ---
#
# A tag's own axes are right, up and out of its face, towards its viewer.

SIZE_SPREAD = 0.001  # of the printer's scale, at most; the fleet file's size is as measured

# The directions out of each face and up on it, in the world.
OUT_AND_UP: dict[Face, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "x0": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "x1": ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "y0": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "y1": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "floor": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
}


class PaintedTag(NamedTuple):
    """One square of the family 36h11 on a face of the tank."""

    id: int
    face: Face
    position_m: NDArray[np.float64]  # (3,) of its middle, world
    rotation: NDArray[np.float64]  # (3, 3) tag to world
    size_m: float  # black edge to black edge


def surveyed_tag(tag: Tag, size_m: float) -> PaintedTag:
    """The tag where the survey found it."""
    out, up = OUT_AND_UP[tag.face]
    axes = np.column_stack([np.cross(up, out), up, out])
    return PaintedTag(tag.id, tag.face, np.array(tag.position_m), axes @ _turned(0.0, 0.0, tag.turn_deg), size_m)


def true_tags(landmarks: Landmarks | None, seed: int) -> tuple[PaintedTag, ...]:
    """All tags where they are: each one's errors come from its own stream, so that one more changes no other."""
    return tuple(_true_tag(tag, landmarks, seed) for tag in landmarks.tag) if landmarks else ()


def _true_tag(tag: Tag, landmarks: Landmarks, seed: int) -> PaintedTag:
    rng = generator(seed, "tag", str(tag.id))
    said = surveyed_tag(tag, landmarks.size_m)
    shift_m, angles_deg = rng.normal(0, landmarks.sigma_m, 3), rng.normal(0, landmarks.sigma_deg, 3)
    size_m = said.size_m * rng.uniform(1 - SIZE_SPREAD, 1 + SIZE_SPREAD)
    return said._replace(
        position_m=said.position_m + shift_m, rotation=said.rotation @ _turned(*angles_deg), size_m=size_m
    )


def _turned(*angles_deg: float) -> NDArray[np.float64]:
    """(3, 3) by so much about x, y and z."""
    roll, pitch, yaw = (math.radians(angle) for angle in angles_deg)
    return matrix(quaternion(roll, pitch, yaw))


def tags_as_json(tags: Sequence[PaintedTag]) -> dict[str, Any]:
    """Where the tags truly are, by id: middle, axes (right, up, out as columns) and black edge to black edge."""
    return {
        str(tag.id): {"position_m": tag.position_m.tolist(), "rotation": tag.rotation.tolist(), "size_m": tag.size_m}
        for tag in tags
    }


# --- stage ---


class Move(NamedTuple):
    """One solid's way: straight, at one speed."""

    solid: int
    from_m: Vector
    to_m: Vector
    start_ns: int
    end_ns: int

    def at(self, t_ns: int) -> Vector:
        share = min(max((t_ns - self.start_ns) / (self.end_ns - self.start_ns), 0.0), 1.0)
        x, y, z = (a + share * (b - a) for a, b in zip(self.from_m, self.to_m, strict=True))
        return x, y, z


class Stage:
    """What stands in the tank at each time: solids that events move, tags that events take away.

    The answer about a time that has not passed may change later. One thread changes the stage.
    """

    def __init__(self, solids: Sequence[Solid], tags: Sequence[PaintedTag]) -> None:
        self._solids, self._tags = tuple(solids), tuple(tags)
        self._moves: list[Move] = []  # in order of time; a later one of the same solid ends the one before
        self._lost_ns: dict[int, int] = {}

    def move(self, solid: int, to_m: Vector, now_ns: int, over_s: float) -> None:
        """Move a solid from where it is, from now on."""
        here_m = self.solids(now_ns)[solid].position_m
        self._moves.append(Move(solid, here_m, to_m, now_ns, now_ns + round(over_s * 1e9)))

    def lose_tag(self, number: int, now_ns: int) -> None:
        self._lost_ns.setdefault(number, now_ns)

    def solids(self, t_ns: int) -> tuple[Solid, ...]:
        """All solids, in the order of the scene."""
        standing = list(self._solids)
        for move in self._moves:
            if t_ns >= move.start_ns:
                standing[move.solid] = msgspec.structs.replace(self._solids[move.solid], position_m=move.at(t_ns))
        return tuple(standing)

    def tags(self, t_ns: int) -> tuple[PaintedTag, ...]:
        """The tags that are still there."""
        if not self._lost_ns:
            return self._tags
        return tuple(tag for tag in self._tags if self._lost_ns.get(tag.id, t_ns + 1) > t_ns)


# --- solids that an event may move ---


def movable(fleet: Fleet, scene: Scene) -> list[int]:
    """Numbers of the solids that an event may move: stones, but for targets, whose place truth.json tells."""
    return [
        i for i, s in enumerate(scene.solid) if s.kind == "stone" and (s.name is None or s.name not in fleet.target)
    ]


# --- paths and separation of robots that swim ---

PATHS, SEPARATION = "paths.csv", "separation.json"
HEAD = "t_ns,robot,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg,pan_deg,tilt_deg"
WATCH_TICKS = 5  # from look to look, 50 ms: two that pass each other at 0.5 m/s are seen within 0.3 mm of their closest
FLUSH = 20  # looks, a second


class Separation(msgspec.Struct):
    """How close robots came to each other and to walls; horizontal distances, for tethers do not pass each other."""

    least_m: float | None = None  # centre to centre; None: there were no two robots
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
