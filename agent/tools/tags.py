"""`aucamp tags SOURCE`: which AprilTags a picture, a folder, a video or a camera shows, and how well their corners.

One line a tag on standard output; with --out also the pictures, with the tags drawn in.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from agent.core.config import ConfigError
from agent.core.ranging.camera_model import CameraFit, load_calibration
from agent.perception.tags import Found, all_tags
from agent.process.command import plain_console, with_bar
from agent.robot.fleet_reader import load_fleet
from agent.tools.enhance import Picture, Pictures, pictures
from agent.tools.track import AMBER, GREEN, RED, check_out, writer
from hw.camera.camera import Image

CORNERS = "x0_px,y0_px,x1_px,y1_px,x2_px,y2_px,x3_px,y3_px"
HEADER = f"picture,t_s,id,size_px,blur_px,state,{CORNERS}"
SHARP_PX = 2.0  # diameter of blur: what lens and sensor do of themselves
NAMES = 4  # of pictures without a tag that are named


class Asked(NamedTuple):
    """The options of `aucamp tags`."""

    calibration: Path | None = None
    fleet: Path | None = None
    frames: int | None = None
    out: Path | None = None


class Told(NamedTuple):
    """What there was to see in all pictures."""

    seen: dict[int, int]  # id -> in how many pictures
    double: set[int]  # ids of which a picture showed more than one
    empty: list[str]  # names of those without a tag
    pictures: int


def run(source: str, asked: Asked, say: Callable[[str], None]) -> bool:
    """Say HEADER and a line for each tag of each picture. Returns whether there was one, every picture could be read,
    and with a fleet file whether all tags are in it. Raises ConfigError and CameraError, one line each."""
    known = None if asked.fleet is None else known_ids(asked.fleet)
    camera = None if asked.calibration is None else load_calibration(asked.calibration).camera
    if asked.out is not None:
        check_out(asked.out)
    found = pictures(source, asked.frames)
    first = next(found.each)  # there is one, or the walk has said why not
    if camera is not None:
        check_size(first.image, camera, asked.calibration)
    found = found._replace(each=itertools.chain((first,), found.each))
    console = plain_console(stderr=True)
    with writer(asked.out, found.rate_hz) as show:
        say(HEADER)

        def walk(bar: Callable[[int, int], None]) -> Told:
            return look(found, camera, known, asked, show, say, bar)

        told = with_bar(console, "looking for tags", walk)
    for text in (*summary(told, known, asked.fleet), *found.notes, *found.problems):
        console.print(text, highlight=False, markup=False, soft_wrap=True)
    return bool(told.seen) and (known is None or known >= told.seen.keys()) and not found.problems


def known_ids(fleet: Path) -> frozenset[int]:
    """Ids of the fleet file's landmarks. Raises ConfigError."""
    landmarks = load_fleet(fleet).landmarks
    if landmarks is None:
        raise ConfigError(f"{fleet}: has no table [landmarks]; add it, or leave --fleet out")
    return frozenset(tag.id for tag in landmarks.tag)


def check_size(image: Image, camera: CameraFit, path: Path | None) -> None:
    height, width = image.shape[:2]
    if (width, height) != (camera.width_px, camera.height_px):
        raise ConfigError(
            f"{path}: calibrated for {camera.width_px}x{camera.height_px} pixels, and these pictures have "
            f"{width}x{height}; give pictures as the camera takes them, or leave --calibration out"
        )


def look(
    found: Pictures,
    camera: CameraFit | None,
    known: frozenset[int] | None,
    asked: Asked,
    show: Callable[[Image, str], None],
    say: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> Told:
    seen: dict[int, int] = {}
    double: set[int] = set()
    empty, count = [], 0
    for picture in found.each:
        if camera is not None:
            check_size(picture.image, camera, asked.calibration)
        tags = all_tags(picture.image, camera or plain_camera(picture.image))
        for one in tags:
            say(line(picture, one))
        for number in {one.seen.id for one in tags if one.alone}:
            seen[number] = seen.get(number, 0) + 1
        double |= {one.seen.id for one in tags if not one.alone}
        if not tags:
            empty.append(picture.name)
        show(annotated(picture.image, tags, known), picture.name)
        count += 1
        progress(count, found.total or count + 1)
    return Told(seen, double, empty, count)


def plain_camera(image: Image) -> CameraFit:
    """A camera that nobody has calibrated: straight lines are straight, a byte is light to the power of 1 / 2.2."""
    height, width = image.shape[:2]
    return CameraFit(width_px=width, height_px=height, f_px=width, cx_px=(width - 1) / 2, cy_px=(height - 1) / 2)


def state(one: Found) -> str:
    """sharp; blurred, and no worse for it; rough: no edges could be fitted, and corners are some 0.8 px off; double: it
    does not count, because another tag has its id."""
    if not one.alone:
        return "double"
    if one.blur_px is None:
        return "rough"
    return "sharp" if one.blur_px <= SHARP_PX else "blurred"


def line(picture: Picture, one: Found) -> str:
    t_s = "" if picture.t_s is None else f"{picture.t_s:.3f}"
    blur = "" if one.blur_px is None else f"{one.blur_px:.1f}"
    corners = ",".join(f"{place:.2f}" for place in one.corners_px.ravel())
    return f"{picture.name},{t_s},{one.seen.id},{one.seen.size_px:.1f},{blur},{state(one)},{corners}"


def summary(told: Told, known: frozenset[int] | None, fleet: Path | None) -> list[str]:
    """For people, after all lines."""
    ids = ", ".join(f"{number} ({count})" for number, count in sorted(told.seen.items()))
    out = [f"{told.pictures} pictures; ids, and in how many: {ids or 'none'}"]
    if told.empty and told.seen:
        more = ", ..." if len(told.empty) > NAMES else ""
        out.append(f"no tag in {len(told.empty)}: {', '.join(told.empty[:NAMES])}{more}")
    if told.double:
        out.append(f"more than once in a picture, where none of them counts: {_listed(sorted(told.double))}")
    if known is not None:
        strange, missed = sorted(told.seen.keys() - known), sorted(known - told.seen.keys())
        if strange:
            out.append(f"not in {fleet}: {_listed(strange)}; add where they hang, or take them away")
        if missed:
            out.append(f"in {fleet}, and not seen: {_listed(missed)}")
    return out


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))


def annotated(image: Image, tags: Sequence[Found], known: frozenset[int] | None) -> Image:
    """The picture with each tag's edges, its id, and a dot at its first corner: green where its edges were fitted,
    amber where they could not be, red where it does not count or the fleet file does not know it."""
    drawn = image.copy()
    for one in tags:
        strange = known is not None and one.seen.id not in known
        colour = RED if strange or not one.alone else GREEN if one.seen.edges else AMBER
        corners = np.round(8.0 * one.corners_px).astype(np.int32)  # in eighths of a pixel
        cv2.polylines(drawn, [corners.reshape(-1, 1, 2)], True, colour, 1, cv2.LINE_AA, 3)
        cv2.circle(drawn, tuple(map(int, corners[0])), 3 * 8, colour, -1, cv2.LINE_AA, 3)
        middle = one.corners_px.mean(axis=0)
        at = int(middle[0]) - 8, int(middle[1]) + 6
        cv2.putText(drawn, str(one.seen.id), at, cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 2, cv2.LINE_AA)
    return drawn
