"""`aucamp calibrate gamma`: how a camera codes light, from tags that it sees out of focus.

Blur spreads light evenly to both sides of an edge. So along a line across a black edge on white the light is half-way
up where the centroid of its gradient is. Where bytes are made light by a wrong gamma the two come apart, the
farther the wider the blur. Paper, lamp and the water's veil scale light and add to it, which moves neither.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from agent.core.config import ConfigError
from agent.perception.landmarks.edge_line import Plane
from agent.perception.landmarks.edges import light_of_bytes, module_px
from agent.perception.landmarks.slopes import Array
from agent.perception.landmarks.tags import all_tags, green
from agent.process.command import Progress, with_bar
from agent.tools.calibration_file import check_file, put
from agent.tools.list_tags import plain_camera
from hw.camera.camera import Image
from hw.picture_files import picture_files, read_picture

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
    fit = with_bar(console, "looking for blurred tags", lambda show: gamma_of_folder(folder, show))
    low, high = fit.blur_px
    console.print(
        f"gamma {fit.gamma:.2f} +- {fit.sigma:.2f}, from {fit.tags} tags in {fit.pictures} pictures, "
        f"blurred by {low:.0f} to {high:.0f} px"
    )
    if out is not None and kept is not None:
        console.print(put(out, "camera", {**kept, "gamma": round(fit.gamma, 3)}, folder))
    return fit


def gamma_of_folder(folder: Path, progress: Progress) -> Gamma:
    """The gamma of all pictures of a folder. Progress counts pictures. Raises ConfigError where they cannot say it."""
    paths = picture_files(folder)
    gammas, blurs_px, showing = [], [], 0
    for done, path in enumerate(paths, start=1):
        found = gammas_of_picture(read_picture(path))
        gammas += [gamma for gamma, _ in found]
        blurs_px += [blur_px for _, blur_px in found]
        showing += bool(found)
        progress(done, len(paths))
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
