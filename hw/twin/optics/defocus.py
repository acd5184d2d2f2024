"""Blur by the lens: every pixel is the mean of the sharp picture over its own circle of confusion.

CoC_px = (A v / p) |X - 1/s|,  X = 1/f - 1/v,  A = f/N,  s the apparent distance (thin lens, written in vergence).
A pixel takes its circle from its own depth (gather), so next to a depth edge the halo of a blurred near object
on a sharp background is missing. It acts on linear radiance, before noise and gamma.

Small circles are summed in full, as a mix of two disks of a fixed set; large ones at half the resolution, again and
again. All steps keep the second moment r^2/4 of a disk, which is what clarity near its peak depends on.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hw.twin.optics.disks import GROUP, RADII, REACH, SQUARES, Ints, taps
from hw.twin.optics.lens import Lens
from hw.twin.optics.raycast import ONE, ZERO, F, Floats, inlined, kernel

Corners = tuple[int, int, int, int]  # of a part: its first column and row, and those behind its last ones

FINE, COARSE = 2.5, RADII[-1]  # radii px between which the sum goes over from full to half resolution
LEVELS = 2  # of halving: circles up to 4 * COARSE in radius
SEGMENT = 32  # pixels of a row that share their sums

FINE_PX, COARSE_PX = np.float32(FINE), np.float32(COARSE)
QUARTER, NEAR = np.float32(0.25), np.float32(0.75)


def circle_gain(lens: Lens, image_distance_m: float) -> float:
    """Radius of the circle of confusion, px per dioptre of error."""
    return lens.aperture_m * image_distance_m / (2 * lens.pixel_m)


def vergence(lens: Lens, image_distance_m: float) -> float:
    """X: an object at the apparent distance 1/X is sharp."""
    return 1 / lens.focal_m - 1 / image_distance_m


def apparent_m(depth_m: Any, index: float, gap_m: float) -> Any:
    """Where an object at z-depth `depth_m` seems to be, seen through a port `gap_m` ahead (paraxial)."""
    return gap_m + (depth_m - gap_m) / index


def circles(depth_m: Floats, lens: Lens, image_distance_m: float, index: float, largest_px: float) -> Floats:
    """Radius of the circle of confusion, px, of each z-depth; at most `largest_px`."""
    gain = np.float32(circle_gain(lens, image_distance_m))
    sharp = np.float32(vergence(lens, image_distance_m))
    error = sharp - np.float32(1) / apparent_m(depth_m, index, lens.port_gap_m)
    return np.asarray(np.minimum(gain * np.abs(error), np.float32(largest_px)), np.float32)


def margin(largest_px: float) -> int:
    """Pixels around a region that its blurred picture needs: the rim of the coarsest level, and its doubling."""
    halvings = 0 if largest_px <= FINE else 1 if largest_px <= 2 * FINE else LEVELS
    return (REACH + 2) << halvings


def blur(picture: Floats, radius: Floats, part: Corners | None = None, halvings: int = LEVELS) -> Floats:
    """Blur picture (h, w, 3) by radius (h, w) px; h and w divisible by 4, a rim of `margin` is not valid.

    Outside `part`, if it is given, nothing is blurred, and what is returned there means nothing.
    """
    height, width = radius.shape
    left, top, right, bottom = part or (0, 0, width, height)
    coarse = picture
    if halvings and radius[top:bottom, left:right].max() > FINE:
        half = np.empty((height // 2, width // 2, 3), np.float32)
        half_radius = np.empty(half.shape[:2], np.float32)
        halve(picture, radius, half, half_radius)
        # A pixel is doubled from the coarse one that it lies in and from that one's neighbours.
        around = (
            *(max(low // 2 - 1, 0) for low in (left, top)),
            *(min((high + 1) // 2 + 1, size // 2) for high, size in ((right, width), (bottom, height))),
        )
        coarse = blur(half, half_radius, around, halvings - 1)
    disk = taps()
    offset = (disk.dy * width + disk.dx) * 3
    blurred = np.empty_like(picture)
    has_coarse = coarse is not picture
    gather(picture, radius, coarse, has_coarse, disk.start, offset, disk.weight, left, top, right, bottom, blurred)
    return blurred


@kernel
def halve(picture: Floats, radius: Floats, half: Floats, half_radius: Floats) -> None:
    """2x2 means. Halving and doubling themselves blur by a variance of 1 px^2, which the circle gives up."""
    for j in range(half.shape[0]):
        for i in range(half.shape[1]):
            y, x = 2 * j, 2 * i
            for c in range(3):
                above = picture[y, x, c] + picture[y, x + 1, c]
                half[j, i, c] = QUARTER * (above + picture[y + 1, x, c] + picture[y + 1, x + 1, c])
            r = QUARTER * (radius[y, x] + radius[y, x + 1] + radius[y + 1, x] + radius[y + 1, x + 1])
            half_radius[j, i] = math.sqrt(max(r * r * QUARTER - ONE, ZERO))


@kernel
def gather(
    picture: Floats,
    radius: Floats,
    coarse: Floats,
    has_coarse: bool,
    start: Ints,
    offset: Ints,
    weight: Floats,
    left: int,
    top: int,
    right: int,
    bottom: int,
    blurred: Floats,
) -> None:
    """One level: full sums for small circles, the doubled coarser level for large ones, a blend in between."""
    height, width = radius.shape
    flat = picture.reshape(height * width * 3)
    sums = np.empty((len(RADII), 3 * SEGMENT), np.float32)
    for j in range(top, bottom):
        for i in range(left, right):  # what stays in the rim, where sums would reach beyond the picture
            if min(i, j) < REACH or i >= width - REACH or j >= height - REACH:
                for c in range(3):  # the whole array at once is checked, by code that takes seconds to compile
                    blurred[j, i, c] = picture[j, i, c]
    for j in range(max(top, REACH), min(bottom, height - REACH)):
        for i0 in range(max(left, REACH), min(right, width - REACH), SEGMENT):
            n = min(SEGMENT, right - i0, width - REACH - i0)
            smallest, largest = COARSE_PX, ZERO
            for i in range(i0, i0 + n):
                smallest, largest = min(smallest, radius[j, i]), max(largest, radius[j, i])
            lowest = _disk(smallest, 0)
            if smallest < COARSE_PX or not has_coarse:
                for k in range(lowest, _disk(largest, lowest) + 2):
                    total = sums[k, : 3 * n]
                    for lane in range(3 * n):
                        total[lane] = ZERO
                    here = (j * width + i0) * 3
                    for tap in range(start[k], start[k + 1], GROUP):
                        # Slices: with an offset index it would not vectorise.
                        first = flat[here + offset[tap] : here + offset[tap] + 3 * n]
                        second = flat[here + offset[tap + 1] : here + offset[tap + 1] + 3 * n]
                        third = flat[here + offset[tap + 2] : here + offset[tap + 2] + 3 * n]
                        fourth = flat[here + offset[tap + 3] : here + offset[tap + 3] + 3 * n]
                        w1, w2, w3, w4 = weight[tap], weight[tap + 1], weight[tap + 2], weight[tap + 3]
                        for lane in range(3 * n):
                            value = total[lane] + w1 * first[lane]
                            value += w2 * second[lane]
                            value += w3 * third[lane]
                            total[lane] = value + w4 * fourth[lane]
            for i in range(n):
                r = radius[j, i0 + i]
                share = min(max((r - FINE_PX) / (COARSE_PX - FINE_PX), ZERO), ONE) if has_coarse else ZERO
                k = _disk(r, lowest)
                upper = (ONE - share) * min((r * r - SQUARES[k]) / (SQUARES[k + 1] - SQUARES[k]), ONE)
                lower = ONE - share - upper
                for c in range(3):
                    value = ZERO
                    if share < ONE:
                        value = lower * sums[k, 3 * i + c] + upper * sums[k + 1, 3 * i + c]
                    if share > ZERO:
                        value += share * _doubled(coarse, j, i0 + i, c)
                    blurred[j, i0 + i, c] = value


@inlined
def _disk(r: F, k: int) -> int:
    """The largest k with RADII[k] <= r that has a larger neighbour; it is not below the k given."""
    while k < len(RADII) - 2 and r * r > SQUARES[k + 1]:
        k += 1
    return k


@inlined
def _doubled(coarse: Floats, j: int, i: int, c: int) -> F:
    """The coarser level at a pixel of the finer one, bilinear."""
    y, x = j >> 1, i >> 1
    y2, x2 = y + 2 * (j & 1) - 1, x + 2 * (i & 1) - 1
    here = NEAR * coarse[y, x, c] + QUARTER * coarse[y, x2, c]
    return NEAR * here + QUARTER * (NEAR * coarse[y2, x, c] + QUARTER * coarse[y2, x2, c])
