"""One sweep of the focus over a view: clarity of its blocks, the peak of each, and the distance that it tells.

Blocks without a single clear peak (no texture, sharpest outside the sweep) get no distance; those astride an edge in
depth give way to their parts. The grid of blocks grows with the picture (focus breathing), so that a block keeps its
piece of the scene; the picture itself is never resampled, which would change its clarity.

`sweep` moves the lens of a camera that stands still. `sweep_depth` takes the frames of a robot's sweep of a target, and
`BlockSweep` whole frames of a robot that drifts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError
from agent.core.ranging.camera_model import Calibration, CameraFit, FocusFit, at_lens_position
from agent.core.ranging.focus import ANY_WAY, MIN_POSITIONS, Array, Method, NoPeak, at_tilt, phase_sigma
from agent.core.step_io import BlockPeaks, SweepPlan
from agent.perception.clarity import (
    Edges,
    Sums,
    areas,
    block_peaks,
    grid,
    growth_power,
    half_clarity,
    luminance,
    tenengrad_grid,
    tenengrad_sums,
)
from agent.perception.depth_peaks import (
    BoxRange,
    GridPeaks,
    Reason,
    as_sure,
    box_clarity,
    cuts,
    each_part,
    grid_peaks,
    in_doubt,
    measure_growth,
    scatter,
    shown,
    with_edges,
)
from agent.perception.tracking.appearance import Box
from agent.perception.tracking.follow import check_box
from hw.camera.camera import Camera, CameraError, Image, nearest
from hw.camera.files import LUMINANCE, StackCamera
from replay.viewers.viewer_channels import SweepDepth, SweepFrame

# --- sweep of a camera that stands still ---

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
    corner_px: tuple[float, float] = (0.0, 0.0)  # of what was measured, in the first picture
    moved_px: float = 0.0  # that the picture moved during the sweep, which was undone
    light: float = 1.0  # of the brightest frame to the darkest, which was undone; 1: as good as steady


class DepthMap(NamedTuple):
    """What is known of each block, and of the parts of those that hold more than one depth."""

    block_px: int
    blocks: GridPeaks
    parts: GridPeaks | None  # of all blocks; those of a block that is accepted as a whole count for nothing
    sharp: Image
    growth: float
    box_range: BoxRange | NoPeak | None = None  # of what is in the box, if there is one
    corner_px: tuple[float, float] = (0.0, 0.0)  # of the map, in the first picture
    moved_px: float = 0.0  # that the picture moved during the sweep, which was undone
    light: float = 1.0  # see DepthSweep
    uneven: float = 1.0  # the longest step between lens positions to the median one

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

    growth: of the picture from the first position to the last, 0.03 for three percent; None measures it, and takes 0
    where the frames do not tell. Raises ConfigError for a block, a growth or a box that cannot be,
    CameraError for a source without focus, and for frames that cannot be believed.
    """
    width, height = camera.size
    if min(width, height) < MIN_BLOCK_PX:
        raise ConfigError(f"the picture is {width}x{height}, too small: give pictures of {MIN_BLOCK_PX} px or more")
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
    names: Sequence[str] = [f"lens position {k:g}" for k in reached]
    if isinstance(camera, StackCamera):
        reached, names = list(camera.positions), camera.names
    lens_positions = np.array(reached)
    check_frames(images, names)
    if growth is None:
        growth = measure_growth(images, lens_positions) or 0.0  # unknown: as good as any
    steady = steadied(images, growth)
    if box is not None:
        box = box._replace(x=box.x - steady.corner_px[0], y=box.y - steady.corner_px[1])
    height, width = steady.images[0].shape[:2]
    if block > min(width, height):
        raise CameraError(f"the picture moved by {steady.moved_px:.0f} px during the sweep; fix the camera")
    if box is not None:
        check_box(box, (width, height))
    taken = clarity_of(steady.images, lens_positions, block, growth, box, split=True)
    return taken._replace(corner_px=steady.corner_px, moved_px=steady.moved_px)


# --- what is wrong with the frames of a sweep ---

JUMP = 1.15  # of the mean brightness from one frame to the next; blur and breathing leave it as it is
CREEP = 1.02  # of the brightest frame to the darkest; blur makes 1.016 of a picture with much contrast, by its gamma
LIGHT_ROWS = 4  # one of so many is looked at: all of them would take a third of clarity's own time
DARK = 4.0  # of 255: below it noise and black level are most of a mean
STILL_PX = 2.0  # of a picture from end to end: less is no movement
STEP_SHARE = 0.1  # of the picture's width from one frame to the next: more is another picture
SURE = 0.2  # response of phase correlation from which on a shift is one


def check_frames(images: Sequence[Image], names: Sequence[str]) -> None:
    """Raises CameraError, by the names of the frames, for the same picture twice and for brightness that jumps: of
    either the peaks of clarity tell nothing. Frames of one grey alone are alike by right."""
    kept = [image.tobytes() if np.ptp(image) else str(k).encode() for k, image in enumerate(images)]
    same = [k for k in range(1, len(kept)) if kept[k] == kept[k - 1]]
    if same:
        end = next((k for k in range(same[0], len(kept)) if k + 1 not in same), same[0])
        which = f"{names[same[0]]} to {names[end]} are" if end > same[0] else f"{names[end]} is"
        raise CameraError(
            f"{which} the same picture as {names[same[0] - 1]}: the camera hung, or a file was copied; "
            "take the sweep again, or their rows out"
        )
    first = {data: k for k, data in reversed(list(enumerate(kept)))}
    for k, data in enumerate(kept):
        if first[data] != k:
            raise CameraError(f"{names[first[data]]} and {names[k]} are the same picture; take one of them out")
    light = [brightness(image) + 1.0 for image in images]
    for k in range(1, len(light)):
        ratio = light[k] / light[k - 1]
        if not 1.0 / JUMP < ratio < JUMP:
            raise CameraError(
                f"brightness jumps at {names[k]}, to {ratio:.2f} times that of {names[k - 1]}; "
                "set exposure and gain by hand, and take the sweep again"
            )


class Steadied(NamedTuple):
    """The part that all frames show, cut out of each where it lies in it."""

    images: list[Image]
    corner_px: tuple[int, int]  # of it in the first frame
    moved_px: float  # from end to end; 0: they stood still


def steadied(images: Sequence[Image], growth: float) -> Steadied:
    """Frames on each other. Nothing is resampled, which would change clarity: shifts are whole pixels.

    Where texture lies on one side only, growth looks like a shift; what growth explains is left alone. Raises
    CameraError for frames that are not of one view.
    """
    height, width = images[0].shape[:2]
    window = cv2.createHanningWindow((width, height), cv2.CV_32F)
    at, before = [np.zeros(2)], luminance(images[0]).astype(np.float32)
    for image in images[1:]:
        grey = luminance(image).astype(np.float32)
        shift, response = cv2.phaseCorrelate(before, grey, window)
        at.append(at[-1] + (np.array(shift) if response > SURE else 0.0))
        if np.abs(at[-1] - at[-2]).max() > STEP_SHARE * width:
            raise CameraError(
                f"the picture moved by {np.abs(at[-1] - at[-2]).max():.0f} px from one frame to the next; "
                "fix the camera, and take the sweep again"
            )
        before = grey
    places = np.array(at)
    moved_px = float(np.hypot(*np.ptp(places, axis=0)))
    if moved_px <= STILL_PX + 0.5 * abs(growth) * max(width, height):
        return Steadied(list(images), (0, 0), 0.0)
    whole = np.rint(places).astype(int)
    left, top = (-whole.min(axis=0)).tolist()
    wide, high = (np.array([width, height]) - np.ptp(whole, axis=0)).tolist()
    if min(wide, high) < MIN_BLOCK_PX:
        raise CameraError(f"the picture moved by {moved_px:.0f} px during the sweep; fix the camera")
    cut = [
        image[top + y : top + y + high, left + x : left + x + wide]
        for image, (x, y) in zip(images, whole.tolist(), strict=True)
    ]
    return Steadied(cut, (left, top), moved_px)


def clarity_of(
    images: list[Image],
    lens_positions: Array,
    block: int,
    growth: float,
    box: Box | None = None,
    split: bool = False,
) -> DepthSweep:
    """The frames of a sweep -> clarity on a grid that grows as they do; growth is linear in the lens position.

    A picture that grows spreads its gradients over more pixels. Left alone this tilts every curve, and the wide ones'
    peaks most: those of the twin's floor by 9 lens positions at 0.25 m, not at all at 0.8 m. With `growth_power` they
    lie within a position of the truth from 0.4 to 0.8 m.

    Clarity goes with the square of the light. Where that creeps, by an exposure or a lamp that is not steady, all of a
    sweep's peaks go with it; it is taken out as the mean of all blocks together, which follow the picture as it grows.

    split: clarity of the blocks' parts and cells as well, by which `measure` finds and splits blocks with two depths.
    """
    height, width = images[0].shape[:2]
    size = 1.0 + growth * (lens_positions - lens_positions[0]) / (lens_positions[-1] - lens_positions[0])
    reference = int(size.argmax())  # nothing of a grid that fits the largest picture leaves the others
    size /= size[reference]
    n = cuts(block) if split else 1
    grids = [(grid(height, block, k, cuts=n), grid(width, block, k, cuts=n)) for k in size]
    sums = [tenengrad_sums(image, *edges) for image, edges in zip(images, grids, strict=True)]

    light = np.array(
        [brightness(each[r[0] : r[-1] : LIGHT_ROWS, c[0] : c[-1]]) for each, (r, c) in zip(images, grids, strict=True)]
    )
    crept = float(light.min()) > DARK and float(light.max() / light.min()) > CREEP
    steady = (light[reference] / light) ** 2 if crept else np.ones(len(light))

    def per_pixel(along: int) -> Array:
        """Clarity of squares of along x along cells."""
        return np.array(
            [
                k * (_pooled(s, along) / areas(r[::along], c[::along]))
                for k, s, (r, c) in zip(steady, sums, grids, strict=True)
            ]
        )

    clarity, finer, parts, sizes = per_pixel(n), None, n, size[:, None, None]
    half = [k * half_clarity(image, r[::n], c[::n]) for k, image, (r, c) in zip(steady, images, grids, strict=True)]
    power = growth_power(clarity, np.array(half))
    clarity *= sizes**power  # as if the picture did not grow
    if n > 1:
        finer = Finer(*(per_pixel(along) * sizes ** each_part(power, n // along) for along in (2, 1)))
        parts = 2
    sharp = sharpest(images, [(r[::parts], c[::parts]) for r, c in grids], finer.parts if finer else clarity, reference)
    in_box = None if box is None else steady * box_clarity(images, size, box)
    ratio = float(light.max() / light.min()) if crept else 1.0
    return DepthSweep(lens_positions, clarity, sharp, growth, reference, in_box, finer, light=ratio)


def brightness(image: Image) -> float:
    """The mean luminance of a picture, grey or blue green red, 0 to 255."""
    mean = cv2.mean(image)
    return mean[0] if image.ndim == 2 else float(np.dot(mean[:3], LUMINANCE))


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
    camera: CameraFit | None = None,
) -> DepthMap:
    """Peak of every block's curve, and its range where a calibration tells it; every method keeps the same blocks.
    camera: that took the pictures, as calibrated; they begin at corner_px of it. With it ranges off its axis are right
    as well.

    Where the sweep was taken to be split, blocks with two depths are refused, and their parts are measured.
    """
    x, finer, parts, scale, side = taken.lens_positions, taken.finer, None, None, 2 * block / cuts(block)
    blocks = grid_peaks(x, taken.clarity, min_quality)
    if finer is not None:
        step, along = float(np.ptp(x)) / (len(x) - 1), len(finer.cells[0]) // len(blocks.reason)
        parts = grid_peaks(x, finer.parts, min(min_quality, MIN_QUALITY), (3, 3))
        asked = each_part(in_doubt(blocks, parts, step), along)
        cells = grid_peaks(x, finer.cells, CELL_QUALITY, (5, 5), asked)
        unsure = as_sure(parts, None, side * side)  # how sure parts are is known when those on edges are out
        all_over = shown(x, finer.parts, blocks, unsure, step)
        blocks, unsure = with_edges(blocks, unsure, cells, finer.parts, step)
        blocks = blocks.refused(blocks.accepted & ~all_over, Reason.NO_TEXTURE)
        parts = parts._replace(reason=unsure.reason)
        scale = scatter(parts)
        parts = as_sure(parts, scale, side * side)
        parts = parts if method == "matched" else parts.by(method, x, finer.parts)
    own = scatter(blocks)
    blocks = as_sure(blocks, scale if own is None else own, block * block)
    blocks = blocks if method == "matched" else blocks.by(method, x, taken.clarity)
    if focus is not None:
        if camera is not None:  # the picture in which blocks are squares has grown since
            camera = at_lens_position(camera, float(x[taken.reference]))
        blocks = blocks.ranged(focus, camera, block, taken.corner_px, _outward_of(taken, camera, block, 1))
        if parts is not None:
            way = _outward_of(taken, camera, block, cuts(block) // 2)
            parts = parts.ranged(focus, camera, side, taken.corner_px, way)
    return DepthMap(
        block,
        blocks,
        parts,
        taken.sharp,
        taken.growth,
        corner_px=taken.corner_px,
        moved_px=taken.moved_px,
        light=taken.light,
        uneven=float(np.diff(x).max() / max(np.median(np.diff(x)), 1e-9)),
    )


def _outward_of(taken: DepthSweep, camera: CameraFit | None, block: int, along: int) -> Array | None:
    """Of along x along parts of each block; None: without a camera nobody knows where the axis is."""
    rows, cols = (grid(length, block, cuts=along) for length in taken.sharp.shape[:2])
    return None if camera is None else outward(taken, camera, rows, cols)


# --- one picture that is sharp everywhere, for the eye, and for which way its texture runs ---


def sharpest(images: Sequence[Image], grids: Sequence[tuple[Edges, Edges]], clarity: Array, reference: int) -> Image:
    """Each square of a grid from the frame in which it and its neighbours together are sharpest.

    grids: (rows, cols) of each frame, clarity (n, rows, cols). Squares differ by a pixel at most from frame to frame;
    they are laid where they are in the frame `reference`, and what no square covers is that frame's.
    """
    picture = images[reference].copy()
    around = np.array([cv2.blur(one, (3, 3), borderType=cv2.BORDER_REPLICATE) for one in clarity])
    edges = [(rows.tolist(), cols.tolist()) for rows, cols in grids]
    down, across = edges[reference]
    for row, bests in enumerate(around.argmax(axis=0).tolist()):
        for col, best in enumerate(bests):
            top, left = edges[best][0][row], edges[best][1][col]
            place = picture[down[row] : down[row + 1], across[col] : across[col + 1]]
            part = images[best][top : top + place.shape[0], left : left + place.shape[1]]
            place[: part.shape[0], : part.shape[1]] = part
    return picture


def outward(taken: DepthSweep, camera: CameraFit, rows: Edges, cols: Edges) -> Array:
    """Share (rows - 1, cols - 1) of the gradients' energy that points away from the axis, of the squares between these
    edges in the picture that is sharp everywhere; without gradients 1/2."""
    grey = luminance(taken.sharp)[: rows[-1], : cols[-1]].astype(np.float32)
    across, down = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    x = np.arange(cols[-1]) + taken.corner_px[0] - camera.cx_px
    y = (np.arange(rows[-1]) + taken.corner_px[1] - camera.cy_px)[:, None]
    away = (across * x + down * y) ** 2 / np.maximum(x * x + y * y, 1.0)
    energy, part = (
        np.add.reduceat(np.add.reduceat(each.astype(float), rows[:-1], axis=0), cols[:-1], axis=1)
        for each in (across * across + down * down, away)
    )
    return np.where(energy > 0.0, part / np.maximum(energy, 1.0), ANY_WAY)


# --- sweep of a target by a robot in the water ---
#
# The robot drifts by some pixels while its lens moves, and the picture grows. Both are seen on the target: its centre
# says where the frames lie on each other, its radius by how much they grow. That is true to a pixel or two, which
# blocks bear and their parts would not: blocks are not split here.

BLOCK_PX = 25  # half of what a whole view gets: the part that a sweep reads is half as wide
MIN_BLOCKS = 4  # across and down; less is no map


def sweep_depth(frames: Sequence[SweepFrame], calibration: Calibration, tilt_rad: float) -> SweepDepth | None:
    """The map of one sweep of a camera that looks up by tilt_rad, as `aucamp depth-map` makes it; None where too few
    frames show the target, or too little around it.

    Frames without a ball are left out: nothing says where they belong. A box around something else trembles too much.
    """
    seen = [frame for frame in frames if frame.sighting.radius_px and frame.sighting.focus is not None]
    if len({frame.sighting.focus for frame in seen}) < MIN_POSITIONS:
        return None
    half_x, half_y = (min(_reach(frame, axis) for frame in seen) for axis in (0, 1))
    if min(half_x, half_y) < MIN_BLOCKS * BLOCK_PX / 2:
        return None
    images = []
    for frame in seen:
        x, y = _centre(frame)
        images.append(frame.image[y - half_y : y + half_y + 1, x - half_x : x + half_x + 1])
    lens_positions = np.array([float(frame.sighting.focus or 0) for frame in seen])
    grown = growth(lens_positions, [frame.sighting.radius_px or 0.0 for frame in seen])
    taken = clarity_of(images, lens_positions, BLOCK_PX, grown)
    reference = seen[taken.reference]
    x, y = _centre(reference)
    left_px, top_px = reference.roi[0] + x - half_x, reference.roi[1] + y - half_y
    taken = taken._replace(corner_px=(left_px, top_px))
    found = measure(taken, BLOCK_PX, at_tilt(calibration.swept, tilt_rad), camera=calibration.camera)
    assert found.blocks.range_m is not None  # there is a calibration
    return SweepDepth(
        t_ns=seen[0].sighting.t_ns,
        lens_position=round(float(lens_positions[taken.reference])),
        block_px=BLOCK_PX,
        left_px=left_px,
        top_px=top_px,
        range_m=found.blocks.range_m,
        sharp=found.sharp,
    )


def growth(lens_positions: np.ndarray, radius_px: Sequence[float]) -> float:
    """How much the target's radius grew from the first to the last frame, relative: a line over the lens position."""
    slope, at_zero = np.polyfit(lens_positions, radius_px, 1)
    first = at_zero + slope * lens_positions[0]
    relative = slope * (lens_positions[-1] - lens_positions[0]) / first if first > 0 else 0.0
    return float(np.clip(relative, -MAX_GROWTH, MAX_GROWTH))


def _centre(frame: SweepFrame) -> tuple[int, int]:
    """The target's centre in the image, whole pixels."""
    assert frame.sighting.centre_px is not None
    return round(frame.sighting.centre_px[0]) - frame.roi[0], round(frame.sighting.centre_px[1]) - frame.roi[1]


def _reach(frame: SweepFrame, axis: int) -> int:
    """How far the image goes on to both sides of the target, pixels."""
    centre = _centre(frame)[axis]
    return min(centre, frame.roi[2 + axis] - 1 - centre)


# --- sweep over whole frames of a robot in the water ---
#
# The blocks are squares in the last frame. The others lie elsewhere, for the robot drifts and sways by some pixels
# while its lens moves, and the picture grows: by how much it grows the calibration knows, and where it lies is found
# by phase correlation of each frame with the one before, whose blur is nearly the same (Kuglin and Hines 1975). The
# pictures themselves are never resampled, which would change their clarity.

SMALL = 4  # frames are compared at so many times fewer pixels
MIN_RESPONSE = 0.05  # of phase correlation: below, nothing is said of how the frames lie
MOST_PX = 40.0  # between frames that follow each other; more is no drift
MIN_BLOCK_RISE = 20.0  # of a block's clarity above its median: noise of two grey levels has 96 everywhere, but no rise


class BlockSweep:
    """Where the clarity of each block peaks. Frames are added as they come; the lens positions of a plan rise."""

    def __init__(self, plan: SweepPlan, camera: CameraFit) -> None:
        self._plan, self._camera = plan, camera
        # Luminance, all that clarity looks at and a third of the frame; lens position, time.
        self._frames: list[tuple[Image, int, int]] = []
        self._shifts: list[NDArray[np.float64]] = []  # of each against the one before, px
        self._before: NDArray[np.float32] | None = None

    def add(self, image: Image, lens_position: int, t_ns: int) -> None:
        """Take one whole frame, grey or in colour."""
        grey = luminance(image)
        small = _reduced(grey)
        shift = np.zeros(2)
        if self._before is not None:
            window = cv2.createHanningWindow((small.shape[1], small.shape[0]), cv2.CV_32F)
            (x, y), response = cv2.phaseCorrelate(self._before, small, window)
            if response > MIN_RESPONSE and np.hypot(x, y) * SMALL < MOST_PX:
                shift = SMALL * np.array([x, y])
        self._before = small
        self._shifts.append(shift)
        self._frames.append((grey.copy() if grey is image else grey, lens_position, t_ns))

    def peaks(self) -> BlockPeaks:
        """What all frames so far show, counted in the blocks of the last."""
        side = self._plan.block_px
        height, width = self._frames[-1][0].shape[:2]
        rows, cols = height // side, width // side
        _, focus, t_ns = self._frames[-1]
        told = BlockPeaks(t_ns=t_ns, sweep=self._plan.sweep, focus=focus, block_px=side, cols=cols, rows=rows)
        positions = np.array([float(lens_position) for _, lens_position, _ in self._frames])
        if np.unique(positions).size < MIN_POSITIONS:
            return told
        clarity, whole = self._clarity(rows, cols)
        rise = clarity.max(axis=1) - np.median(clarity, axis=1)
        asked = np.flatnonzero((rise >= MIN_BLOCK_RISE) & whole)
        if not asked.size:
            return told
        found = block_peaks(positions, np.ascontiguousarray(clarity[asked]))
        sigma = np.hypot(found.sigma, phase_sigma(found.width, side * side))
        clear = found.accepted & (found.quality >= MIN_QUALITY) & np.isfinite(sigma)
        peaks = tuple(
            (int(k), float(position), float(s))
            for k, position, s in zip(asked[clear], found.lens_position[clear], sigma[clear], strict=True)
        )
        return BlockPeaks(**{**{name: getattr(told, name) for name in told.__struct_fields__}, "peaks": peaks})

    def _clarity(self, rows: int, cols: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Clarity per pixel (rows * cols, n), and which blocks lie whole in each frame."""
        side, n = self._plan.block_px, len(self._frames)
        height, width = self._frames[-1][0].shape[:2]
        f_last = at_lens_position(self._camera, self._frames[-1][1]).f_px
        off, size, whole = np.zeros(2), np.empty(n), np.ones((rows, cols), bool)
        clarity, half = np.empty((n, rows, cols)), np.empty((n, rows, cols))
        for k in range(n - 1, -1, -1):
            image, lens_position, _ = self._frames[k]
            scale = at_lens_position(self._camera, lens_position).f_px / f_last
            xs, ys = (
                c + shift + scale * (np.arange(count + 1) * side - 0.5 - c) + 0.5
                for c, shift, count in ((self._camera.cx_px, off[0], cols), (self._camera.cy_px, off[1], rows))
            )
            whole &= ((ys[:-1] >= -1) & (ys[1:] <= height + 1))[:, None] & (xs[:-1] >= -1) & (xs[1:] <= width + 1)
            row_edges, col_edges = (
                np.clip(np.rint(edges), 0, size).astype(np.int64) for edges, size in ((ys, height), (xs, width))
            )
            size[k], clarity[k] = scale, tenengrad_grid(image, row_edges, col_edges)
            half[k] = half_clarity(image, row_edges, col_edges)
            # The frame before lies elsewhere by this frame's own shift, and by what its growth moved of that.
            off = off - self._shifts[k]
        curves = clarity * size[:, None, None] ** growth_power(clarity, half)
        return curves.reshape(n, -1).T, whole.ravel()


def _reduced(grey: Image) -> NDArray[np.float32]:
    height, width = grey.shape
    small = cv2.resize(grey, (width // SMALL, height // SMALL), interpolation=cv2.INTER_AREA)
    return small.astype(np.float32)
