"""Find one coloured animal of any shape: whatever has its hue against the greys of the same picture.

A body that bends, turns and swims away looks like no picture of it for long, but keeps its colours. Water makes all
that is grey bluish, the more the farther it is, and never redder: so colours are compared with the least bluish greys
of the frame, in the plane of chromaticity of logarithms of light (colour.py). What differs from these by enough, and in
the animal's hue, is a part of it; parts that lie together are one animal, and its box is around all of them. Each frame
stands alone: nothing has to be remembered, so nothing can be followed by mistake.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.config import Colour
from agent.perception.detection.colour import NAMED
from agent.perception.detection.picture import Image, Light, exposed

FINEST = 2  # pixels are looked at so many together, across and down
# Chosen on frames of the twin's koi (seeds 1, 2, 4, 11 and 12; others in tests/bench/swim/bench_creature.py): its
# orange has 0.37 to 1.1, a near stone before a far wall 0.35.
STRONG, WEAK = 0.40, 0.20  # difference of logarithms of light: of what is surely its colour, and of what belongs to it
LEAST_STRONG = 12  # of these larger pixels: in less there is no colour but noise
SLACK_RAD = 0.2  # beyond the hues of balls: no outline says what is paint and what is not
TURN_RAD = math.radians(15.0)  # of a sampled hue: the koi's is within 5 degrees of itself, other robots are 25 away
WARM = 0.35  # redder than that no grey is, by a camera's own white
GREYS = (75.0, 90.0)  # percentiles, of how red they are: the least bluish ones, and how red the reddest of them is
EVERY = 4  # of rows and columns, one is enough to know the greys
JOINED = 0.5  # of the larger part: what is nearer to it is of the same animal
PARTS = 40  # the largest
SAMPLED = 40  # of the larger pixels have to have a colour in a sample


class Hues(NamedTuple):
    """Which count, in radians as colour.py has them."""

    low_rad: float
    high_rad: float


class Blob(NamedTuple):
    """Pixels of the image, x0 <= x < x1."""

    x0: int
    y0: int
    x1: int
    y1: int
    strong: int  # of the larger pixels
    strength: float  # their mean


def named_hues(colour: Colour) -> Hues:
    model = NAMED[colour]
    return Hues(model.low_rad - SLACK_RAD, model.high_rad + SLACK_RAD)


def sampled_hues(image: Image, box: tuple[float, float, float, float]) -> Hues | None:
    """Those of what is in a box (x, y, width, height) of a picture; None where it is grey."""
    strength, hue = _chromaticity(image)
    x0, y0 = round(box[0] / FINEST), round(box[1] / FINEST)
    x1, y1 = round((box[0] + box[2]) / FINEST), round((box[1] + box[3]) / FINEST)
    inside = strength[y0:y1, x0:x1] > STRONG
    if np.count_nonzero(inside) < SAMPLED:
        return None
    at = hue[y0:y1, x0:x1][inside].astype(float)
    middle = math.atan2(float(np.sin(at).mean()), float(np.cos(at).mean()))
    return Hues(middle - TURN_RAD, middle + TURN_RAD)


def find_creature(image: Image, hues: Hues) -> Blob | None:
    """The one of an image (height, width, 3) blue green red that shows most of these hues; None if nothing does."""
    strength, hue = _chromaticity(image)
    middle = 0.5 * (hues.low_rad + hues.high_rad)
    off = np.abs(np.remainder(hue - middle + math.pi, 2.0 * math.pi) - math.pi)
    its = off <= 0.5 * (hues.high_rad - hues.low_rad)
    strong = its & (strength > STRONG)
    if np.count_nonzero(strong) < LEAST_STRONG:
        return None
    number, labels, stats, _ = cv2.connectedComponentsWithStats((its & (strength > WEAK)).view(np.uint8))
    counts = np.bincount(labels[strong], minlength=number)
    sums = np.bincount(labels[strong], strength[strong], minlength=number)
    largest = sorted(range(1, number), key=lambda k: -counts[k])[:PARTS]
    parts = [_part(stats[k], int(counts[k]), float(sums[k])) for k in largest if counts[k] >= LEAST_STRONG]
    if not parts:
        return None
    x0, y0, x1, y1, n, mean = max(_joined(parts), key=lambda part: part.strong)
    height, width = image.shape[:2]
    return Blob(FINEST * x0, FINEST * y0, min(FINEST * x1, width), min(FINEST * y1, height), n, mean)


def _chromaticity(image: Image) -> tuple[Light, Light]:
    """Of each of the larger pixels, how far from the picture's greys it is, and in which hue."""
    size = max(image.shape[1] // FINEST, 1), max(image.shape[0] // FINEST, 1)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    log_light = cv2.LUT(small, exposed(image).log_light)
    b, g, r = log_light[..., 0], log_light[..., 1], log_light[..., 2]
    red = cv2.GaussianBlur(np.asarray(r - np.float32(0.5) * (g + b)), (5, 5), 1.0)
    green = cv2.GaussianBlur(np.asarray(np.float32(math.sqrt(0.75)) * (g - b)), (5, 5), 1.0)
    some_red, some_green = red[::EVERY, ::EVERY].ravel(), green[::EVERY, ::EVERY].ravel()
    cold = some_red < WARM
    if np.count_nonzero(cold) > 0.02 * len(cold):
        some_red, some_green = some_red[cold], some_green[cold]
        least, most = np.percentile(some_red, GREYS)
        red = red - np.float32(most)
        green = green - np.float32(np.median(some_green[some_red >= least]))
    return np.asarray(np.hypot(red, green), np.float32), np.asarray(np.arctan2(green, red), np.float32)


def _part(row: NDArray[np.int32], strong: int, total: float) -> Blob:
    x, y, width, height = (int(side) for side in row[:4])
    return Blob(x, y, x + width, y + height, strong, total / strong)


def _joined(parts: list[Blob]) -> list[Blob]:
    """Boxes that lie together made one, until none do."""
    apart: list[Blob] = []
    for part in parts:
        while (other := next((one for one in apart if _near(one, part)), None)) is not None:
            apart.remove(other)
            part = _both(other, part)
        apart.append(part)
    return apart


def _near(a: Blob, b: Blob) -> bool:
    gap = max(max(a.x0, b.x0) - min(a.x1, b.x1), max(a.y0, b.y0) - min(a.y1, b.y1))
    return gap < JOINED * max(a.x1 - a.x0, a.y1 - a.y0, b.x1 - b.x0, b.y1 - b.y0)


def _both(a: Blob, b: Blob) -> Blob:
    n = a.strong + b.strong
    mean = (a.strong * a.strength + b.strong * b.strength) / n
    return Blob(min(a.x0, b.x0), min(a.y0, b.y0), max(a.x1, b.x1), max(a.y1, b.y1), n, mean)
