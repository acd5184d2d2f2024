"""The range of one thing in a sweep of the focus: what `aucamp depth-map --box` adds to the map.

Clarity over the middle of the box, as for a target that is followed in one (perception/clarity/region.py), against the
lens position; then the peak and what the calibration makes of it. What the lens focuses is the surface that faces it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.focus import Array, NoPeak, fit_peak, h, phase_sigma, range_variance
from agent.perception.clarity.breathing import GROWTH_POWER
from agent.perception.clarity.clarity import tenengrad_grid
from agent.perception.clarity.region import INNER_BOX
from agent.perception.tracking.box import Box
from hw.camera.camera import Image

MIN_RISE = 24.0  # of the clearest frame over the median one, clarity per pixel: what noise of one grey level adds


class BoxRange(NamedTuple):
    """Sigma is in lens positions, too; the range is the z-depth from the gimbal's pivot, if calibrated."""

    lens_position: float  # at which it is sharpest
    sigma: float  # standard deviation
    quality: float  # of the peak, 0 to 1
    range_m: float | None = None
    range_sigma_m: float | None = None

    def __str__(self) -> str:
        peak = f"sharpest at {self.lens_position:.5g} +- {self.sigma:.2g}, quality {self.quality:.3f}"
        if self.range_m is None or self.range_sigma_m is None:
            return peak
        return f"{self.range_m:.4f} m +- {1e3 * self.range_sigma_m:.1f} mm, {peak}"


def box_clarity(images: Sequence[Image], size: Array, box: Box) -> Array:
    """Clarity per pixel (n,) of the middle of a box in pictures `size` (n,) times as large as the one it is drawn in.

    The box grows with the picture about its centre, to whole pixels, so that it keeps its piece of the scene.
    """
    inner = box.grown(INNER_BOX)
    clarity = np.empty(len(images))
    for n, (image, scale) in enumerate(zip(images, size, strict=True)):
        rows = _edges(inner.y, inner.height, image.shape[0], scale)
        cols = _edges(inner.x, inner.width, image.shape[1], scale)
        clarity[n] = tenengrad_grid(image, rows, cols)[0, 0] * scale**GROWTH_POWER
    return clarity


def box_range(lens_positions: Array, clarity: Array, box: Box, focus: FocusFit | None) -> BoxRange | NoPeak:
    """Where the clarity (n,) at the lens positions (n,) has its one peak; NoPeak where it has none, or several."""
    if clarity.max() - np.median(clarity) < MIN_RISE:
        return NoPeak("no texture: it is as sharp at every lens position")
    peak = fit_peak(lens_positions.tolist(), clarity.tolist())
    if isinstance(peak, NoPeak):
        return peak
    sigma = math.hypot(peak.sigma, phase_sigma(peak.width, INNER_BOX**2 * box.width * box.height))
    found = BoxRange(peak.lens_position, sigma, peak.quality)
    if focus is None:
        return found
    range_m = h(focus, peak.lens_position)
    if range_m is None:
        return NoPeak(f"the peak at {peak.lens_position:.0f} is sharp beyond all ranges of this calibration")
    sigma_m = math.sqrt(sum(range_variance(focus, peak.lens_position, sigma)))
    return found._replace(range_m=range_m, range_sigma_m=sigma_m)


def as_json(box: Box, found: BoxRange) -> str:
    fields = found._asdict()
    return json.dumps({"box_px": list(box), "position": fields.pop("lens_position"), **fields}, indent=1) + "\n"


def _edges(first: float, length: float, limit: int, scale: float) -> np.ndarray:
    """First pixel and the one behind the last; both at least 3 apart, within 0 to `limit`."""
    middle = limit / 2
    low, high = (round(middle + scale * (edge - middle)) for edge in (first, first + length))
    return np.array([max(low, 0), min(max(high, low + 3), limit)])
