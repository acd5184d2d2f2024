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

from agent.perception.clarity.gradient import Grey

WIDTH_PX = 640  # about what a picture is reduced to: less noise, and less work
SMALLEST_PX = 64  # of a picture's shorter side: below it 0.5 percent is no shift that can be seen
LINKS = 6  # stretches that a sweep is cut into
ITERATIONS, TOLERANCE = 40, 1e-6
SMOOTH_PX = 5  # Gaussian before the gradients
MIN_CORRELATION = 0.7  # of registered frames; noise on blurred frames leaves 0.8
AGREE = (0.2, 1e-4)  # share of the growth, and growth a step, within which links, across and down, are alike
GROWTH_POWER = 0.7  # of the picture's size, by which clarity a pixel falls when nothing but the size changes
MAX_STEP = 0.01  # growth from one frame to the next that is believed: seven times that of a small module


def measure_growth(greys: Sequence[Grey]) -> float | None:
    """Relative growth of the picture from the first frame to the last, frames at equal lens steps; None: unknown.

    The scene stands still. What moves all of the picture alike, or stretches it one way only, is not growth.
    """
    scale = 1 / max(1, round(greys[0].shape[1] / WIDTH_PX))
    small = [cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for grey in greys]
    if min(small[0].shape) < SMALLEST_PX:
        return None
    ends = [round(k) for k in np.linspace(0, len(small) - 1, min(LINKS, len(small) - 1) + 1).tolist()]
    links = [step_growth(small[a], small[b], b - a) for a, b in itertools.pairwise(ends)]
    known = [growth for growth in links if growth is not None]
    if not known:
        return None
    middle = float(np.median(known))
    agreeing = [growth for growth in known if alike(growth, middle)]
    return float(np.mean(agreeing)) * (len(small) - 1) if 2 * len(agreeing) >= len(links) else None


def step_growth(a: Grey, b: Grey, steps: int) -> float | None:
    """Relative growth a step, from frame a to frame b `steps` later; None where they cannot be registered."""
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, ITERATIONS, TOLERANCE)
    start = np.eye(2, 3, dtype=np.float32)
    everywhere = np.full(a.shape, 255, np.uint8)
    try:
        correlation, warp = cv2.findTransformECC(a, b, start, cv2.MOTION_AFFINE, stop, everywhere, SMOOTH_PX)
    except cv2.error:  # OpenCV's word for: does not converge, as on a picture without texture
        return None
    across, down = ((float(warp[i, i]) - 1.0) / steps for i in (0, 1))
    growth = (across + down) / 2.0
    return growth if correlation >= MIN_CORRELATION and alike(across, down) and abs(growth) <= MAX_STEP else None


def alike(a: float, b: float) -> bool:
    return abs(a - b) <= AGREE[0] * max(abs(a), abs(b)) + AGREE[1]
