"""One sweep of the focus over a view: clarity of its blocks, the peak of each, and the distance that it tells.

Blocks without a single clear peak (no texture, sharpest outside the sweep) get no distance; those astride an edge in
depth give way to their parts (depth_edges.py). The grid of blocks grows with the picture (focus breathing), so that a
block keeps its piece of the scene; the picture itself is never resampled, which would change its clarity.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError
from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.focus import MIN_POSITIONS, Array, Method, NoPeak
from agent.perception.clarity.breathing import GROWTH_POWER, measure_growth
from agent.perception.clarity.clarity import Sums, areas, grid, tenengrad_sums
from agent.perception.depth_box import BoxRange, box_clarity
from agent.perception.depth_edges import cuts, in_doubt, with_edges
from agent.perception.depth_peaks import GridPeaks, Reason, each_part, grid_peaks
from agent.perception.depth_shown import shown
from agent.perception.sharp_picture import sharpest
from agent.perception.tracking.box import Box
from agent.perception.tracking.follow import check_box
from hw.camera.camera import Camera, CameraError, Image, nearest
from hw.camera.files import StackCamera

SWEEP_STEPS = 30  # lens positions of a camera; of a stack every photograph is used
HOME_SETTLE_S = 0.12  # after the long way back to the starting side; small steps ring less
SETTLE_S = 0.05
MIN_BLOCK_PX = 8  # smaller ones hold more noise than texture
MIN_QUALITY = 0.96  # of a block's peak: over many blocks a wrong one costs more than a missing one
CELL_QUALITY = 0.90  # of a cell's: it only speaks for or against its neighbours
MAX_GROWTH = 0.2  # of the picture in one sweep: beyond it it is not breathing

OnStep = Callable[[int, int], None]  # lens positions done, in all


class Finer(NamedTuple):
    """Clarity per pixel of what blocks are cut into."""

    parts: Array  # (n, rows * k, cols * k)
    cells: Array  # (n, rows * 2 k, cols * 2 k)


class DepthSweep(NamedTuple):
    lens_positions: Array  # (n,) as the driver reports them; of a stack in the unit of its positions.csv
    clarity: Array  # (n, rows, cols) of the blocks, per pixel
    sharp: Image  # (height, width, 3), each part of a block from the frame in which it is sharpest
    growth: float  # of the picture from the first position to the last, relative
    reference: int  # the position whose picture is largest; blocks are squares there, and smaller in the others
    box_clarity: Array | None = None  # (n,) in the middle of the box, drawn in the largest picture
    finer: Finer | None = None  # what edges in depth are found with; None: blocks of so few pixels are not cut


class DepthMap(NamedTuple):
    """What is known of each block, and of the parts of those that hold more than one depth."""

    block_px: int
    blocks: GridPeaks
    parts: GridPeaks | None  # of all blocks; those of a block that is accepted as a whole count for nothing
    sharp: Image
    growth: float
    box_range: BoxRange | NoPeak | None = None  # of what is in the box, if there is one

    @property
    def along(self) -> int:
        """Parts along the side of a block."""
        return 1 if self.parts is None else len(self.parts.reason) // len(self.blocks.reason)

    def used_parts(self) -> NDArray[np.bool_]:
        """(rows * along, cols * along): parts that are accepted in place of their blocks."""
        whole = each_part(self.blocks.accepted, self.along)
        return np.zeros(whole.shape, bool) if self.parts is None else self.parts.accepted & ~whole

    def on_parts(self, of_blocks: Array, of_parts: Array | None) -> Array:
        """One value a part (rows * along, cols * along), its block's where that is accepted; NaN: neither is."""
        blocks: Array = np.where(self.blocks.accepted, of_blocks, np.nan)
        fine = each_part(blocks, self.along)
        return fine if of_parts is None else np.asarray(np.where(self.used_parts(), of_parts, fine), float)

    def lens_position_on_parts(self) -> Array:
        return self.on_parts(self.blocks.lens_position, None if self.parts is None else self.parts.lens_position)

    def range_on_parts(self) -> Array | None:
        """In metres; None without a calibration."""
        if self.blocks.range_m is None:
            return None
        return self.on_parts(self.blocks.range_m, None if self.parts is None else self.parts.range_m)


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
        growth = measure_growth(images) or 0.0  # unknown: as good as any
    return clarity_of(images, lens_positions, block, growth, box, split=True)


def clarity_of(
    images: list[Image],
    lens_positions: Array,
    block: int,
    growth: float,
    box: Box | None = None,
    split: bool = False,
) -> DepthSweep:
    """The frames of a sweep -> clarity on a grid that grows as they do; growth is linear in the lens position.

    A picture that grows spreads its gradients over more pixels: energy a pixel falls as size^-2 for texture coarser
    than a pixel, not at all for texture that is alike at every scale. Left alone this tilts every curve, and the wide
    ones' peaks most. With GROWTH_POWER the peaks of the twin's wall lie within 0.8 lens positions of the truth from
    0.29 to 1.35 m; without it they are up to 4.7 off, the nearer the more.

    split: clarity of the blocks' parts and cells as well, by which `measure` finds and splits blocks with two depths.
    """
    height, width = images[0].shape[:2]
    size = 1.0 + growth * (lens_positions - lens_positions[0]) / (lens_positions[-1] - lens_positions[0])
    reference = int(size.argmax())  # nothing of a grid that fits the largest picture leaves the others
    size /= size[reference]
    n = cuts(block) if split else 1
    grids = [(grid(height, block, k, cuts=n), grid(width, block, k, cuts=n)) for k in size]
    sums = [tenengrad_sums(image, *edges) for image, edges in zip(images, grids, strict=True)]

    def per_pixel(along: int) -> Array:
        """Clarity of squares of along x along cells."""
        mean = [_pooled(s, along) / areas(r[::along], c[::along]) for s, (r, c) in zip(sums, grids, strict=True)]
        scaled: Array = np.array(mean) * (size**GROWTH_POWER)[:, None, None]
        return scaled

    clarity, finer, parts = per_pixel(n), None, n
    if n > 1:
        finer, parts = Finer(per_pixel(2), per_pixel(1)), 2
    sharp = sharpest(images, [(r[::parts], c[::parts]) for r, c in grids], finer.parts if finer else clarity, reference)
    in_box = None if box is None else box_clarity(images, size, box)
    return DepthSweep(lens_positions, clarity, sharp, growth, reference, in_box, finer)


def _pooled(sums: Sums, along: int) -> Sums:
    """(rows, cols) -> (rows / along, cols / along): sums of along x along."""
    rows, cols = (size // along for size in sums.shape)
    together: Sums = sums.reshape(rows, along, cols, along).sum(axis=(1, 3))
    return together


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
    """Peak of every block's curve, and its range where a calibration tells it; every method keeps the same blocks.

    Where the sweep was taken to be split, blocks with two depths are refused, and their parts are measured.
    """
    x, finer, parts, side = taken.lens_positions, taken.finer, None, 2 * block / cuts(block)
    blocks = grid_peaks(x, taken.clarity, block * block, min_quality)
    if finer is not None:
        step, along = float(np.ptp(x)) / (len(x) - 1), len(finer.cells[0]) // len(blocks.reason)
        parts = grid_peaks(x, finer.parts, side * side, min(min_quality, MIN_QUALITY), (3, 3))
        asked = each_part(in_doubt(blocks, parts, step), along)
        cells = grid_peaks(x, finer.cells, side * side / 4, CELL_QUALITY, (5, 5), asked)
        all_over = shown(x, finer.parts, blocks, parts, step)
        blocks, parts = with_edges(blocks, parts, cells, step)
        blocks = blocks.refused(blocks.accepted & ~all_over, Reason.NO_TEXTURE)
        parts = parts if method == "matched" else parts.by(method, x, finer.parts)
    blocks = blocks if method == "matched" else blocks.by(method, x, taken.clarity)
    if focus is not None:
        blocks, parts = blocks.ranged(focus), None if parts is None else parts.ranged(focus)
    return DepthMap(block, blocks, parts, taken.sharp, taken.growth)
