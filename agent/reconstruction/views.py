"""One keyframe of a reconstruction: where a camera was, what it saw, and how far away that is.

Camera frame: x right, y down, z forward, origin at the gimbal's pivot. World = rotation @ p + position, p in the camera
frame. A small correction of a pose is (w, t): rotation R <- R exp([w]x), position T <- T + R t; w in rad and t in
metres, both along the camera's axes.

`keyframe` makes picture and depths from one whole sweep of the focus. A `Stack` is many views as arrays, for kernels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import Calibration, FocusFit, at_lens_position
from agent.core.ranging.focus import Array, at_tilt
from agent.perception.depth_peaks import COMMON, GridPeaks, measure_growth
from agent.perception.depth_sweep import DepthMap, clarity_of, measure
from agent.process.command import Failed
from hw.camera.camera import Image
from hw.compiled import compiled

# --- the camera: points to pixels and back, for whole pictures and inside kernels ---
#
# Rays meet `ahead_m` before the pivot. A point p has the slopes (x, y) = (p_x, p_y) / (p_z - ahead_m) and is seen at
#
# u = cx + f x (1 + bend (x^2 + y^2)),  v = cy + f y (1 + bend (x^2 + y^2))
#
# which is the model of agent/core/ranging/camera_model.py, with the centre of the first pixel at (0, 0). A depth is
# p_z, from the pivot along the axis.

Floats = NDArray[np.float64]

NEWTON = 8  # rounds for the cubic r (1 + bend r^2) = R; from R on they converge quadratically, five are enough at 1e-12
inlined = compiled(inline="always", error_model="numpy")


class Camera(NamedTuple):
    """Intrinsics of one picture, pixels; `ahead_m` in metres. Kernels take it as it is."""

    f_px: float
    cx_px: float
    cy_px: float
    bend: float
    ahead_m: float
    width: int
    height: int


def shrunk(camera: Camera, times: int) -> Camera:
    """The camera of pictures that are so many times smaller (each pixel the mean of times x times); a rest is cut."""
    half = (times - 1) / 2.0
    return Camera(
        camera.f_px / times,
        (camera.cx_px - half) / times,
        (camera.cy_px - half) / times,
        camera.bend,
        camera.ahead_m,
        camera.width // times,
        camera.height // times,
    )


def project(camera: Camera, points_m: Floats) -> Floats:
    """Points of the camera frame (..., 3) -> pixels (..., 2); NaN behind where rays meet, or where the bend folds."""
    depth = points_m[..., 2] - camera.ahead_m
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = points_m[..., :2] / depth[..., None]
        r2 = (slopes * slopes).sum(axis=-1)
        pixels = camera.f_px * slopes * (1.0 + camera.bend * r2)[..., None]
    pixels += (camera.cx_px, camera.cy_px)
    return np.where(((depth > 0.0) & (1.0 + 3.0 * camera.bend * r2 > 0.0))[..., None], pixels, np.nan)


def ray_slopes(camera: Camera, pixels: Floats) -> Floats:
    """Pixels (..., 2) -> slopes (..., 2) of their rays: a ray is (0, 0, ahead_m) + t (x, y, 1)."""
    seen = (pixels - (camera.cx_px, camera.cy_px)) / camera.f_px
    target = np.sqrt((seen * seen).sum(axis=-1))
    radius = target.copy()
    for _ in range(NEWTON):
        r2 = radius * radius
        radius -= (radius * (1.0 + camera.bend * r2) - target) / (1.0 + 3.0 * camera.bend * r2)
    return np.asarray(seen * (1.0 / (1.0 + camera.bend * radius * radius))[..., None])


def unproject(camera: Camera, pixels: Floats, depth_m: NDArray[Any]) -> Floats:
    """Pixels (..., 2) at depths (...) -> points of the camera frame (..., 3)."""
    slopes = ray_slopes(camera, pixels)
    return np.concatenate([slopes * (depth_m - camera.ahead_m)[..., None], depth_m[..., None]], axis=-1)


def pixel_grid(camera: Camera) -> Floats:
    """The centres (u, v) of all pixels, (height, width, 2)."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    return np.stack([u, v], axis=-1)


@inlined
def pixel_of(camera: Camera, x_m: float, y_m: float, z_m: float) -> tuple[float, float, bool]:
    """Inside kernels: the pixel (u, v) of one point of the camera frame, and whether it is before the camera."""
    depth = z_m - camera.ahead_m
    x, y = x_m / depth, y_m / depth
    r2 = x * x + y * y
    scale = camera.f_px * (1.0 + camera.bend * r2)
    return camera.cx_px + scale * x, camera.cy_px + scale * y, depth > 1e-6 and 1.0 + 3.0 * camera.bend * r2 > 0.0


@inlined
def slopes_of(camera: Camera, u: float, v: float) -> tuple[float, float]:
    """Inside kernels: the slopes (x, y) of one pixel's ray."""
    x, y = (u - camera.cx_px) / camera.f_px, (v - camera.cy_px) / camera.f_px
    target = math.sqrt(x * x + y * y)
    radius = target
    for _ in range(5):
        r2 = radius * radius
        radius -= (radius * (1.0 + camera.bend * r2) - target) / (1.0 + 3.0 * camera.bend * r2)
    scale = 1.0 / (1.0 + camera.bend * radius * radius)
    return x * scale, y * scale


# --- the view ---


def diagonal_prior(angle_rad: float, place_m: float) -> Floats:
    """(6, 6) covariance of (w, t) with the same standard deviation along each axis."""
    return np.diag([angle_rad**2] * 3 + [place_m**2] * 3)


VIEW_SIGMA = (math.radians(0.1), 1e-3)  # rad and m: what a view of a robot that stays has of its own


def steady() -> Floats:
    """(6, 6) own covariance of a view of a robot that stays."""
    return diagonal_prior(*VIEW_SIGMA)


@dataclass(frozen=True, eq=False)
class View:
    """One keyframe. Arrays are not copied, and must not be written to.

    Views of one (robot, incarnation) share what is wrong with where that robot believes to be.
    """

    robot: str
    incarnation: str
    seq: int  # of the sweep; the three together name a keyframe
    camera: Camera
    rotation: Floats  # (3, 3) camera to world
    position_m: Floats  # (3,) of the gimbal's pivot in the world
    pose_covariance: Floats  # (6, 6) of (w, t), rad and m: what all views of its robot are wrong by together
    picture: NDArray[np.float32]  # (height, width, 3) red green blue, linear light, 1 at the sensor's limit
    depth_m: NDArray[np.float32]  # (height, width) along the axis from the pivot; NaN: unknown
    sigma_m: NDArray[np.float32]  # (height, width) standard deviation of that; NaN: unknown
    own_covariance: Floats = field(default_factory=steady)  # as pose_covariance: what it alone is wrong by, beside that

    @property
    def key(self) -> tuple[str, str, int]:
        return self.robot, self.incarnation, self.seq


def to_world(view: View, points_m: Floats) -> Floats:
    """Points of the camera frame (..., 3) in the world."""
    return points_m @ view.rotation.T + view.position_m


def to_camera(view: View, points_m: Floats) -> Floats:
    """Points of the world (..., 3) in the camera frame."""
    return (points_m - view.position_m) @ view.rotation


def see(view: View, points_m: Floats) -> tuple[Floats, Floats]:
    """Points of the world (..., 3) -> pixels (..., 2), NaN where they are behind the camera, and depths (...)."""
    there = to_camera(view, points_m)
    return project(view.camera, there), there[..., 2]


def surface_points(view: View) -> Floats:
    """Where in the world each pixel's depth is, (height, width, 3); NaN where it is unknown."""
    return to_world(view, unproject(view.camera, pixel_grid(view.camera), view.depth_m.astype(float)))


def moved(view: View, w_rad: Floats, t_m: Floats) -> View:
    """The view with its pose corrected by (w, t), each (3,)."""
    return replace(
        view, rotation=view.rotation @ rotation_of(w_rad), position_m=view.position_m + view.rotation @ np.asarray(t_m)
    )


def rotation_of(w_rad: Floats) -> Floats:
    """exp([w]x), (3, 3): Rodrigues' formula."""
    x, y, z = w_rad
    angle = float(np.sqrt(x * x + y * y + z * z))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


# --- one picture that is sharp everywhere, in linear light, on the scale of the largest frame of a sweep ---
#
# A picture grows about the optical axis as its lens moves. Every frame that is sharpest anywhere is brought to the
# largest one's scale and made smaller, and each part of the picture is taken from its sharpest frame, with seams
# blended over a part.

Picture = NDArray[np.float32]


def linear(image: Image, gamma: float) -> Picture:
    """Bytes (height, width, 3) blue green red -> light, red green blue, 1 at the sensor's limit."""
    curve = ((np.arange(256) / 255.0) ** gamma).astype(np.float32)
    return curve[image[..., ::-1]]


def composite(
    images: Sequence[Image],
    size: Array,
    centre_px: tuple[float, float],
    clarity: Array,
    side_px: float,
    times: int,
    gamma: float,
) -> Picture:
    """(height / times, width / times, 3) of pictures `size` (n,) times as large as the largest (1 is the largest).

    clarity (n, rows, cols) of squares of side_px in the largest picture; centre_px: where the axis meets the picture.
    """
    height, width = images[0].shape[:2]
    small = (width // times, height // times)
    around = np.array([cv2.blur(one, (3, 3), borderType=cv2.BORDER_REPLICATE) for one in clarity])
    best = around.argmax(axis=0)
    total = np.zeros((small[1], small[0], 3), np.float32)
    weights = np.zeros((small[1], small[0]), np.float32)
    for n in np.unique(best):
        weight = _shares((best == n).astype(np.float32), side_px, times, small)
        frame = shrunk_frame(images[n], float(size[n]), centre_px, times, gamma)
        total += weight[..., None] * frame
        weights += weight
    return np.asarray(total / np.maximum(weights, 1e-6)[..., None], np.float32)


def shrunk_frame(image: Image, scale: float, centre_px: tuple[float, float], times: int, gamma: float) -> Picture:
    """A frame in linear light, magnified by 1 / scale about the centre, then made `times` smaller by means."""
    light = linear(image, gamma)
    if scale != 1.0:
        x, y = ((1.0 - scale) * c for c in centre_px)
        there = np.array([[scale, 0.0, x], [0.0, scale, y]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = light.shape[1], light.shape[0]
        warped = cv2.warpAffine(light, there, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        light = np.asarray(warped, np.float32)
    small = light.shape[1] // times, light.shape[0] // times
    return np.asarray(
        cv2.resize(light[: small[1] * times, : small[0] * times], small, interpolation=cv2.INTER_AREA), np.float32
    )


def _shares(squares: Picture, side_px: float, times: int, small: tuple[int, int]) -> Picture:
    """Squares (rows, cols) -> a weight of each small pixel (height, width), bilinear between the squares' centres."""
    scale = times / side_px
    shift = ((times - 1) / 2.0 - (side_px - 1) / 2.0) / side_px
    there = np.array([[scale, 0.0, shift], [0.0, scale, shift]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(squares, there, small, flags=flags, borderMode=cv2.BORDER_REPLICATE), np.float32)


# --- how far each pixel is, with its uncertainty, from the blocks of a sweep ---
#
# Blocks, and the parts of those that hold two depths, are sharp at their mean vergence, so 1/z is what lies on a line
# between them: a pixel has the bilinear mean of the four around it, if they agree,
#
# spread z < MOST_SPREAD,  sigma^2 = s^2 + (SPREAD_SHARE spread z^2)^2 + FLOOR_M^2
#
# spread: the largest of the four 1/z less the smallest; s: mean of their standard deviations. Where one is unknown, a
# pixel in the triangle between the other three has the plane through them. Whole blocks first, which hold more
# texture; parts fill in between.
#
# Before, a block and those around it that lie on a plane share what they know: noise of blocks is their own, and a
# plane stays one in 1/z. Beyond an edge nothing is shared, for what is there lies on no plane with this side. Noise
# hides how round a thing is, so that the squares are small: over SQUARE_M a ball of 70 mm is off a plane by less than
# FLOOR_M.

MOST_SPREAD = 0.12  # of the range: four blocks that differ by more are not on one surface
SPREAD_SHARE = 0.1  # of the spread, as an error: a surface between blocks is not quite a plane
FLOOR_M = 2e-3  # what no block is better than, whatever its fit says
ON_PLANE = 3.0  # sigmas that a block is off the plane of those around it at most
FEWEST, WORST = 0.6, 2.0  # share of a square that lies on it; mean squared deviation there, of what is expected
REACHES = 2, 1  # blocks to each side of the middle one; the larger square where it can be
SQUARE_M = 0.025  # from the middle of a square to that of its farthest row


class FocusMap(NamedTuple):
    """Of every pixel of the smaller picture; float32, NaN where unknown."""

    depth_m: NDArray[np.float32]  # (height, width)
    sigma_m: NDArray[np.float32]


def focus_map(found: DepthMap, focus: FocusFit, f_px: float, times: int, size: tuple[int, int]) -> FocusMap:
    """Depths of pixels of a picture `times` smaller than the one that was measured; size (width, height) of it.

    found has ranges of this calibration; f_px: of the picture that was measured.
    """
    depth, sigma = _from_grid(found.blocks, focus, f_px, found.block_px, times, size)
    if found.parts is not None:
        finer, its = _from_grid(found.parts, focus, f_px, found.block_px / found.along, times, size)
        depth, sigma = np.where(np.isnan(depth), finer, depth), np.where(np.isnan(depth), its, sigma)
    return FocusMap(depth.astype(np.float32), sigma.astype(np.float32))


def range_sigma_m(peaks: GridPeaks, focus: FocusFit) -> Floats:
    """Standard deviation (rows, cols) of the ranges, metres: the random part of ranging.focus.range_variance."""
    travel = peaks.lens_position - focus.rho0
    noise: Floats = np.abs(focus.b_m) / (travel * travel) * np.maximum(peaks.sigma, focus.noise)
    return noise


def _from_grid(
    peaks: GridPeaks, focus: FocusFit, f_px: float, side_px: float, times: int, size: tuple[int, int]
) -> tuple[Floats, Floats]:
    assert peaks.range_m is not None  # it was measured with a calibration
    known = peaks.accepted & np.isfinite(peaks.range_m)
    vergence = np.where(known, 1.0 / np.where(known, peaks.range_m, 1.0), np.nan)
    sigma = np.where(known, range_sigma_m(peaks, focus), np.nan)
    vergence, sigma = _shared(vergence, sigma * vergence**2, side_px / f_px)
    sigma = sigma / vergence**2
    (top, down), (left, across) = (
        _between(length, count, side_px, times) for length, count in zip(size[::-1], vergence.shape, strict=True)
    )
    corners = [(top + i, left + j) for i in (0, 1) for j in (0, 1)]
    shares = [(1 - down, 1 - across), (1 - down, across), (down, 1 - across), (down, across)]
    weight = np.stack([np.outer(*share) for share in shares])
    four = _with_the_fourth(np.stack([_picked(vergence, *corner) for corner in corners]), weight)
    depth: Floats = 1.0 / (weight * four).sum(axis=0)
    spread = four.max(axis=0) - four.min(axis=0)
    each = np.stack([_picked(sigma, *corner) for corner in corners])
    s = np.nansum(each, axis=0) / np.maximum(np.isfinite(each).sum(axis=0), 1)
    with np.errstate(invalid="ignore"):
        agree = spread * depth < MOST_SPREAD
    total = np.sqrt(s**2 + (SPREAD_SHARE * spread * depth**2) ** 2 + FLOOR_M**2)
    return np.where(agree, depth, np.nan), np.where(agree, total, np.nan)


def _shared(vergence: Floats, sigma: Floats, side: float) -> tuple[Floats, Floats]:
    """1/z of blocks (rows, cols) and their standard deviations, NaN where unknown, by the planes that they lie on.

    side: of a block, as a slope.
    """
    at, its = vergence.copy(), sigma.copy()
    alone = np.isfinite(vergence)
    for reach in REACHES:
        plane, doubt = _plane_of(vergence, sigma, reach)
        takes = alone & np.isfinite(plane) & (reach * side <= SQUARE_M * vergence)
        at[takes], its[takes] = plane[takes], np.hypot(doubt, COMMON * sigma)[takes]
        alone &= ~takes
    return at, its


def _plane_of(vergence: Floats, sigma: Floats, reach: int) -> tuple[Floats, Floats]:
    """The plane through the square of blocks about each, there, and its standard deviation; NaN: it lies on none."""
    rows, cols = vergence.shape
    side = range(-reach, reach + 1)
    steps = np.array([(1.0, across, down) for down in side for across in side])

    def around(values: Floats) -> Floats:
        wide = np.pad(values, reach, constant_values=np.nan)
        return np.stack([wide[k + reach :, n + reach :][:rows, :cols] for k in side for n in side], axis=-1)

    v, s = around(vergence), around(sigma)
    counts = np.isfinite(v)
    v, s = np.where(counts, v, 0.0), np.where(counts, s, 1.0)
    for _ in range(2):  # once with all, then without those that are off
        weight = np.where(counts, s**-2, 0.0)
        H = np.einsum("rck,ki,kj->rcij", weight, steps, steps)
        H = np.where(counts.sum(axis=-1)[..., None, None] > 0, H, np.eye(3))
        C = np.linalg.inv(H + 1e-9 * H[..., :1, :1] * np.eye(3))
        plane = np.einsum("rcij,rck,kj->rci", C, weight * v, steps)
        off = (v - plane @ steps.T) / s
        on, deviation = counts.sum(axis=-1), np.where(counts, off * off, 0.0).sum(axis=-1)
        counts &= np.abs(off) <= ON_PLANE
    takes = (on >= FEWEST * len(steps)) & counts[..., len(steps) // 2] & (deviation <= WORST * (on - 3))
    return np.where(takes, plane[..., 0], np.nan), np.where(takes, np.sqrt(C[..., 0, 0]), np.nan)


def _with_the_fourth(four: Floats, weight: Floats) -> Floats:
    """Where one of the four (4, height, width) is unknown, what the plane through the others has there.

    That is for pixels in the triangle between them, which are nearer to the one across than to the one that is missing.
    """
    filled = four.copy()
    for k in range(4):
        a, b = (j for j in range(4) if j not in (k, 3 - k))
        plane = four[a] + four[b] - four[3 - k]
        filled[k] = np.where(np.isnan(four[k]) & (weight[k] <= weight[3 - k]), plane, four[k])
    return filled


def _between(length: int, count: int, side_px: float, times: int) -> tuple[NDArray[np.int64], Floats]:
    """For each small pixel along one side, the square before it and its share of the way to the next; -1: beyond."""
    full = np.arange(length) * times + (times - 1) / 2.0
    at = (full - (side_px - 1.0) / 2.0) / side_px
    first = np.floor(at).astype(np.int64)
    return np.where((first >= 0) & (first < count - 1), first, -2), at - first


def _picked(values: Floats, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> Floats:
    inside = ((rows >= 0)[:, None]) & (cols >= 0)[None]
    return np.where(inside, values[np.maximum(rows, 0)[:, None], np.maximum(cols, 0)[None]], np.nan)


# --- picture and depths of one whole sweep of the focus ---

BLOCKS_ACROSS = 25  # blocks of 50 px in a picture of 1280: enough texture for a peak, enough of them for a surface
PICTURE_WIDTH = 320  # about what pictures are reduced to: there what is out of focus by a step looks sharp


class Swept(NamedTuple):
    """A keyframe but for where it was taken."""

    camera: Camera
    picture: Picture
    depth: FocusMap


def reduction(width_px: int) -> int:
    """How many times smaller pictures are made."""
    return max(1, round(width_px / PICTURE_WIDTH))


def keyframe(
    images: Sequence[Image],
    lens_positions: Array,
    calibration: Calibration,
    tilt_rad: float,
    corner_px: tuple[float, float] = (0.0, 0.0),
    grown_about_px: tuple[float, float] | None = None,
) -> Swept:
    """Frames of one sweep, in the order of their lens positions (n,); the camera looks up by tilt_rad.

    corner_px: upper left corner of the frames in the whole picture, if they show a part of it. grown_about_px: what
    stays where it is in the frames as they grow; None: the optical axis.
    Raises ConfigError for frames that are smaller than a block.
    """
    height, width = images[0].shape[:2]
    times, block = reduction(calibration.camera.width_px), max(8, calibration.camera.width_px // BLOCKS_ACROSS)
    block = min(block - block % 2, height, width)
    growth = growth_of(images, lens_positions, calibration)
    swept = clarity_of(list(images), lens_positions, block, growth, split=True)
    focus = at_tilt(calibration.swept, tilt_rad)
    fit = at_lens_position(calibration.camera, float(lens_positions[swept.reference]))
    found = measure(swept._replace(corner_px=corner_px), block, focus, camera=calibration.camera)
    whole = Camera(fit.f_px, fit.cx_px - corner_px[0], fit.cy_px - corner_px[1], fit.bend, fit.ahead_m, width, height)
    size = 1.0 + growth * (lens_positions - lens_positions[0]) / (lens_positions[-1] - lens_positions[0])
    size = size / size[swept.reference]
    centre, gamma = grown_about_px or (whole.cx_px, whole.cy_px), calibration.camera.gamma
    finest = swept.clarity if swept.finer is None else swept.finer.parts
    picture = composite(images, size, centre, finest, block / found.along, times, gamma)
    camera = shrunk(whole, times)
    return Swept(camera, picture, focus_map(found, focus, fit.f_px, times, (camera.width, camera.height)))


def growth_of(images: Sequence[Image], lens_positions: Array, calibration: Calibration) -> float:
    """Relative growth of the picture over the sweep, as calibrated; measured where it is not, 0 where it cannot be."""
    breathing = calibration.camera.breathing
    if breathing == 0.0:
        return measure_growth(images, lens_positions) or 0.0
    first, last = (at_lens_position(calibration.camera, float(lens_positions[n])).f_px for n in (0, -1))
    return last / first - 1.0


# --- many views as arrays, for kernels ---


class Stack(NamedTuple):
    """n views: pictures of different sizes are laid into the corner of the largest; beyond, depth and sigma are NaN."""

    cameras: Floats  # (n, 5) f_px, cx_px, cy_px, bend, ahead_m
    sizes: NDArray[np.int64]  # (n, 2) width, height
    rotations: Floats  # (n, 3, 3) camera to world
    positions_m: Floats  # (n, 3)
    depth_m: NDArray[np.float32]  # (n, height, width)
    sigma_m: NDArray[np.float32]
    pictures: NDArray[np.float32]  # (n, height, width, channels): 3 red green blue, 1 grey, 0 where depths suffice


def stacked(views: Sequence[View], channels: Literal[0, 1, 3] = 3) -> Stack:
    """Copies of what views hold, and of light as much as is asked for: of 500 views it is most of the memory.

    Raises Failed where there is no view.
    """
    if not views:
        raise Failed("there is no keyframe to reconstruct from")
    width, height = (max(getattr(view.camera, name) for view in views) for name in ("width", "height"))
    count = len(views)
    depth = np.full((count, height, width), np.nan, np.float32)
    sigma, pictures = depth.copy(), np.zeros((count, height, width, channels), np.float32)
    for n, view in enumerate(views):
        inside = np.s_[n, : view.camera.height, : view.camera.width]
        depth[inside], sigma[inside] = view.depth_m, view.sigma_m
        if channels:
            pictures[inside] = view.picture if channels == 3 else view.picture.mean(axis=-1, keepdims=True)
    return Stack(
        cameras=np.array([view.camera[:5] for view in views], float),
        sizes=np.array([view.camera[5:] for view in views], np.int64),
        rotations=np.array([view.rotation for view in views], float),
        positions_m=np.array([view.position_m for view in views], float),
        depth_m=depth,
        sigma_m=sigma,
        pictures=pictures,
    )


@inlined
def camera_in(stack: Stack, n: int) -> Camera:
    """The camera of one view, for kernels."""
    c, size = stack.cameras[n], stack.sizes[n]
    return Camera(c[0], c[1], c[2], c[3], c[4], size[0], size[1])


def camera_at(stack: Stack, n: int) -> Camera:
    """The same in plain numbers, for use outside kernels."""
    f, cx, cy, bend, ahead = stack.cameras[n].tolist()
    return Camera(f, cx, cy, bend, ahead, *stack.sizes[n].tolist())
