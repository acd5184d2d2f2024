"""Where in a picture a ball of a colour may be: spots that have more of its hue than what is around them.

The picture is looked at in octaves, each half as large as the one before, so that a ball of any size is a few pixels
large in one of them. In each, what stands out from its surroundings gives a spot: all that is connected above half of
its height. A small ball beside large coloured things is a spot of its own, with a threshold of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.perception.detection.colour import weights
from agent.perception.detection.picture import Light, Picture

Array = NDArray[np.float64]

FINEST = 2  # the first octave is this much smaller than the picture: a ball of 5 px radius is 5 px across
SMALLEST = 12  # pixels, of the last octave's shorter side
WINDOW = 24  # pixels of an octave around a peak in which its spot has to end
PEAKS = 4  # of each octave, the strongest
MIN_CONTRAST = 0.05  # of a peak against its surroundings, logarithm of light
NOISES = 4.0  # of the picture's own unrest
NEIGHBOURS = np.ones((7, 7), np.uint8)
SPOTS = 8  # the best are looked at closely


class Spot(NamedTuple):
    points: Array  # (n, 2) pixels of the picture, on its outline, without those on the picture's own border
    contrast: float
    rough: float  # how far its outline is from a circle: rms, share of its radius
    circle: tuple[float, float, float]  # u, v, radius of that circle, pixels


def spots(picture: Picture, hue_rad: float) -> list[Spot]:
    """The most promising spots, best first."""
    image = picture.image
    height, width = image.shape[0] // FINEST, image.shape[1] // FINEST
    if min(height, width) < SMALLEST:
        return []
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    plane = np.asarray(cv2.transform(cv2.LUT(small, picture.log_light), weights(hue_rad)[None]), np.float32)
    found: list[Spot] = []
    octave = 0
    while min(plane.shape) >= SMALLEST:
        scale = image.shape[1] / plane.shape[1], image.shape[0] / plane.shape[0]
        found += (one for one in _octave(plane, scale))
        if octave == 1:
            found += _largest_first(plane, scale)
        plane = np.asarray(cv2.resize(plane, (plane.shape[1] // 2, plane.shape[0] // 2), interpolation=cv2.INTER_AREA))
        octave += 1
    return _different(found)[:SPOTS]


def _octave(plane: Light, scale: tuple[float, float]) -> Iterator[Spot]:
    """Spots of one size of picture; `scale`: pixels of the whole one for each of its own, across and down."""
    fine = cv2.GaussianBlur(plane, (5, 5), 1.0)
    stands_out = cv2.subtract(cv2.GaussianBlur(fine, (7, 7), 1.5), cv2.blur(fine, (25, 25)))
    noise = float(np.median(np.abs(stands_out[::4, ::4])))
    highest = cv2.dilate(stands_out, NEIGHBOURS)
    at = np.flatnonzero((stands_out >= highest) & (stands_out > max(MIN_CONTRAST, NOISES * noise)))
    strongest = at[np.argsort(stands_out.ravel()[at])[::-1][:PEAKS]]
    for place in strongest:
        v, u = divmod(int(place), plane.shape[1])
        top, left = max(v - WINDOW, 0), max(u - WINDOW, 0)
        part = fine[top : v + WINDOW + 1, left : u + WINDOW + 1]
        height = float(fine[v, u])
        rim = np.sort(np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]]))
        floor = float(rim[len(rim) // 2])
        mask = np.asarray(part > 0.5 * (height + floor), np.uint8)
        cv2.floodFill(mask, None, (u - left, v - top), 2)
        yield from _outlined((mask == 2).view(np.uint8), (left, top), plane.shape, scale, height - floor)


def _largest_first(plane: Light, scale: tuple[float, float]) -> Iterator[Spot]:
    """The largest spot above a threshold for the whole picture: a ball that leaves little around itself."""
    low, high = float(plane.min()), float(plane.max())
    if high - low < MIN_CONTRAST:
        return
    level = np.asarray((plane - low) * (255.0 / (high - low)), np.uint8)
    _, mask = cv2.threshold(level, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(np.asarray(mask), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if contours:
        spot = np.zeros(plane.shape, np.uint8)
        cv2.drawContours(spot, [max(contours, key=cv2.contourArea)], -1, 1, cv2.FILLED)
        yield from _outlined(spot, (0, 0), plane.shape, scale, 0.5 * (high - low))


def _outlined(
    spot: NDArray[np.uint8],
    corner: tuple[int, int],
    shape: tuple[int, ...],
    scale: tuple[float, float],
    contrast: float,
) -> Iterator[Spot]:
    """One spot of a window, if it ends within the window."""
    contours, _ = cv2.findContours(spot, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    points: Array = contours[0][:, 0, :].astype(np.float64)
    last = np.array([spot.shape[1] - 1, spot.shape[0] - 1])
    at_window = (points == 0) | (points == last)
    points += corner
    edge = np.array([shape[1] - 1, shape[0] - 1])
    at_picture = (points == 0) | (points == edge)
    if (at_window & ~at_picture).any():
        return
    points = points[~at_picture.any(axis=1)]
    if len(points) < 6:
        return
    points = (points + 0.5) * scale - 0.5
    circle, rough = _circle(points)
    # Contours run through the middle of a spot's outer pixels; the spot ends half a pixel farther out.
    middle = np.array(circle[:2])
    growth = 1.0 + 0.5 * scale[0] / circle[2]
    yield Spot(middle + growth * (points - middle), contrast, rough, (*circle[:2], growth * circle[2]))


def _circle(points: Array) -> tuple[tuple[float, float, float], float]:
    """Least squares circle through points: u, v, radius, and the rms distance from it in radii."""
    middle = points.mean(axis=0)
    x = points - middle
    terms = np.column_stack([2.0 * x, np.ones(len(x))])
    square = (x * x).sum(axis=1)
    a, b, c = np.linalg.solve(terms.T @ terms + 1e-6 * np.eye(3), terms.T @ square)
    radius = math.sqrt(max(c + a * a + b * b, 1e-6))
    off = np.sqrt((x[:, 0] - a) ** 2 + (x[:, 1] - b) ** 2) - radius
    return (float(middle[0] + a), float(middle[1] + b), radius), math.sqrt(float(off @ off) / len(off)) / radius


def _different(found: list[Spot]) -> list[Spot]:
    """Best first, without those that show the same circle again."""
    kept: list[Spot] = []
    for spot in sorted(found, key=lambda one: one.contrast * max(0.0, 1.0 - 2.0 * one.rough), reverse=True):
        u, v, r = spot.circle
        if not any(max(math.hypot(u - a, v - b), abs(r - c)) < 0.3 * c for a, b, c in (one.circle for one in kept)):
            kept.append(spot)
    return kept
