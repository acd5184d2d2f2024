"""The clarity peaks of squares on a grid, and of each that has none to be believed, why."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.focus import Array, Method, h, phase_sigma
from agent.perception.clarity.peaks import block_peaks
from agent.perception.depth_box import MIN_RISE

# Of a contour that is out of focus its neighbours see a slope: at r pixels its gradient is at most 1.3 / r of the sharp
# one's, where it has spread just so far. What has less than that is sharpest where all around is most blurred.
SPILL = 1 / 60  # of the clearest neighbour's rise: at 15 pixels from a contour, averaged over 5

T = TypeVar("T", bound=np.generic)


class Reason(IntEnum):
    """Why a square has no distance; TEXTS say it."""

    ACCEPTED = 0
    NO_TEXTURE = 1  # as sharp at every lens position
    BEYOND_SWEEP = 2  # sharpest at an end of the sweep, or beyond it
    POOR_FIT = 3  # the curve is not that of one depth
    TWO_DEPTHS = 4  # its parts are sharp at different lens positions


TEXTS = ("", "no texture", "sharp beyond the sweep", "poor fit", "two depths")  # of each Reason


class GridPeaks(NamedTuple):
    """Squares of one size, row 0 on top; every field has shape (rows, cols), sigma and width are in lens positions.

    What has no texture was not measured: all but its reason is NaN.
    """

    lens_position: Array  # of the clarity's peak
    sigma: Array
    width: Array  # half width of the peak
    quality: Array
    reason: NDArray[np.uint8]  # a Reason
    range_m: Array | None = None  # z-depth from the gimbal pivot; NaN where there is none. None without a calibration

    @property
    def accepted(self) -> NDArray[np.bool_]:
        accepted: NDArray[np.bool_] = self.reason == Reason.ACCEPTED
        return accepted

    def refused(self, where: NDArray[np.bool_], reason: Reason) -> GridPeaks:
        """The same, with those of `where` (rows, cols) refused for this reason."""
        return self._replace(reason=np.where(where, reason, self.reason).astype(np.uint8))

    def by(self, method: Method, lens_positions: Array, clarity: Array) -> GridPeaks:
        """The same squares, accepted or not, with the peaks of accepted ones taken another way."""
        lens_position, sigma = self.lens_position.copy(), self.sigma.copy()
        peaks = block_peaks(lens_positions, np.ascontiguousarray(clarity[:, self.accepted].T), method)
        lens_position[self.accepted], sigma[self.accepted] = peaks.lens_position, peaks.sigma
        return self._replace(lens_position=lens_position, sigma=sigma)

    def ranged(self, focus: FocusFit) -> GridPeaks:
        """The same, with the range of what is accepted as this calibration tells it."""
        range_m = np.full(self.reason.shape, np.nan)
        for row, col in np.argwhere(self.accepted):
            z_m = h(focus, float(self.lens_position[row, col]))
            if z_m is not None:  # else sharp at infinity
                range_m[row, col] = z_m
        return self._replace(range_m=range_m)


def each_part(of_blocks: NDArray[T], along: int) -> NDArray[T]:
    """(rows, cols) -> (rows * along, cols * along): every part has its block's value."""
    return np.repeat(np.repeat(of_blocks, along, axis=0), along, axis=1)


def grid_peaks(
    lens_positions: Array,
    clarity: Array,
    area_px: float,
    min_quality: float,
    reach: tuple[int, int] | None = None,
    where: NDArray[np.bool_] | None = None,
) -> GridPeaks:
    """Peaks of the clarity (n, rows, cols) of squares of `area_px` pixels, by the matched filter.

    reach: squares (down, across) in the midst of which one must not be too weak, or it shows what its neighbours spill.
    where (rows, cols): the others are passed over, as if they had no texture.
    """
    rise = clarity.max(axis=0) - np.median(clarity, axis=0)
    own = rise >= (MIN_RISE if reach is None else np.maximum(MIN_RISE, SPILL * cv2.dilate(rise, np.ones(reach))))
    textured = (own if where is None else own & where).ravel()
    curves = np.ascontiguousarray(clarity.reshape(len(clarity), -1).T)
    peaks = block_peaks(lens_positions, curves[textured])
    clear = peaks.accepted & (peaks.quality >= min_quality)
    reason = np.full(len(curves), Reason.NO_TEXTURE, np.uint8)
    reason[textured] = np.where(clear, Reason.ACCEPTED, np.where(peaks.inside, Reason.POOR_FIT, Reason.BEYOND_SWEEP))
    fields = np.full((4, len(curves)), np.nan)
    fields[:, textured] = (
        peaks.lens_position,
        np.hypot(peaks.sigma, phase_sigma(peaks.width, area_px)),
        peaks.width,
        peaks.quality,
    )
    lens_position, sigma, width, quality = fields.reshape(4, *clarity.shape[1:])
    return GridPeaks(lens_position, sigma, width, quality, reason.reshape(clarity.shape[1:]))
