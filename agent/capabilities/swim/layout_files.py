"""Maps of tags in files of their own: `[landmarks] file`, by a survey of ours, or as others write them.

apriltag_ros (tags.yaml, its README): a bundle is a layout of tags in one frame; a tag's own axes are right, up and out
of it, as seen. WPILib (AprilTagFieldLayout): x out of the tag, y to the right as seen, z up; no size. Of either the
frame has to be the tank's: origin at the lower left corner of the floor, z up, metres.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from agent.capabilities.swim.on_face import on_face
from agent.core.config import ConfigError, Landmarks, Positive, Struct, Tank, convert, read_toml
from agent.core.messages import Vector

MOST_IDS = 587  # of the family 36h11
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
    bundles = _read(path, RosFile, msgspec.yaml.decode).tag_bundles or []
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
    for tag in _read(path, FieldLayout, msgspec.json.decode).tags:
        at, q = tag.pose.translation, tag.pose.rotation.quaternion
        if at.keys() != {"x", "y", "z"}:
            raise ConfigError(f"{path}: tag {tag.ID} lacks one of x, y, z; add it")
        _, right, up = _axes(q.W, q.X, q.Y, q.Z, tag.ID, path)
        placed.append(Placed(tag.ID, (at["x"], at["y"], at["z"]), right, up))
    return placed


def _read(path: Path, kind: Any, decode: Any) -> Any:
    try:
        return decode(path.read_bytes(), type=kind)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); correct `file` in [landmarks]") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        why = str(error).splitlines()[0] if str(error) else "nested too deeply"
        raise ConfigError(f"{path}: no layout of tags: {why}; give the file as the other program wrote it") from None


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
