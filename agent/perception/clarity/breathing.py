"""Focus breathing: how much a picture grows while the lens moves, measured on the sweep itself.

A lens that focuses nearer stands farther from the sensor and its picture grows as v/f, by some three percent from
infinity to 0.15 m; against equal lens steps that is a straight line. Frames a few steps apart are blurred nearly
alike, so they can be registered (enhanced correlation coefficient, Evangelidis and Psarakis 2008).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.perception.clarity.gradient import Grey, luminance

Warp = NDArray[np.float32]  # (2, 3)

WIDTH_PX = 320  # about what a picture is reduced to: on the twin as true as 640 in a tenth of the time; at 200 it fails
SMALLEST_PX = 64  # of a picture's shorter side: below it 0.5 percent is no shift that can be seen
LINKS = 6  # stretches that a sweep is cut into
ITERATIONS, TOLERANCE = 15, 3e-3  # of one link, which begins where the last one ended: growth is alike in all
SMOOTH_PX = 5  # Gaussian before the gradients
MIN_CORRELATION = 0.7  # of registered frames; noise on blurred frames leaves 0.8
AGREE = (0.2, 1e-4)  # share of the growth, and growth a step, within which links, across and down, are alike
GROWTH_POWER = 0.7  # of the picture's size, by which clarity a pixel falls when nothing but the size changes
MAX_STEP = 0.01  # growth from one frame to the next that is believed: seven times that of a small module


def measure_growth(images: Sequence[NDArray[np.uint8]]) -> float | None:
    """Relative growth of the picture from the first frame to the last, frames at equal lens steps; None: unknown.

    Frames are (height, width, 3) blue green red, or grey. The scene stands still. What moves all of the picture alike,
    or stretches it one way only, is not growth.
    """
    count, scale = len(images), 1 / max(1, round(images[0].shape[1] / WIDTH_PX))
    ends = [round(k) for k in np.linspace(0, count - 1, min(LINKS, count - 1) + 1).tolist()]
    small = {k: _scaled(luminance(images[k]), scale) for k in ends}
    if min(small[0].shape) < SMALLEST_PX:
        return None
    links, start = [], np.eye(2, 3, dtype=np.float32)
    for a, b in itertools.pairwise(ends):
        growth, start = step_growth(small[a], small[b], b - a, start)
        links.append(growth)
    known = [growth for growth in links if growth is not None]
    if not known:
        return None
    middle = float(np.median(known))
    agreeing = [growth for growth in known if alike(growth, middle)]
    return float(np.mean(agreeing)) * (count - 1) if 2 * len(agreeing) >= len(links) else None


def _scaled(grey: Grey, scale: float) -> Grey:
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def step_growth(a: Grey, b: Grey, steps: int, start: Warp) -> tuple[float | None, Warp]:
    """Relative growth a step, from frame a to frame b `steps` later; None where they cannot be registered.

    start: the warp (2, 3) to begin at. With the growth comes the warp found, or `start` where none is.
    """
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, ITERATIONS, TOLERANCE)
    everywhere = np.full(a.shape, 255, np.uint8)
    try:
        correlation, warp = cv2.findTransformECC(a, b, start.copy(), cv2.MOTION_AFFINE, stop, everywhere, SMOOTH_PX)
    except cv2.error:  # OpenCV's word for: does not converge, as on a picture without texture
        return None, start
    across, down = ((float(warp[i, i]) - 1.0) / steps for i in (0, 1))
    growth = (across + down) / 2.0
    if correlation < MIN_CORRELATION or not alike(across, down) or abs(growth) > MAX_STEP:
        return None, start
    return growth, np.asarray(warp, np.float32)


def alike(a: float, b: float) -> bool:
    return abs(a - b) <= AGREE[0] * max(abs(a), abs(b)) + AGREE[1]
