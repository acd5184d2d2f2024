"""One sweep of the focus over a view: clarity of its blocks, the peak of each, and the distance that it tells.

Blocks without a single clear peak (no texture, a depth edge, sharpest outside the sweep) get no distance. The grid of
blocks grows with the picture (focus breathing), so that a block keeps its piece of the scene; the picture itself is
never resampled, which would change its clarity.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.kernel.config import ConfigError
from agent.kernel.ranging.calibration import FocusFit
from agent.kernel.ranging.focus import MIN_POSITIONS, Array, Method, NoPeak, h, phase_sigma
from agent.perception.clarity.breathing import GROWTH_POWER, measure_growth
from agent.perception.clarity.clarity import grid, tenengrad_grid
from agent.perception.clarity.gradient import luminance
from agent.perception.clarity.peaks import block_peaks
from agent.perception.tracking.box import Box
from agent.perception.tracking.follow import check_box
from agent.pictures.depth_box import MIN_RISE, BoxRange, box_clarity
from hw.camera.camera import Camera, CameraError, Image, nearest
from hw.camera.files import StackCamera

SWEEP_STEPS = 30  # lens positions of a camera; of a stack every photograph is used
HOME_SETTLE_S = 0.12  # after the long way back to the starting side; small steps ring less
SETTLE_S = 0.05
MIN_BLOCK_PX = 8  # smaller ones hold more noise than texture
MIN_QUALITY = 0.96  # of a block's peak: over many blocks a wrong one costs more than a missing one
MAX_GROWTH = 0.2  # of the picture in one sweep: beyond it it is not breathing

OnStep = Callable[[int, int], None]  # lens positions done, in all


class DepthSweep(NamedTuple):
    lens_positions: Array  # (n,) as the driver reports them; of a stack in the unit of its positions.csv
    clarity: Array  # (n, rows, cols)
    sharp: Image  # (height, width, 3), each block from the frame in which it is sharpest
    growth: float  # of the picture from the first position to the last, relative
    reference: int  # the position whose picture is largest; blocks are squares there, and smaller in the others
    box_clarity: Array | None = None  # (n,) in the middle of the box, drawn in the largest picture


class DepthMap(NamedTuple):
    """Arrays are (rows, cols), row 0 on top; sigma in lens positions."""

    block_px: int
    lens_position: Array  # of the clarity's peak
    sigma: Array
    width: Array  # half width of the peak, lens positions
    quality: Array
    accepted: NDArray[np.bool_]
    range_m: Array | None  # z-depth from the gimbal pivot; NaN where there is none. None without a calibration
    sharp: Image
    growth: float
    box_range: BoxRange | NoPeak | None = None  # of what is in the box, if there is one


def sweep(
    camera: Camera, block: int, progress: OnStep, growth: float | None = None, box: Box | None = None
) -> DepthSweep:
    """Clarity of every block at every lens position, from the lowest upwards: one direction, one hysteresis.

    growth: of the picture from the first position to the last, 0.03 for three percent; None measures it, and
    takes none where the frames do not tell. Raises ConfigError for a block, a growth or a box that cannot be,
    CameraError for a source without focus.
    """
    width, height = camera.size
    if not MIN_BLOCK_PX <= block <= min(width, height):
        raise ConfigError(
            f"--block {block}: the picture is {width}x{height}; choose {MIN_BLOCK_PX} to {min(width, height)}"
        )
    if growth is not None and not abs(growth) <= MAX_GROWTH:
        raise ConfigError(f"growth {growth}: give the share of the picture, -{MAX_GROWTH} to {MAX_GROWTH}")
    if box is not None:
        check_box(box, (width, height))
    wanted = _lens_positions(camera)
    camera.set_focus(wanted[0])
    camera.read(settle_s=HOME_SETTLE_S)
    reached, images = [], []
    for done, lens_position in enumerate(wanted, start=1):
        reached.append(float(camera.set_focus(lens_position)))
        images.append(camera.read(settle_s=SETTLE_S).image)
        progress(done, len(wanted))
    lens_positions = np.array(camera.positions if isinstance(camera, StackCamera) else reached)
    if growth is None:
        growth = measure_growth([luminance(image) for image in images]) or 0.0  # unknown: as good as any
    return clarity_of(images, lens_positions, block, growth, box)


def clarity_of(
    images: list[Image], lens_positions: Array, block: int, growth: float, box: Box | None = None
) -> DepthSweep:
    """The frames of a sweep -> clarity on a grid that grows as they do; growth is linear in the lens position.

    A picture that grows spreads its gradients over more pixels: energy a pixel falls as size^-2 for texture coarser
    than a pixel, not at all for texture that is alike at every scale. Left alone this tilts every curve, and the wide
    ones' peaks most. With GROWTH_POWER the peaks of the twin's wall lie within 0.8 lens positions of the truth from
    0.29 to 1.35 m; without it they are up to 4.7 off, the nearer the more.
    """
    height, width = images[0].shape[:2]
    size = 1.0 + growth * (lens_positions - lens_positions[0]) / (lens_positions[-1] - lens_positions[0])
    reference = int(size.argmax())  # nothing of a grid that fits the largest picture leaves the others
    grids = [(grid(height, block, k), grid(width, block, k)) for k in size / size[reference]]
    clarity = np.array([tenengrad_grid(image, *edges) for image, edges in zip(images, grids, strict=True)])
    sharp = images[reference].copy()
    for (row, col), best in np.ndenumerate(clarity.argmax(axis=0)):
        rows, cols = grids[best]
        part = images[best][rows[row] : rows[row + 1], cols[col] : cols[col + 1]]
        place = np.s_[row * block : (row + 1) * block, col * block : (col + 1) * block]
        sharp[place] = cv2.resize(part, (block, block))  # for the eye alone
    clarity *= ((size / size[reference]) ** GROWTH_POWER)[:, None, None]
    in_box = None if box is None else box_clarity(images, size / size[reference], box)
    return DepthSweep(lens_positions, clarity, sharp, growth, reference, in_box)


def _lens_positions(camera: Camera) -> list[int]:
    focus = camera.focus_range()
    if focus is None:
        raise CameraError("the focus of this source cannot be set; a depth map needs a camera or a stack: that can")
    if isinstance(camera, StackCamera):
        found = list(range(focus.lowest, focus.highest + 1))
    else:
        found = sorted({nearest(round(k), focus) for k in np.linspace(focus.lowest, focus.highest, SWEEP_STEPS)})
    if len(found) < MIN_POSITIONS:
        raise CameraError(f"{len(found)} lens positions; a depth map needs at least {MIN_POSITIONS}")
    return found


def measure(
    taken: DepthSweep,
    block: int,
    focus: FocusFit | None,
    method: Method = "matched",
    min_quality: float = MIN_QUALITY,
) -> DepthMap:
    """Peak of every block's curve, and its range where a calibration tells it; every method keeps the same blocks."""
    count, rows, cols = taken.clarity.shape
    peaks = block_peaks(taken.lens_positions, taken.clarity.reshape(count, rows * cols).T, method)
    shape, sigma = (rows, cols), np.hypot(peaks.sigma, phase_sigma(peaks.width, block * block))
    textured = taken.clarity.max(axis=0) - np.median(taken.clarity, axis=0) >= MIN_RISE
    lens_position = peaks.lens_position.reshape(shape)
    accepted = (peaks.accepted & (peaks.quality >= min_quality)).reshape(shape) & textured
    range_m = None
    if focus is not None:
        range_m = np.full(shape, np.nan)
        for cell in np.argwhere(accepted):
            z_m = h(focus, float(lens_position[tuple(cell)]))
            if z_m is not None:  # else sharp at infinity
                range_m[tuple(cell)] = z_m
    return DepthMap(
        block_px=block,
        lens_position=lens_position,
        sigma=sigma.reshape(shape),
        width=peaks.width.reshape(shape),
        quality=peaks.quality.reshape(shape),
        accepted=accepted,
        range_m=range_m,
        sharp=taken.sharp,
        growth=taken.growth,
    )
