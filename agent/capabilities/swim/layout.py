"""Where the corners of landmarks are in the world, and how they move with the errors of a survey.

A face is looked at from the water, square on. On a wall up is up; on the floor, which is looked at from above, up is
+y. Right is what is on the right hand then. A tag is upright where its own up is the face's; `turn_deg` turns it
anticlockwise as it is seen.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.core.config import Face, Landmarks, Tag
from agent.core.messages import Vector

Corners = tuple[Vector, Vector, Vector, Vector]

# face -> (right, up) as seen from the water, unit vectors of the world
SEEN: dict[Face, tuple[Vector, Vector]] = {
    "x0": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "x1": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "y0": ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "y1": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "floor": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
}
# Corners in the order of step_io.SeenTag: clockwise as seen, from the upper left; right and up, half sides.
ORDER = ((-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))


class Marker(NamedTuple):
    """One landmark as the survey has it, world frame, m."""

    id: int
    middle_m: Vector
    corners_m: Corners


def markers(landmarks: Landmarks) -> dict[int, Marker]:
    """All landmarks by their ids, in the order of these."""
    tags = sorted(landmarks.tag, key=lambda tag: tag.id)
    return {tag.id: Marker(tag.id, tag.position_m, corners(tag, landmarks.size_m)) for tag in tags}


def axes(tag: Tag) -> tuple[Vector, Vector]:
    """The tag's own right and up as it is seen: unit vectors of the world."""
    right, up = SEEN[tag.face]
    c, s = math.cos(math.radians(tag.turn_deg)), math.sin(math.radians(tag.turn_deg))
    return _sum(c, right, s, up), _sum(-s, right, c, up)


def corners(tag: Tag, size_m: float) -> Corners:
    """Its corners in the world, m, in the order of step_io.SeenTag."""
    right, up = axes(tag)
    x, y, z = tag.position_m
    half = 0.5 * size_m
    a, b, c, d = (
        (x + half * e[0], y + half * e[1], z + half * e[2]) for e in (_sum(p, right, q, up) for p, q in ORDER)
    )
    return a, b, c, d


def survey_jacobian(middle_m: Vector, corner_m: Vector) -> tuple[tuple[float, ...], ...]:
    """d corner / d (shift x, y, z; small turn about x, y, z through the tag's middle), 3 x 6, world frame."""
    x, y, z = corner_m[0] - middle_m[0], corner_m[1] - middle_m[1], corner_m[2] - middle_m[2]
    return (1.0, 0.0, 0.0, 0.0, z, -y), (0.0, 1.0, 0.0, -z, 0.0, x), (0.0, 0.0, 1.0, y, -x, 0.0)


def _sum(p: float, a: Vector, q: float, b: Vector) -> Vector:
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]
