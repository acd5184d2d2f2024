"""`aucamp tags SOURCE`: which AprilTags a picture, a folder, a video or a camera shows, and how well their corners.

One line a tag on standard output; with --out also the pictures, with the tags drawn in. And `aucamp calibrate gamma`,
how a camera codes light, from tags that are blurred.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from rich.console import Console

from agent.core.config import ConfigError
from agent.core.ranging.camera_model import CameraFit, load_calibration
from agent.perception.tags import Found, Plane, all_tags, green, light_of_bytes, module_px
from agent.process.command import Progress, plain_console, with_bar
from agent.robot.fleet_reader import load_fleet
from agent.tools.camera_calibration import Photographs
from agent.tools.enhance import Picture, Pictures, first_of, pictures
from agent.tools.focus_calibration import Array, check_file, put
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
    first, found = first_of(pictures(source, asked.frames))
    if camera is not None:
        check_size(first.image, camera, asked.calibration)
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


# --- `aucamp calibrate gamma` ---
# How a camera codes light, from tags that it sees out of focus.
#
# Blur spreads light evenly to both sides of an edge. So along a line across a black edge on white the light is half-
# way up where the centroid of its gradient is. Where bytes are made light by a wrong gamma the two come apart, the
# farther the wider the blur. Paper, lamp and the water's veil scale light and add to it, which moves neither.

LEAST, MOST = 0.6, 4.0  # gammas that are looked at
NARROWEST_BLUR_PX = 3.0  # diameter: a narrower edge is lopsided by less than its noise
WIDEST_BLUR = 0.6  # of a module: beyond it the code's blur comes within REACH of the border's edge
REACH = 0.5  # of a module to either side of the edge
PLATEAU = 0.1  # of a module: at either end, where no blur comes
PROFILES, FIRST, LAST = 41, 0.1, 0.9  # across each edge, from this to that share of its length
STEP_PX = 0.25
DARKEST, BRIGHTEST = 2.0, 250.0  # mean bytes of black and paper: beyond these light was cut off
FEWEST = 8  # tags: their scatter is what the answer's uncertainty is made of
ROUGHEST = 0.1  # standard deviation of the answer: twice as much moves corners by 0.1 px at a blur of 6 px
BISECTIONS = 20


class Gamma(NamedTuple):
    gamma: float
    sigma: float  # standard deviation
    tags: int
    pictures: int  # that showed them
    blur_px: tuple[float, float]  # diameters, from .. to


def calibrate_gamma(folder: Path, out: Path | None, console: Console) -> Gamma:
    """Fit, print, and put the result into [camera] of `out` if given. Raises ConfigError, one line."""
    kept = check_file(out).get("camera") if out is not None else None
    if out is not None and kept is None:
        raise ConfigError(f"{out}: has no table [camera] that a gamma could go to; make it by aucamp calibrate camera")
    shots = Photographs(folder)
    fit = with_bar(console, "looking for blurred tags", lambda show: gamma_of_folder(shots, show))
    for line in shots.said:
        console.print(line)
    low, high = fit.blur_px
    console.print(
        f"gamma {fit.gamma:.2f} +- {fit.sigma:.2f}, from {fit.tags} tags in {fit.pictures} pictures, "
        f"blurred by {low:.0f} to {high:.0f} px"
    )
    if out is not None and kept is not None:
        console.print(put(out, "camera", {**kept, "gamma": round(fit.gamma, 3)}, folder))
    return fit


def gamma_of_folder(shots: Photographs, progress: Progress) -> Gamma:
    """The gamma of all pictures of a folder. Progress counts pictures. Raises ConfigError where they cannot say it."""
    folder = shots.folder
    gammas, blurs_px, showing = [], [], 0
    for _, image in shots.read(progress):
        found = gammas_of_picture(image)
        gammas += [gamma for gamma, _ in found]
        blurs_px += [blur_px for _, blur_px in found]
        showing += bool(found)
    if len(gammas) < FEWEST:
        raise ConfigError(
            f"{folder}: {len(gammas)} tags are blurred by {NARROWEST_BLUR_PX:.0f} px to {WIDEST_BLUR} of a module and "
            f"neither black nor burnt out; {FEWEST} are needed: take more pictures, with the lens out of focus"
        )
    middle = float(np.median(gammas))
    # of a median: pi/2 of the variance of a mean
    sigma = 1.25 * 1.48 * float(np.median(np.abs(np.subtract(gammas, middle)))) / len(gammas) ** 0.5
    if sigma > ROUGHEST:
        raise ConfigError(
            f"{folder}: the tags say {middle:.2f} +- {sigma:.2f}, which is too rough; take larger tags and more light, "
            "and switch the camera's sharpening and contrast curve off"
        )
    return Gamma(middle, sigma, len(gammas), showing, (min(blurs_px), max(blurs_px)))


def gammas_of_picture(image: Image) -> list[tuple[float, float]]:
    """(gamma, diameter of the blur in px) that each tag of a picture says which can say one."""
    plane, out = green(image), []
    for one in all_tags(image, plain_camera(image)):
        module = module_px(one.corners_px)
        if one.blur_px is None or not NARROWEST_BLUR_PX <= one.blur_px <= WIDEST_BLUR * module:
            continue
        gamma = gamma_of_square(plane, one.corners_px, module)
        if gamma is not None:
            out.append((gamma, one.blur_px))
    return out


def gamma_of_square(plane: Plane, corners_px: Array, module: float) -> float | None:
    """The gamma at which the edges of a black square are blurred evenly to both sides.

    plane: (height, width) bytes. corners_px: (4, 2), clockwise as seen. None where light was cut off, an edge leaves
    the picture, or no gamma makes them even.
    """
    offsets_px = np.arange(-REACH * module, REACH * module + STEP_PX / 2, STEP_PX)
    edges = [_samples(plane, corners_px[k], corners_px[(k + 1) % 4], offsets_px) for k in range(4)]
    if any(each is None for each in edges):
        return None
    flat = max(int(PLATEAU * module / STEP_PX), 2)

    def lopsided_px(gamma: float) -> float:
        light = light_of_bytes(gamma)
        profiles = [(light[each.bytes] * each.weights).sum(axis=0).mean(axis=0) for each in edges if each is not None]
        return float(np.mean([_lopsided_px(profile, offsets_px, flat) for profile in profiles]))

    linear = [(each.bytes * each.weights).sum(axis=0).mean(axis=0) for each in edges if each is not None]
    if any(each[:flat].mean() < DARKEST or each[-flat:].mean() > BRIGHTEST for each in linear):
        return None
    low, high = LEAST, MOST
    if not lopsided_px(low) * lopsided_px(high) < 0.0:
        return None
    at_low = lopsided_px(low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if lopsided_px(middle) * at_low > 0.0 else (low, middle)
    return 0.5 * (low + high)


class _Samples(NamedTuple):
    bytes: Array  # (4, PROFILES, n): of the pixels around each place
    weights: Array  # the same shape: how much of each is in it


def _samples(plane: Plane, start: Array, end: Array, offsets_px: Array) -> _Samples | None:
    """Where PROFILES lines cross an edge, outwards: the square is on the right of who goes from start to end."""
    along = end - start
    outwards = np.array([along[1], -along[0]]) / np.hypot(*along)
    share = np.linspace(FIRST, LAST, PROFILES)[:, None, None]
    place = start + share * along + offsets_px[None, :, None] * outwards
    height, width = plane.shape
    if place.min() < 0.0 or (place.max(axis=(0, 1)) > (width - 2, height - 2)).any():
        return None
    corner = place.astype(int)
    u, v = np.moveaxis(place - corner, -1, 0)
    x, y = np.moveaxis(corner, -1, 0)
    around = np.stack([plane[y, x], plane[y, x + 1], plane[y + 1, x], plane[y + 1, x + 1]])
    return _Samples(around, np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v]))


def _lopsided_px(profile: Array, offsets_px: Array, flat: int) -> float:
    """How far the centroid of a step's gradient is outwards of where the step is half-way up."""
    black, white = profile[:flat].mean(), profile[-flat:].mean()
    risen = (profile - black) / (white - black)
    centroid = offsets_px[-1] - float(np.trapezoid(risen, offsets_px))
    k = int(np.argmax(risen >= 0.5))
    half = offsets_px[k] - (risen[k] - 0.5) / (risen[k] - risen[k - 1]) * STEP_PX
    return float(centroid - half)
