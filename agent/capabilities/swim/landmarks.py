"""Landmarks: where the corners of tags are in the world, and how they move with the errors of a survey; maps of tags in
files; and where to turn the camera for tags.

A face is looked at from the water, square on. On a wall up is up; on the floor, which is looked at from above, up is
+y. Right is what is on the right hand then. A tag is upright where its own up is the face's; `turn_deg` turns it
anticlockwise as it is seen.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec
import yaml

from agent.core.codec import MOST_DEEP, too_deep
from agent.core.config import (
    ConfigError,
    Face,
    Landmarks,
    Positive,
    Struct,
    Tag,
    Tank,
    check_numbers,
    convert,
    read_text,
    read_toml,
)
from agent.core.linear_algebra import cross, difference
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


def normal(marker: Marker) -> Vector:
    """The way a landmark faces: into the water, as long as its area, m^2."""
    a, b, _, d = marker.corners_m
    return cross(difference(b, a), difference(a, d))


def facing(marker: Marker, from_m: Vector) -> float:
    """Cosine between a landmark's normal and the way from it to a point."""
    out, way = normal(marker), difference(from_m, marker.middle_m)
    along = out[0] * way[0] + out[1] * way[1] + out[2] * way[2]
    return along / max(math.hypot(*out) * math.hypot(*way), 1e-9)


def _sum(p: float, a: Vector, q: float, b: Vector) -> Vector:
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]


# --- faces of the tank ---
# A tag anywhere in space, as a fleet file says it: on which face of the tank it lies, and how it is turned there.

LEAN_DEG = 10.0  # from its face: what leans more was put elsewhere
OFF_M = 0.02  # from its face: a plate is thinner


def on_face(
    id: int, middle_m: Vector, right: Vector, up: Vector, tank: Tank, off_m: float = OFF_M, lean_deg: float = LEAN_DEG
) -> Tag | str:
    """The tag, its middle as it is; or why it lies on no wall or floor. right, up: its own, as seen, unit vectors."""
    out = cross(right, up)
    face = max(SEEN, key=lambda one: _dot(out, cross(*SEEN[one])))
    seen_right, seen_up = SEEN[face]
    leans_deg = math.degrees(math.acos(min(_dot(out, cross(seen_right, seen_up)), 1.0)))
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


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


# --- map files ---
# Maps of tags in files of their own: `[landmarks] file`, by `aucamp calibrate landmarks`, or as others write them.
#
# apriltag_ros (tags.yaml, its README): a bundle is a layout of tags in one frame; a tag's own axes are right, up and
# out of it, as seen. WPILib (AprilTagFieldLayout): x out of the tag, y to the right as seen, z up; no size. Of either
# the frame has to be the tank's: origin at the lower left corner of the floor, z up, metres.

MOST_IDS = 587  # of the family 36h11
TOO_DEEP = "nested too deeply, or with aliases"
DIGITS = 9  # of what was computed from a quaternion: a nanometre


class Beside(Struct, frozen=True, kw_only=True):
    """[landmarks] of a fleet file whose tags are in another file."""

    file: str
    family: Literal["36h11"] = "36h11"
    size_m: Positive | None = None
    sigma_m: float | None = None
    sigma_deg: float | None = None


class FleetPart(Struct, frozen=True, kw_only=True):
    """Names the keys of mistakes as the fleet file spells them."""

    landmarks: Beside


class SurveyFile(Struct, frozen=True, kw_only=True):
    landmarks: Landmarks


class RosTag(msgspec.Struct):
    id: int
    size: float
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    qw: float = 1.0
    qx: float = 0.0
    qy: float = 0.0
    qz: float = 0.0


class RosBundle(msgspec.Struct):
    layout: list[RosTag]


class RosFile(msgspec.Struct):
    tag_bundles: list[RosBundle] | None = None  # standalone tags have no place


class Quaternion(msgspec.Struct):
    W: float
    X: float
    Y: float
    Z: float


class Rotation(msgspec.Struct):
    quaternion: Quaternion


class RosPose(msgspec.Struct):
    translation: dict[Literal["x", "y", "z"], float]
    rotation: Rotation


class FieldTag(msgspec.Struct):
    ID: int
    pose: RosPose


class FieldLayout(msgspec.Struct):
    tags: list[FieldTag]


class Placed(NamedTuple):
    """A tag as a file has it; right and up as seen, unit vectors."""

    id: int
    middle_m: Vector
    right: Vector
    up: Vector


def landmarks_of(table: Any, fleet: Path, tank: Tank) -> Landmarks:
    """The table [landmarks] of a fleet file that names a file, read from there. Raises ConfigError with one line."""
    beside = convert({"landmarks": table}, FleetPart, fleet).landmarks
    path = fleet.parent / beside.file
    match path.suffix:
        case ".toml":
            found = convert(read_toml(path), SurveyFile, path).landmarks
        case ".yaml" | ".yml":
            found = _on_faces(*_bundle(path), beside, path, tank)
        case ".json":
            found = _on_faces(_field(path), None, beside, path, tank)
        case _:
            raise ConfigError(
                f"{fleet}: key 'landmarks.file': '{beside.file}' is none of .toml (a survey), .yaml (apriltag_ros) and "
                ".json (WPILib); give one of these"
            )
    if beside.size_m not in (None, found.size_m):
        raise ConfigError(
            f"{path}: its tags are of {found.size_m:g} m, and {fleet} says size_m = {beside.size_m:g}; correct one"
        )
    said = {key: value for key in ("sigma_m", "sigma_deg") if (value := getattr(beside, key)) is not None}
    return convert({**msgspec.to_builtins(found), **said}, Landmarks, path)


def _on_faces(placed: list[Placed], size_m: float | None, beside: Beside, path: Path, tank: Tank) -> Landmarks:
    size_m = size_m or beside.size_m
    if size_m is None:
        raise ConfigError(f"{path}: does not say how large its tags are; add size_m beside `file` in [landmarks]")
    tags = []
    for one in placed:
        if not 0 <= one.id < MOST_IDS:
            raise ConfigError(f"{path}: tag {one.id} is none of the family 36h11, ids 0 to {MOST_IDS - 1}; take it out")
        tag = on_face(one.id, one.middle_m, one.right, one.up, tank)
        if isinstance(tag, str):
            raise ConfigError(f"{path}: {tag}; correct the file, or [tank]: its frame has to be the tank's")
        tags.append(msgspec.structs.replace(tag, turn_deg=round(tag.turn_deg, DIGITS)))
    return Landmarks(size_m=size_m, tag=tuple(tags))


def _bundle(path: Path) -> tuple[list[Placed], float]:
    bundles = _read(path, RosFile, _yaml).tag_bundles or []
    if len(bundles) != 1 or not bundles[0].layout:
        what = f"{len(bundles)} bundles, each in a frame of its own" if len(bundles) > 1 else "no bundle with a layout"
        raise ConfigError(f"{path}: has {what}; give one in `tag_bundles`, in the tank's frame: only that has places")
    layout = bundles[0].layout
    if odd := next((tag for tag in layout if tag.size != layout[0].size), None):
        raise ConfigError(
            f"{path}: tag {odd.id} is of {odd.size:g} m and tag {layout[0].id} of {layout[0].size:g} m; all have to be "
            "of one size"
        )
    placed = []
    for tag in layout:
        right, up, _ = _axes(tag.qw, tag.qx, tag.qy, tag.qz, tag.id, path)
        placed.append(Placed(tag.id, (tag.x, tag.y, tag.z), right, up))
    return placed, layout[0].size


def _field(path: Path) -> list[Placed]:
    placed = []
    for tag in _read(path, FieldLayout, _json).tags:
        at, q = tag.pose.translation, tag.pose.rotation.quaternion
        if at.keys() != {"x", "y", "z"}:
            raise ConfigError(f"{path}: tag {tag.ID} lacks one of x, y, z; add it")
        _, right, up = _axes(q.W, q.X, q.Y, q.Z, tag.ID, path)
        placed.append(Placed(tag.ID, (at["x"], at["y"], at["z"]), right, up))
    return placed


def _read(path: Path, kind: Any, decode: Any) -> Any:
    text = read_text(path, "correct `file` in [landmarks]")
    try:
        found = decode(text, kind)
    except (msgspec.DecodeError, yaml.YAMLError, ValueError) as error:
        why = str(error).splitlines()[0]
        raise ConfigError(f"{path}: no layout of tags: {why}; give the file as the other program wrote it") from None
    check_numbers(found, path)
    return found


def _json(text: str, kind: Any) -> Any:
    if too_deep(text):
        raise ValueError(TOO_DEEP)
    return msgspec.json.decode(text, type=kind)


def _yaml(text: str, kind: Any) -> Any:
    """In YAML indents and dashes nest as well, and an alias is as large as what it stands for."""
    depth = 0
    for event in yaml.parse(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MOST_DEEP or isinstance(event, yaml.AliasEvent):
            raise ValueError(TOO_DEEP)
    return msgspec.yaml.decode(text, type=kind)


def _axes(w: float, x: float, y: float, z: float, id: int, path: Path) -> tuple[Vector, Vector, Vector]:
    """The turned x, y and z axes."""
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(norm - 1.0) < 0.01:
        raise ConfigError(f"{path}: tag {id}: its quaternion has length {norm:.3g}, not 1; correct it")
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
