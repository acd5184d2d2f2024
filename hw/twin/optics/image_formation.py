"""From the radiance of a sharp picture to the bytes of a frame: motion blur, blur by the lens, sensor and metering."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from functools import lru_cache
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.optics.lens import Lens
from hw.twin.optics.raycast import ONE, ZERO, F, Floats, Moment, inlined, kernel

# --- motion blur: in how many parts an exposure is drawn ---

During = Callable[[float], Moment]  # the world at a share of the exposure, from -0.5, its start, to 0.5, its end

PART_PX = 1.5  # motion within a part, which is not drawn: below what a lens at its sharpest blurs
MOST = 8  # parts; what moves by more than 12 px is drawn a little coarser
CLOSEST_M, LARGEST_M = 0.05, 0.14  # nothing comes closer to a port; the radius of a hull, and more than most solids'


def parts_of(during: During, focal_px: float, nearest_m: float) -> int:
    """Number of parts: one for each 1.5 px by which anything moves in the picture, at most.

    focal_px: pixels in a radian of water. nearest_m: z-depth of what is closest.
    """
    before, after = during(-0.5), during(0.5)
    shift_m = np.asarray(after.eye.position_m) - np.asarray(before.eye.position_m)
    turn = np.asarray(before.eye.rotation).T @ np.asarray(after.eye.rotation)
    angle_rad = math.acos(min(max((float(np.trace(turn)) - 1) / 2, -1.0), 1.0))
    moved_rad = angle_rad + float(np.linalg.norm(shift_m)) / max(nearest_m, CLOSEST_M)
    of_others = 0.0
    for start_m, end_m in zip(_places_m(before), _places_m(after), strict=True):
        range_m = float(np.linalg.norm(start_m - np.asarray(before.eye.position_m))) - LARGEST_M
        of_others = max(of_others, float(np.linalg.norm(end_m - start_m)) / max(range_m, CLOSEST_M))
    return min(max(math.ceil((moved_rad + of_others) * focal_px / PART_PX), 1), MOST)


def _places_m(moment: Moment) -> list[NDArray[np.float64]]:
    solids = [np.asarray(solid.position_m, float) for solid in moment.solids]
    hulls = [np.asarray(hull.position_m, float) for hull in moment.hulls]
    parts = [np.asarray(part.position_m, float) for creature in moment.creatures for part in creature.parts]
    return solids + hulls + parts


# --- disks: the taps that a blur is summed over, and their weights ---

Ints = NDArray[np.int64]

RADII = (0.0, 0.5, 0.8, 1.15, 1.55, 2.05, 2.7, 3.5)  # px; a mix of two neighbours has any r^2 in between
SQUARES = np.array(RADII, np.float32) ** 2
REACH = math.ceil(RADII[-1]) + 2  # pixels that the largest full sum looks to each side
NEGLIGIBLE = 3e-4  # weight below which a tap is left out
GROUP = 4  # taps summed at a time: a running sum that is stored after each of them takes twice as long


class Taps(NamedTuple):
    """The disks of RADII: disk k has taps start[k] to start[k + 1], filled up to whole groups with weights of 0."""

    start: Ints
    dy: Ints
    dx: Ints
    weight: Floats


@lru_cache(maxsize=1)
def taps() -> Taps:
    """Mean of a cubic (Keys) interpolation of the picture over each disk, which has the disk's second moment."""
    start: list[int] = [0]
    dy: list[int] = []
    dx: list[int] = []
    weight: list[float] = []
    k = np.arange(-REACH, REACH + 1)
    ring = np.sqrt((np.arange(24) + 0.5) / 24)  # equal areas
    angle = 2 * np.pi * (np.arange(64) + 0.5) / 64
    y, x = (np.outer(ring, trig(angle)).ravel() for trig in (np.sin, np.cos))
    for r in RADII:
        w = _cubic(k[:, None] - r * y) @ _cubic(k[:, None] - r * x).T / len(x)
        rows, cols = np.nonzero(np.abs(w) > NEGLIGIBLE)
        idle = [0] * (-len(rows) % GROUP)
        start.append(start[-1] + len(rows) + len(idle))
        dy.extend([*k[rows], *idle])
        dx.extend([*k[cols], *idle])
        weight.extend([*(w[rows, cols] / w[rows, cols].sum()), *idle])
    return Taps(np.array(start), np.array(dy), np.array(dx), np.array(weight, np.float32))


def _cubic(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Keys' kernel, a = -1/2: interpolates quadratics exactly."""
    t = np.abs(t)
    return np.where(t < 1, (1.5 * t - 2.5) * t * t + 1, np.where(t < 2, ((-0.5 * t + 2.5) * t - 4) * t + 2, 0))


# --- defocus: every pixel is the mean of the sharp picture over its own circle of confusion ---
#
# CoC_px = (A v / p) |X - 1/s|,  X = 1/f - 1/v,  A = f/N,  s the apparent distance (thin lens, written in vergence). A
# pixel takes its circle from its own depth (gather), so next to a depth edge the halo of a blurred near object on a
# sharp background is missing. It acts on linear radiance, before noise and gamma.
#
# Small circles are summed in full, as a mix of two disks of a fixed set; large ones at half the resolution, again and
# again. All steps keep the second moment r^2/4 of a disk, which is what clarity near its peak depends on.

Corners = tuple[int, int, int, int]  # of a part: its first column and row, and those behind its last ones

FINE, COARSE = 2.5, RADII[-1]  # radii px between which the sum goes over from full to half resolution
LEVELS = 2  # of halving: circles up to 4 * COARSE in radius
SEGMENT = 32  # pixels of a row that share their sums

FINE_PX, COARSE_PX = np.float32(FINE), np.float32(COARSE)
EIGHTH, QUARTER, HALF, NEAR, TWO = (np.float32(share) for share in (0.125, 0.25, 0.5, 0.75, 2))
TINY = np.float32(1e-12)


def circle_gain(lens: Lens, image_distance_m: float) -> float:
    """Radius of the circle of confusion, px per dioptre of error."""
    return lens.aperture_m * image_distance_m / (2 * lens.pixel_m)


def vergence(lens: Lens, image_distance_m: float) -> float:
    """X: an object at the apparent distance 1/X is sharp."""
    return 1 / lens.focal_m - 1 / image_distance_m


def apparent_m(depth_m: Any, index: float, gap_m: float) -> Any:
    """Where an object on the axis at z-depth `depth_m` seems to be, seen through a port `gap_m` ahead."""
    return gap_m + (depth_m - gap_m) / index


class Circle(NamedTuple):
    """What the circles of confusion of a frame follow from, float32."""

    image_m: F  # lens to sensor
    pixel_m: F
    gap_m: F  # lens to window
    index: F
    k1: F
    k2: F
    lean_x: F
    lean_y: F
    curved_per_m: F
    left_px: F  # of the first pixel, from where the axis meets the sensor
    top_px: F
    gain: F
    sharp: F  # the vergence that is sharp on the axis
    largest_px: F


class Confusion(NamedTuple):
    """What the lens makes of a point, as the covariance of an ellipse [[r^2 / 4 + x, y], [y, r^2 / 4 - x]], across the
    picture and down it: that of a disk, and how it is stretched, (x, y)."""

    radius: Floats  # (h, w) px
    stretch: Floats  # (h, w, 2) px^2


def circles(
    depth_m: Floats, lens: Lens, image_distance_m: float, index: float, largest_px: float, corner: tuple[int, int]
) -> Confusion:
    """Of each pixel's z-depth (h, w), with radii of largest_px at most.

    corner: of the part in the full frame, its first column and row.
    """
    left_px, top_px = corner[0] - lens.centre_px[0], corner[1] - lens.centre_px[1]
    where = (image_distance_m, lens.pixel_m, lens.port_gap_m, index, lens.k1, lens.k2, *lens.lean, lens.curved_per_m)
    sharp = (circle_gain(lens, image_distance_m), vergence(lens, image_distance_m), largest_px)
    found = Confusion(np.empty_like(depth_m), np.empty((*depth_m.shape, 2), np.float32))
    fill_circles(depth_m, Circle(*map(np.float32, (*where, left_px, top_px, *sharp))), *found)
    return found


@kernel
def fill_circles(depth_m: Floats, of: Circle, radius: Floats, stretch: Floats) -> None:
    """The window refracts by Snell's law, so rays that leave a point a little apart meet nearer the steeper they are:
    by cos a / cos w across the plane of incidence, and by the cube of that within it. A point beside the axis becomes
    an ellipse, which is longer away from the axis or around it."""
    more = np.empty(depth_m.shape[1], np.float32)
    for row in range(depth_m.shape[0]):
        y_m = (of.top_px + np.float32(np.int32(row))) * of.pixel_m
        for col in range(depth_m.shape[1]):  # several pixels at once, which pairs of numbers forbid
            x_m = (of.left_px + np.float32(np.int32(col))) * of.pixel_m
            r2_m2 = x_m * x_m + y_m * y_m
            slope2 = r2_m2 / (of.image_m * of.image_m)
            magnified = ONE + slope2 * (of.k1 + of.k2 * slope2)
            tan2 = slope2 * magnified * magnified  # in air
            sin2 = tan2 / (ONE + tan2)
            share2 = (ONE - sin2) / (ONE - sin2 / (of.index * of.index))
            share = math.sqrt(share2)
            # By so much the sensor is farther there than on the axis; d(1/v) = -dv / v^2, to a thousandth of dv.
            off_m = of.lean_x * x_m + of.lean_y * y_m - of.curved_per_m * r2_m2
            sharp = of.sharp + off_m / (of.image_m * of.image_m)
            behind_m = (depth_m[row, col] - of.gap_m) * share / of.index
            around = of.gain * (sharp - ONE / (of.gap_m + behind_m))
            away = of.gain * (sharp - ONE / (of.gap_m + behind_m * share2))
            square = HALF * (around * around + away * away)
            fits = min(of.largest_px * of.largest_px / max(square, TINY), ONE)
            radius[row, col] = math.sqrt(square * fits)
            more[col] = EIGHTH * fits * (away * away - around * around) / max(r2_m2, TINY)
        for col in range(depth_m.shape[1]):
            x_m = (of.left_px + np.float32(np.int32(col))) * of.pixel_m
            stretch[row, col, 0] = more[col] * (x_m * x_m - y_m * y_m)
            stretch[row, col, 1] = TWO * more[col] * x_m * y_m


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


# --- astigmatism: away from the axis the circle is an ellipse ---
#
# B + 1/2 (x (B_uu - B_vv) + 2 y B_uv) has the variances of `Confusion`, where B is blurred by disks. The two half axes
# differ by half a pixel at most, so that one step is enough. Differences are taken over a pixel of the level that B
# comes from.

ROUND = np.float32(1e-3)  # px^2: what is stretched by less is a disk
STRETCH_REACH = 1 << LEVELS  # pixels to each side that a pixel is stretched by


def is_round(stretch: Floats) -> bool:
    """Whether no pixel is stretched."""
    return bool(np.abs(stretch).max() <= ROUND)


@kernel
def stretched(blurred: Floats, radius: Floats, stretch: Floats, left: int, top: int, out: Floats) -> None:
    """Fill out (h, w, 3), the part of the blurred picture from (left, top) on. What is around it counts."""
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            j, i = top + row, left + col
            x, y, r = stretch[j, i, 0], stretch[j, i, 1], radius[j, i]
            if abs(x) <= ROUND and abs(y) <= ROUND:
                for c in range(3):
                    out[row, col, c] = blurred[j, i, c]
                continue
            h = 1 if r <= COARSE_PX else 2 if r <= TWO * COARSE_PX else STRETCH_REACH
            along, askew = HALF * x / np.float32(h * h), QUARTER * y / np.float32(h * h)
            for c in range(3):
                straight = blurred[j, i + h, c] + blurred[j, i - h, c] - blurred[j + h, i, c] - blurred[j - h, i, c]
                falling = blurred[j + h, i + h, c] + blurred[j - h, i - h, c]
                rising = blurred[j + h, i - h, c] + blurred[j - h, i + h, c]
                out[row, col, c] = blurred[j, i, c] + along * straight + askew * (falling - rising)


# --- sensor: photon and read noise, a 12-bit converter, gamma, 8 bits ---
#
# The noise of a pixel is a function of (seed, robot, tick, pixel) alone: what else was read does not change it.

FULL_WELL = 4000.0  # electrons; the shot noise of a pixel at full scale is its root
READ_NOISE = 0.004  # of full scale
ADC = 4095  # largest code
GAMMA = 2.2

INVERSE_WELL, READ_VARIANCE = np.float32(1 / FULL_WELL), np.float32(READ_NOISE**2)
FULL_SCALE = np.float32(ADC)
# Steele, Lea and Flood 2014 (SplitMix64): one 64-bit hash a pixel, 12 bits a colour.
GOLDEN, MIX1, MIX2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
S24, S27, S30, S31, S40 = (np.uint64(bits) for bits in (24, 27, 30, 31, 40))
MASK12 = np.uint64(0xFFF)


@lru_cache(maxsize=1)
def normal_quantiles() -> Floats:
    """(4096,) the normal distribution in equal shares, unit deviation: a 12-bit number looks up its noise."""
    quantiles = np.array([NormalDist().inv_cdf((i + 0.5) / 4096) for i in range(4096)])
    return np.asarray(quantiles / quantiles.std(), np.float32)


@lru_cache(maxsize=1)
def gamma_curve() -> NDArray[np.uint8]:
    """(4096,) converter code to byte."""
    return np.round(255 * (np.arange(ADC + 1) / ADC) ** (1 / GAMMA)).astype(np.uint8)


def noise_key(seed: int, robot: str, tick: int) -> np.uint64:
    state = np.random.SeedSequence([seed, zlib.crc32(robot.encode()), tick]).generate_state(1, np.uint64)
    return np.uint64(state[0])


class Exposure(NamedTuple):
    """How one frame is taken."""

    scale: F  # share of full scale for a radiance of 1
    gain: F = ONE  # of the amplifier: the variance of all noise grows with it, in shares of full scale
    open_ns: int | None = None  # how long the shutter is open; None: as the camera does by itself


@kernel
def expose(
    picture: Floats,
    scale: F,
    gain: F,
    key: np.uint64,
    x0: int,
    y0: int,
    full_width: int,
    normal: Floats,
    curve: NDArray[np.uint8],
    image: NDArray[np.uint8],
) -> None:
    """Fill image (h, w, 3) from picture (h, w, 3); (x0, y0) is its place in the full frame.

    At gain g a converter is full at 1/g of the well, and read noise is READ_NOISE / sqrt(g) in electrons.
    """
    for row in range(image.shape[0]):
        for col in range(image.shape[1]):
            z = key + np.uint64((y0 + row) * full_width + x0 + col) * GOLDEN
            z = (z ^ (z >> S30)) * MIX1
            z = (z ^ (z >> S27)) * MIX2
            z ^= z >> S31
            for c in range(3):
                bits = (z if c == 0 else (z >> S24 if c == 1 else z >> S40)) & MASK12
                light = max(picture[row, col, c], ZERO) * scale
                light += math.sqrt((light * INVERSE_WELL + READ_VARIANCE) * gain) * normal[bits]
                image[row, col, c] = curve[int(min(max(light, ZERO), ONE) * FULL_SCALE + HALF)]


# --- metering: exposure as a camera module sets it in the dark ---
#
# The exposure gets longer, until it lasts a whole frame; then the gain gets higher. It follows the scene at once, as in
# a module that has settled. A module that still settles would change its picture in the middle of a sweep, and is
# locked by the program that sweeps.

FRAME_NS = 1_000_000_000 // 30
ELECTRONS = 3.4e5  # of a pixel for each W/m2/sr in a colour, exposed for FRAME_NS
MAX_GAIN = 8.0  # analogue; in front of the converter, so that the converter's share of the read noise falls
LEVEL, BRIGHTEST = 0.8, 0.99  # of full scale, for the brightest 1 % of the picture's pixels in any colour
SHORTEST_NS = 20_000
METERING_STEP_PX = 16  # pixels of a frame, each way, in one of the picture that is metered


def meter(radiance: Floats) -> Exposure:
    """For a picture (h, w, 3) in W/m2/sr, however coarse."""
    top = float(np.quantile(radiance.max(axis=2), BRIGHTEST)) * ELECTRONS
    wanted = LEVEL * FULL_WELL / max(top, 1e-9)
    open_ns = min(max(round(min(wanted, 1.0) * FRAME_NS), SHORTEST_NS), FRAME_NS)
    share = open_ns / FRAME_NS
    gain = min(max(wanted / share, 1.0), MAX_GAIN)
    return Exposure(np.float32(ELECTRONS * share * gain / FULL_WELL), np.float32(gain), open_ns)


def coarse(lens: Lens) -> Lens:
    """The same camera with pixels METERING_STEP_PX as large."""
    x, y = ((c + 0.5) / METERING_STEP_PX - 0.5 for c in lens.centre_px)
    return lens._replace(
        pixel_m=lens.pixel_m * METERING_STEP_PX,
        width=lens.width // METERING_STEP_PX,
        height=lens.height // METERING_STEP_PX,
        centre_px=(x, y),
    )
