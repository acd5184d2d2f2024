"""What may not be in the table [landmarks] of a fleet file."""

from __future__ import annotations

import math
from collections.abc import Iterator

from agent.capabilities.swim.landmarks import OFF_M, axes, corners, plane
from agent.core.config import Landmarks, Tag, Tank

MODULES = 8  # black edge to black edge of the family 36h11; a white border of one belongs around it


def broken_landmark_rules(landmarks: Landmarks, tank: Tank) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    if not landmarks.tag:
        yield "landmarks.tag", "there is none; add one, or remove the table [landmarks]"
    first: dict[int, int] = {}
    for i, tag in enumerate(landmarks.tag):
        key = f"landmarks.tag[{i}]"
        if tag.id in first:
            yield f"{key}.id", f"tag {tag.id} is already tag[{first[tag.id]}]; a robot could not tell them apart"
        first.setdefault(tag.id, i)
        if (wrong := _wrong_place(tag, landmarks.size_m, tank)) is not None:
            yield f"{key}.position_m", wrong
        for other in landmarks.tag[:i]:
            if other.face == tag.face and _overlap(other, tag, landmarks.size_m):
                why = f"tag {tag.id} and tag {other.id} overlap on {tag.face}; leave {landmarks.size_m / MODULES:.3g} m"
                yield f"{key}.position_m", f"{why} of white between them"


def _wrong_place(tag: Tag, size_m: float, tank: Tank) -> str | None:
    """Why a tag cannot be there; None where it can."""
    axis, at_m = plane(tag.face, tank)
    if abs(tag.position_m[axis] - at_m) > OFF_M:
        name, is_m = "xyz"[axis], tag.position_m[axis]
        return f"{name} is {is_m:g} m, and {tag.face} lies at {name} = {at_m:g}; correct the place or the face"
    places = corners(tag, size_m)
    if max(z for _, _, z in places) > tank.surface_m:
        return f"tag {tag.id} reaches above the surface, at {tank.surface_m:g} m; lower it"
    for i, name in enumerate("xyz"):
        lowest, highest = min(p[i] for p in places), max(p[i] for p in places)
        if i != axis and (lowest < -1e-9 or highest > tank.size_m[i] + 1e-9):
            where = f"{name} from {lowest:.3g} to {highest:.3g} m"
            return f"tag {tag.id} reaches over the edge of {tag.face}, {where}; move it inwards"
    return None


def _overlap(a: Tag, b: Tag, size_m: float) -> bool:
    """Whether two squares of one face, with half a module of white around each, share a point.

    Convex figures are apart where one of their edges has them on its two sides (separating axis).
    """
    reach_m = 0.5 * size_m * (1.0 + 1.0 / MODULES)
    apart = [q - p for p, q in zip(a.position_m, b.position_m, strict=True)]
    turn = math.radians(b.turn_deg - a.turn_deg)
    span_m = reach_m * (1.0 + abs(math.cos(turn)) + abs(math.sin(turn)))  # of one along the other's edges, and its own
    return all(
        abs(sum(p * q for p, q in zip(apart, edge, strict=True))) < span_m - 1e-9 for edge in (*axes(a), *axes(b))
    )
