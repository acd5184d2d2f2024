"""Where the tags of a fleet file truly are: where it says, give or take its survey's errors. Hidden from the agents.

A tag's own axes are right, up and out of its face, towards who looks at it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.config import Face, Landmarks, Tag
from hw.twin.physics.rotation import matrix, quaternion
from hw.twin.scene import generator

SIZE_SPREAD = 0.001  # of the printer's scale, at most; the fleet file's size is what somebody measured

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
