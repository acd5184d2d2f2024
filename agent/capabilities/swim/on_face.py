"""A tag anywhere in space, as a fleet file says it: on which face of the tank it lies, and how it is turned there."""

from __future__ import annotations

import math

from agent.capabilities.swim.layout import SEEN
from agent.core.config import Face, Tag, Tank
from agent.core.messages import Vector

LEAN_DEG = 10.0  # from its face: what leans more was put elsewhere
OFF_M = 0.02  # from its face: a plate is thinner


def on_face(
    id: int,
    middle_m: Vector,
    right: Vector,
    up: Vector,
    tank: Tank,
    off_m: float = OFF_M,
    lean_deg: float = LEAN_DEG,
) -> Tag | str:
    """The tag, its middle as it is; or why it lies on no wall or floor. right, up: its own, as seen, unit vectors."""
    out = _cross(right, up)
    face = max(SEEN, key=lambda one: _dot(out, _cross(*SEEN[one])))
    seen_right, seen_up = SEEN[face]
    leans_deg = math.degrees(math.acos(min(_dot(out, _cross(seen_right, seen_up)), 1.0)))
    if leans_deg > lean_deg:
        return f"tag {id} lies on no wall or floor: it leans from {face}, the nearest, by {leans_deg:.0f} degrees"
    axis, at_m = plane(face, tank)
    if abs(middle_m[axis] - at_m) > off_m:
        name = "xyz"[axis]
        return (
            f"tag {id} lies on no wall or floor: it looks as if on {face}, where {name} is {at_m:g} m, "
            f"and its {name} is {middle_m[axis]:.3g} m"
        )
    turn = math.atan2(_dot(right, seen_up), _dot(right, seen_right))
    return Tag(id=id, face=face, position_m=middle_m, turn_deg=math.degrees(turn))


def plane(face: Face, tank: Tank) -> tuple[int, float]:
    """Which coordinate is the same all over a face, and what it is."""
    if face == "floor":
        return 2, 0.0
    axis = "xy".index(face[0])
    return axis, tank.size_m[axis] if face[1] == "1" else 0.0


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
