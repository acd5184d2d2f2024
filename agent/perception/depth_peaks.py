"""Clarity peaks over one sweep of the focus: of squares on a grid, of one box, and how much the picture grows.

A block without a peak to be believed has a `Reason`. A block that holds two depths gives way to its parts. Peaks are
lens positions; a calibration turns them into ranges. Growth of the picture (focus breathing) is measured on the sweep.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import CameraFit, FocusFit
from agent.core.ranging.focus import (
    ANY_WAY,
    Array,
    Method,
    NoPeak,
    fit_peak,
    h,
    in_direction,
    phase_sigma,
    port_share,
    range_variance,
    through_port,
)
from agent.perception.clarity import (
    INNER_BOX,
    Grey,
    block_peaks,
    growth_power,
    half_clarity,
    luminance,
    tenengrad_grid,
)
from agent.perception.tracking.appearance import Box
from hw.camera.camera import Image

# --- peaks of squares on a grid ---

MIN_RISE = 24.0  # of the clearest frame over the median one, clarity per pixel: what noise of one grey level adds
# Of a contour that is out of focus its neighbours see a slope: at r pixels its gradient is at most 1.3 / r of the sharp
# one's, where it has spread just so far. What has less than that is sharpest where all around is most blurred.
SPILL = 1 / 60  # of the clearest neighbour's rise: at 15 pixels from a contour, averaged over 5

T = TypeVar("T", bound=np.generic)
Corner = tuple[float, float]


def middle_px(row: int, col: int, side_px: float, corner_px: Corner = (0.0, 0.0)) -> Corner:
    """The middle of a square of a grid, whose first begins at corner_px; a pixel's centre is a whole number."""
    return corner_px[0] + (col + 0.5) * side_px - 0.5, corner_px[1] + (row + 0.5) * side_px - 0.5


def z_depth(
    focus: FocusFit, camera: CameraFit | None, rho: float, px: tuple[float, float], outward: float = ANY_WAY
) -> float | None:
    """From the pivot, along the axis, of what is sharp at rho and seen at a pixel; None: sharp at infinity. outward:
    see `focus.port_share`."""
    if camera is None:
        return h(focus, rho)
    u_m = h(in_direction(focus, camera, px, rho), rho)
    return None if u_m is None else through_port(u_m, port_share(camera, px, outward))


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

    def ranged(
        self,
        focus: FocusFit,
        camera: CameraFit | None,
        side_px: float,
        corner_px: Corner,
        outward: Array | None = None,
    ) -> GridPeaks:
        """The same, with the range of what is accepted as this calibration tells it; squares of side_px, the first at
        corner_px of the camera's picture. Without a camera all are ranged as if they were on its axis.

        outward (rows, cols): of each square, see `depth_sweep.outward`; None: their texture runs in all directions.
        """
        range_m = np.full(self.reason.shape, np.nan)
        for row, col in np.argwhere(self.accepted):
            centre_px, way = middle_px(int(row), int(col), side_px, corner_px), ANY_WAY
            if outward is not None:
                way = float(outward[row, col])
            z_m = z_depth(focus, camera, float(self.lens_position[row, col]), centre_px, way)
            if z_m is not None:  # else sharp at infinity
                range_m[row, col] = z_m
        return self._replace(range_m=range_m)


def each_part(of_blocks: NDArray[T], along: int) -> NDArray[T]:
    """(rows, cols) -> (rows * along, cols * along): every part has its block's value."""
    return np.repeat(np.repeat(of_blocks, along, axis=0), along, axis=1)


def grid_peaks(
    lens_positions: Array,
    clarity: Array,
    min_quality: float,
    reach: tuple[int, int] | None = None,
    where: NDArray[np.bool_] | None = None,
) -> GridPeaks:
    """Peaks of the clarity (n, rows, cols) of squares, by the matched filter; sigma is what their residuals leave.

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
    fields[:, textured] = peaks.lens_position, peaks.sigma, peaks.width, peaks.quality
    lens_position, sigma, width, quality = fields.reshape(4, *clarity.shape[1:])
    return GridPeaks(lens_position, sigma, width, quality, reason.reshape(clarity.shape[1:]))


# --- how sure a peak is ---
#
# What a curve leaves unexplained is in part the model's fault: a curve that is broader at its foot than the model, on
# both sides alike, moves no peak. What moves peaks so slowly that the curve still looks like the model leaves nothing.
# So residuals only say which squares are surer than others; how sure all of them are is measured on the map. Four
# squares that meet in a corner cancel any plane, and any bowl along rows and columns: what is left is their noise.

FEWEST_FOURS = 40  # their scatter is known to a tenth
OUTLIERS = 3.0  # standard deviations, as the median tells them, beyond which four squares count no more
# Of what residuals say: neighbours share this error. By so much, rms, peaks of curves without noise are off, those of
# textures under the disc of a lens out of focus, for peaks of 1.5 to 5 steps anywhere in a sweep of 16 to 44.
COMMON = 0.35


def scatter(peaks: GridPeaks) -> float | None:
    """How many times more neighbours differ than residuals say; None: there are too few of them."""
    depth, variance = np.where(peaks.accepted, peaks.lens_position, np.nan), peaks.sigma**2
    twist = depth[1:, 1:] - depth[1:, :-1] - depth[:-1, 1:] + depth[:-1, :-1]
    known = np.isfinite(twist)
    expected = (variance[1:, 1:] + variance[1:, :-1] + variance[:-1, 1:] + variance[:-1, :-1])[known]
    ratio = np.abs(twist[known]) / np.sqrt(expected)
    if ratio.size < FEWEST_FOURS:
        return None
    most = OUTLIERS * float(np.median(ratio)) / 0.6745
    return math.sqrt(float(np.mean(np.minimum(ratio, most) ** 2)))


def as_sure(peaks: GridPeaks, scale: float | None, area_px: float) -> GridPeaks:
    """The same, sigma (what residuals leave) by their map's `scatter`; None: as of the twin's squares of `area_px`."""
    if scale is None:
        return peaks._replace(sigma=np.hypot(peaks.sigma, phase_sigma(peaks.width, area_px)))
    return peaks._replace(sigma=math.hypot(scale, COMMON) * peaks.sigma)


# --- blocks that hold one depth; of the others, parts that do ---
#
# A block astride an edge in depth has the curve of the side with more texture, and of the contour between them, which
# is the nearer side's: nothing in its own curve tells it from a block with one depth. So each block is cut into cells
# of some 5 pixels, and 2 x 2 of them are a part. Clarity adds up, so one pass over the pixels serves all three. A
# cell's peak is good to a tenth of a step of the sweep where it has texture; a median of 3 x 3 takes out those that
# were wrong.
#
# * A part lies on an edge if the cells in and around it (4 x 4) are not on a plane, or it is not where they are: any
#   surface is a plane over 25 pixels, a step is not. What light of a blurred foreground spills over the part beside it,
#   and the contour that a part shares, is seen by the cells on the other side.
# * A block holds one depth if none of its parts is on an edge or away from the block's own peak. Beside a block of
#   another depth its parts are asked about what lies around them, too. A steep slope is away from one peak as well: its
#   parts are what is told. (Whether texture shows the depth all over the block, `shown` asks.)
#
# Limits in peak widths, because how far apart two depths must be is a matter of how blurred one is when the other is
# sharp; never less than a fraction of the sweep's step, which is what sampling can tell.

CELL_PX = 5  # of a cell's side, at least: a gradient is taken over 3
UNEVEN = 0.1  # of the peak's half width: how far from a plane, or from its cells, a part's depth may be
AWAY = 0.15  # the same, of a part's depth from its block's
STEP_SHARE = 0.4  # of the step between lens positions: no limit is less
KNOWN = 0.6  # of the cells in and around a part that have a peak, or nothing is known of its surroundings
BENT = 0.1  # of what the plane spans, by which a slope may be curved; a step is 0.2 and more off its plane
POOR = 0.5  # of a block's parts: their curves have two peaks, each weaker than one,
NOISES = 3.0  # and leave more unexplained than so many times the variance of their noise
OWN_CELLS = 3  # of a part's four that have a peak: one in a corner may be the neighbour's contour
ANY_CELLS = 5  # around a part: fewer do not speak against it
AROUND = np.array([(1.0, row - 1.5, col - 1.5) for row in range(4) for col in range(4)])  # 4 x 4 cells: 1, y, x


def cuts(block: int) -> int:
    """How many cells a block of so many pixels has along its side: a power of two; 1 where it is no larger than a part.

    Below 20 px a block is not cut: it would be refused on every rough surface, with no part to take its place.
    """
    along = 1 << (block // CELL_PX).bit_length() - 1
    return along if along >= 4 else 1


def in_doubt(blocks: GridPeaks, parts: GridPeaks, step: float) -> NDArray[np.bool_]:
    """(rows, cols): blocks whose parts do not all have its depth, blocks near another, and those around both.

    The others need no look at their cells, which are most of the work.
    """
    along = len(parts.reason) // len(blocks.reason)
    near = np.abs(parts.lens_position - each_part(blocks.lens_position, along)) <= limit(parts, step)
    plain = blocks.accepted & by_block(parts.accepted & near, along).all(axis=-1) & ~near_another(blocks, step)
    doubt: NDArray[np.bool_] = cv2.dilate((~plain).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    return doubt


def with_edges(
    blocks: GridPeaks, parts: GridPeaks, cells: GridPeaks, clarity: Array, step: float
) -> tuple[GridPeaks, GridPeaks]:
    """Blocks and parts (2 x 2 cells) with those refused that hold two depths, or whose surroundings are unknown.

    clarity (n, parts down, parts across) at lens positions a `step` apart. Parts of a block that holds one depth are
    judged alike, and count for nothing.
    """
    along = len(parts.reason) // len(blocks.reason)
    around = four_by_four(median_of_nine(np.where(cells.accepted, cells.lens_position, np.nan)))
    edge, edge_inside = on_edge(parts, around, step), on_edge(parts, within_block(around, along), step)
    seen, inside = np.isfinite(around), np.isfinite(four_by_four(np.zeros(cells.reason.shape))).sum(axis=-1)
    known = (seen.sum(axis=-1) >= KNOWN * inside) & (seen[..., [5, 6, 9, 10]].sum(axis=-1) >= OWN_CELLS)

    from_block = np.abs(parts.lens_position - each_part(blocks.lens_position, along))
    away = parts.accepted & (from_block > apart_from_block(blocks, parts, step))
    near = near_another(blocks, step)
    poor = by_block(with_two_peaks(clarity, parts), along).mean(axis=-1) >= POOR
    two = poor | any_part(
        edge_inside | (edge & each_part(near, along)) | (away & each_part(blocks.accepted, along)), along
    )
    parts = parts.refused(parts.accepted & ~known, Reason.NO_TEXTURE).refused(edge, Reason.TWO_DEPTHS)
    return blocks.refused(two, Reason.TWO_DEPTHS), parts


def with_two_peaks(clarity: Array, parts: GridPeaks) -> NDArray[np.bool_]:
    """Parts (rows, cols) whose curves (n, rows, cols) are not those of one depth, by more than noise makes of them.

    A peak bends a curve at a few lens positions, noise at all of them: the median tells noise alone.
    """
    bends = np.median(np.abs(np.diff(clarity, 2, axis=0)), axis=0)
    noise2 = (bends / 0.6745) ** 2 / 6.0  # a second difference adds up six variances
    left = (1.0 - parts.quality**2) * clarity.var(axis=0)
    return np.asarray((parts.reason == Reason.POOR_FIT) & (left > NOISES * noise2), np.bool_)


def near_another(blocks: GridPeaks, step: float) -> NDArray[np.bool_]:
    """(rows, cols): blocks beside one of another depth, so that there is an edge, or a slope, somewhere near."""
    depth = np.where(blocks.accepted, blocks.lens_position, np.nan)
    wide, (rows, cols) = np.pad(depth, 1, constant_values=np.nan), depth.shape
    around = np.stack([wide[r : r + rows, c : c + cols] for r in range(3) for c in range(3)], axis=-1)
    apart = np.maximum(AWAY * blocks.width, STEP_SHARE * step)[..., None]
    return np.asarray((np.abs(around - depth[..., None]) > apart).any(axis=-1), np.bool_)


def on_edge(parts: GridPeaks, around: Array, step: float) -> NDArray[np.bool_]:
    """Parts (rows, cols) whose cells, and those around them (rows, cols, 16), speak of another depth."""
    most = limit(parts, step) + parts.sigma
    off, span = off_plane(around)
    bent, beside = np.abs(off).max(axis=-1) - BENT * span, np.abs(middle(around) - parts.lens_position)
    enough = np.isfinite(around).sum(axis=-1) >= ANY_CELLS
    return np.asarray(parts.accepted & enough & ((bent > most) | (beside > most)), np.bool_)


def within_block(around: Array, along: int) -> Array:
    """The same, NaN for cells of other blocks: an edge between two blocks is in neither."""
    outside = np.zeros((along, along, 4, 4), np.bool_)
    outside[0, :, 0], outside[-1, :, 3], outside[:, 0, :, 0], outside[:, -1, :, 3] = (True,) * 4
    rows, cols = (size // along for size in around.shape[:2])
    return np.where(np.tile(outside.reshape(along, along, 16), (rows, cols, 1)), np.nan, around)


def limit(parts: GridPeaks, step: float) -> Array:
    """How far a part's depth may be from what it should be, its own uncertainty apart, lens positions."""
    most: Array = np.maximum(UNEVEN * parts.width, STEP_SHARE * step)
    return most


def apart_from_block(blocks: GridPeaks, parts: GridPeaks, step: float) -> Array:
    """How far a part's depth (rows * along, cols * along) may be from its block's, lens positions."""
    width = each_part(blocks.width, len(parts.reason) // len(blocks.reason))
    most: Array = np.maximum(AWAY * width, STEP_SHARE * step) + np.nan_to_num(parts.sigma)
    return most


def median_of_nine(values: Array) -> Array:
    """Median of each value (rows, cols) and its neighbours, without NaN; NaN stays NaN."""
    rows, cols = values.shape
    wide = np.pad(values, 1, constant_values=np.nan)
    nine = np.stack([wide[r : r + rows, c : c + cols] for r in range(3) for c in range(3)], axis=-1)
    return np.where(np.isnan(values), np.nan, middle(nine))


def middle(values: Array) -> Array:
    """Median over the last axis, without NaN; NaN where there is nothing else."""
    ordered, count = np.sort(values, axis=-1), np.isfinite(values).sum(axis=-1)
    low, high = (np.take_along_axis(ordered, k[..., None], -1) for k in (np.maximum(count - 1, 0) // 2, count // 2))
    return np.where(count > 0, (low + high)[..., 0] / 2.0, np.nan)


def four_by_four(cells: Array) -> Array:
    """(rows, cols) -> (rows / 2, cols / 2, 16): each part's four cells and the twelve around them; outside: NaN."""
    wide = np.pad(cells, 1, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(wide, (4, 4))[::2, ::2]
    return windows.reshape(*windows.shape[:2], 16)


def off_plane(around: Array) -> tuple[Array, Array]:
    """How far each of 4 x 4 values (..., 16) is from the plane through them, by least squares; 0 for NaN.

    And how much the plane spans (...), 0 where some are NaN: of few values a step looks like a slope.
    """
    seen = np.isfinite(around)
    values = np.where(seen, around, 0.0)
    normal = np.einsum("...k,ki,kj->...ij", seen.astype(float), AROUND, AROUND) + 1e-6 * np.eye(3)  # few: still solved
    plane = np.linalg.solve(normal, (values @ AROUND)[..., None])[..., 0]
    span = np.where(seen.all(axis=-1), 3.0 * np.abs(plane[..., 1:]).sum(axis=-1), 0.0)
    return np.where(seen, values - plane @ AROUND.T, 0.0), span


def by_block(parts: NDArray[np.bool_], along: int) -> NDArray[np.bool_]:
    """(rows * along, cols * along) -> (rows, cols, along^2)."""
    rows, cols = (size // along for size in parts.shape)
    return parts.reshape(rows, along, cols, along).transpose(0, 2, 1, 3).reshape(rows, cols, -1)


def any_part(parts: NDArray[np.bool_], along: int) -> NDArray[np.bool_]:
    """(rows * along, cols * along) -> (rows, cols)."""
    return np.asarray(by_block(parts, along).any(axis=-1), np.bool_)


# --- blocks that show their depth all over ---
#
# A plain part is filled in between others, never beyond them. A part without texture may lie at any depth. With parts
# of its block's depth all around it, it is taken for the same surface, as a plain spot of it would be; at the rim of
# what shows that depth there may as well be another surface, which has no texture: a block is not told one depth there,
# only its parts are.
#
# A part too weak for a peak of its own still speaks for its block, where most of what its curve does is the block's
# peak. Light that a blurred neighbour spills over it does the opposite: that is least where the neighbour is sharp.

MOST = 0.75  # of the variance of a part's curve is its block's peak, or it does not speak for it
REACH = 2  # parts to either side: as far as a plain spot is filled in from
NEIGHBOURS = np.array([(y, x) for y in range(-REACH, REACH + 1) for x in range(-REACH, REACH + 1) if (y, x) != (0, 0)])
HALVES = (NEIGHBOURS @ NEIGHBOURS.T > 0).astype(np.float32)  # (half planes, NEIGHBOURS): those on one side of a line


def shown(lens_positions: Array, clarity: Array, blocks: GridPeaks, parts: GridPeaks, step: float) -> NDArray[np.bool_]:
    """(rows, cols): blocks of which every part shows the block's depth, or has such parts all around it.

    clarity (n, parts down, parts across) at the lens positions (n,), a `step` apart. Without a peak: no.
    """
    along = len(parts.reason) // len(blocks.reason)
    block, apart = each_part(blocks.lens_position, along), apart_from_block(blocks, parts, step)
    agree = like_block(lens_positions, clarity, blocks, along)
    depth = np.where(parts.accepted, parts.lens_position, np.where(agree, block, np.nan))
    own = np.abs(depth - block) <= apart
    return ~any_part(~(own | enclosed(depth, block, apart)), along)


def like_block(lens_positions: Array, clarity: Array, blocks: GridPeaks, along: int) -> NDArray[np.bool_]:
    """Parts with texture (rows * along, cols * along) whose curves (n, ...) the peak of their block mostly explains."""
    x = lens_positions[:, None, None]
    peak = each_part_of_curves(1.0 / (1.0 + ((x - blocks.lens_position) / blocks.width) ** 2), along)
    peak, curve = peak - peak.mean(axis=0), clarity - clarity.mean(axis=0)
    both, scale = (peak * curve).sum(axis=0), np.sqrt((peak * peak).sum(axis=0) * (curve * curve).sum(axis=0))
    rise = clarity.max(axis=0) - np.median(clarity, axis=0)
    return np.asarray((both >= np.sqrt(MOST) * scale) & (rise >= MIN_RISE), np.bool_)  # NaN: no


def each_part_of_curves(curves: Array, along: int) -> Array:
    """(n, rows, cols) -> (n, rows * along, cols * along)."""
    return np.repeat(np.repeat(curves, along, axis=1), along, axis=2)


def enclosed(depth: Array, block: Array, apart: Array) -> NDArray[np.bool_]:
    """Parts (rows, cols) with some of their block's depth around them on either side of every line through them.

    depth: of each part, NaN where it shows none; block: of the block it is in; apart: as far as both may differ.
    """
    (rows, cols), wide = depth.shape, np.pad(depth, REACH, mode="symmetric")
    moved = (wide[REACH + y : REACH + y + rows, REACH + x : REACH + x + cols] for y, x in NEIGHBOURS)
    same = np.stack([np.abs(one - block) <= apart for one in moved], axis=-1)
    return np.asarray((same.astype(np.float32) @ HALVES > 0).all(axis=-1), np.bool_)


# --- range of one box ---
#
# This is what `aucamp depth-map --box` adds to the map. Clarity is taken over the middle of the box, as for a target
# that is followed in one, against the lens position; then come the peak and what the calibration makes of it. What the
# lens focuses is the surface that faces it.


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
    """Clarity per pixel (n,) of the middle of a box in pictures `size` (n,) times as large as the one with the box.

    The box grows with the picture about its centre, to whole pixels, so that it keeps its piece of the scene.
    """
    inner = box.grown(INNER_BOX)
    clarity, at_half = np.empty((len(images), 1, 1)), np.empty((len(images), 1, 1))
    for n, (image, scale) in enumerate(zip(images, size, strict=True)):
        rows = _edges(inner.y, inner.height, image.shape[0], scale)
        cols = _edges(inner.x, inner.width, image.shape[1], scale)
        clarity[n], at_half[n] = tenengrad_grid(image, rows, cols), half_clarity(image, rows, cols)
    box_alone: Array = (clarity * size[:, None, None] ** growth_power(clarity, at_half)).ravel()
    return box_alone


def box_range(
    lens_positions: Array,
    clarity: Array,
    box: Box,
    focus: FocusFit | None,
    camera: CameraFit | None = None,
    outward: float = ANY_WAY,
    spread: float = 0.0,
) -> BoxRange | NoPeak:
    """Where the clarity (n,) at the lens positions (n,) has its one peak; NoPeak where it has none, or several. The box
    is one of the camera's picture. outward: see `focus.port_share`. spread: of what is in it, lens positions."""
    if clarity.max() - np.median(clarity) < MIN_RISE:
        return NoPeak("no texture: it is as sharp at every lens position")
    peak = fit_peak(lens_positions.tolist(), clarity.tolist())
    if isinstance(peak, NoPeak):
        return peak
    sigma = math.hypot(peak.sigma, phase_sigma(peak.width, INNER_BOX**2 * box.width * box.height), spread)
    found = BoxRange(peak.lens_position, sigma, peak.quality)
    if focus is None:
        return found
    range_m = z_depth(focus, camera, peak.lens_position, box.centre_px, outward)
    if range_m is None:
        return NoPeak(f"the peak at {peak.lens_position:.0f} is sharp beyond all ranges of this calibration")
    share = 1.0
    if camera is not None:
        focus = in_direction(focus, camera, box.centre_px, peak.lens_position)
        share = port_share(camera, box.centre_px, outward)
    sigma_m = math.sqrt(sum(range_variance(focus, peak.lens_position, sigma))) / share
    return found._replace(range_m=range_m, range_sigma_m=sigma_m)


def as_json(box: Box, found: BoxRange) -> str:
    fields = found._asdict()
    return json.dumps({"box_px": list(box), "position": fields.pop("lens_position"), **fields}, indent=1) + "\n"


def _edges(first: float, length: float, limit: int, scale: float) -> np.ndarray:
    """First pixel and the one behind the last; both at least 3 apart, within 0 to `limit`."""
    middle = limit / 2
    low, high = (round(middle + scale * (edge - middle)) for edge in (first, first + length))
    return np.array([max(low, 0), min(max(high, low + 3), limit)])


# --- focus breathing: how much a picture grows while the lens moves ---
#
# A lens that focuses nearer stands farther from the sensor and its picture grows as v/f, by some three percent from
# infinity to 0.15 m; against equal lens steps that is a straight line. Frames a few steps apart are blurred nearly
# alike, so they can be registered (enhanced correlation coefficient, Evangelidis and Psarakis 2008).

Warp = NDArray[np.float32]  # (2, 3)

WIDTH_PX = 320  # about what a picture is reduced to: on the twin as true as 640 in a tenth of the time; at 200 it fails
SMALLEST_PX = 64  # of a picture's shorter side: below it 0.5 percent is no shift that can be seen
LINKS = 6  # stretches that a sweep is cut into
ITERATIONS, TOLERANCE = 15, 3e-3  # of one link, which begins where the last one ended: growth is alike in all
SMOOTH_PX = 5  # Gaussian before the gradients
MIN_CORRELATION = 0.7  # of registered frames; noise on blurred frames leaves 0.8
AGREE = (0.2, 1e-4)  # share of the growth, and growth a step, within which links, across and down, are alike
LEAST_GROWTH = 0.0025  # of the whole sweep: blur that changes looks like up to 0.22 % where a picture does not grow
MAX_STEP = 0.01  # growth from one frame to the next that is believed: seven times that of a small module


def measure_growth(images: Sequence[NDArray[np.uint8]], lens_positions: Array | None = None) -> float | None:
    """Relative growth of the picture from the first frame to the last; None: unknown.

    Frames are (height, width, 3) blue green red, or grey, at rising lens positions (n,), or equal lens steps. The scene
    stands still. What moves all of the picture alike, or stretches it one way only, is not growth.
    """
    count, scale = len(images), 1 / max(1, round(images[0].shape[1] / WIDTH_PX))
    at = np.arange(float(count))  # in mean steps
    if lens_positions is not None:
        at = (lens_positions - lens_positions[0]) * ((count - 1) / (lens_positions[-1] - lens_positions[0]))
    wanted = np.linspace(0, count - 1, min(LINKS, count - 1) + 1)
    ends = sorted({round(k) for k in np.interp(wanted, at, np.arange(float(count))).tolist()})
    small = {k: _scaled(luminance(images[k]), scale) for k in ends}
    if min(small[0].shape) < SMALLEST_PX:
        return None
    links, start = [], np.eye(2, 3, dtype=np.float32)
    for a, b in itertools.pairwise(ends):
        growth, start = step_growth(small[a], small[b], float(at[b] - at[a]), start)
        links.append(growth)
    known = [growth for growth in links if growth is not None]
    if not known:
        return None
    middle = float(np.median(known))
    agreeing = [growth for growth in known if alike(growth, middle)]
    if 2 * len(agreeing) < len(links):
        return None
    growth = float(np.mean(agreeing)) * (count - 1)
    return growth if abs(growth) > LEAST_GROWTH else 0.0


def _scaled(grey: Grey, scale: float) -> Grey:
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def step_growth(a: Grey, b: Grey, steps: float, start: Warp) -> tuple[float | None, Warp]:
    """Relative growth a step, from frame a to frame b `steps` on; None where they cannot be registered.

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
