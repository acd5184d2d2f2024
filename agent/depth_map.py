"""`aucamp depth-map SOURCE`: sweep the focus once, give every block of the picture the distance of its clarity peak.

Blocks without a single clear peak (no texture, a depth edge, sharpest outside the sweep) get no distance. The grid of
blocks grows with the picture (focus breathing), so that a block keeps its piece of the scene; the picture itself is
never resampled, which would change its clarity.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray
from rich.console import Console

from agent.config import ConfigError
from agent.depth_box import MIN_RISE, BoxRange, as_json, box_clarity, box_range
from agent.launch import Failed, with_bar
from agent.perception.breathing import GROWTH_POWER, measure_growth
from agent.perception.clarity import grid, luminance, tenengrad_grid
from agent.perception.follow import check_box, parse_box
from agent.perception.likeness import Box
from agent.perception.peaks import block_peaks
from agent.ranging.calibration import Calibration, load_calibration
from agent.ranging.focus import MIN_POSITIONS, Array, Method, Refused, h, phase_sigma
from agent.ranging.sag import at_tilt
from hw.camera import Camera, CameraError, Image, nearest, open_camera
from hw.camera_files import StackCamera

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SWEEP_STEPS = 30  # lens positions of a camera; of a stack every photograph is used
HOME_SETTLE_S = 0.12  # after the long way back to the starting side; small steps ring less
SETTLE_S = 0.05
MIN_BLOCK_PX = 8  # smaller ones hold more noise than texture
MIN_QUALITY = 0.96  # of a block's peak: over many blocks a wrong one costs more than a missing one
MAX_GROWTH = 0.2  # of the picture in one sweep: beyond it it is not breathing

OnStep = Callable[[int, int], None]  # lens positions done, in all


class Sweep(NamedTuple):
    focus: Array  # (n,) lens positions, as the driver reports them; of a stack in the unit of its positions.csv
    clarity: Array  # (n, rows, cols)
    sharp: Image  # (height, width, 3), each block from the frame in which it is sharpest
    growth: float  # of the picture from the first position to the last, relative
    reference: int  # the position whose picture is largest; blocks are squares there, and smaller in the others
    boxed: Array | None = None  # (n,) clarity in the middle of the box, drawn in the largest picture


class DepthMap(NamedTuple):
    """Arrays are (rows, cols), row 0 on top; position and sigma in lens positions."""

    block_px: int
    position: Array
    sigma: Array
    quality: Array
    accepted: NDArray[np.bool_]
    range_m: Array | None  # z-depth from the gimbal pivot; NaN where there is none. None without a calibration
    sharp: Image
    growth: float
    thing: BoxRange | Refused | None = None  # what is in the box, if there is one


def depth_map(
    source: str,
    out: Path,
    block: int,
    twin_dir: Path,
    calibration: Calibration | None,
    progress: OnStep,
    growth: float | None = None,
    box: Box | None = None,
) -> DepthMap:
    """Sweep `source` (a camera address, or a directory of photographs), write the PNG `out` and a CSV beside it.

    block: edge in pixels. growth: see `sweep`. box: around one thing, whose range goes into a JSON file beside them.
    Raises CameraError and ConfigError, each one line.
    """
    if out.suffix.lower() != ".png" or not out.parent.is_dir():
        raise ConfigError(f"{out}: give a name that ends in .png, in a directory that exists")
    camera = open_camera(_address(source), twin_dir, None)
    try:
        taken = sweep(camera, block, progress, growth, box)
    finally:
        camera.close()
    result = measure(taken, block, calibration)
    if box is not None and taken.boxed is not None:
        result = result._replace(thing=box_range(taken.focus, taken.boxed, box, calibration))
    try:
        write_csv(result, out.with_suffix(".csv"))
        draw(result, out, box)
        if box is not None and isinstance(result.thing, BoxRange):
            out.with_suffix(".json").write_text(as_json(box, result.thing), encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}; choose another place") from None
    return result


def run(
    source: str,
    out: Path,
    block: int,
    calibration: Path | None,
    growth: float | None = None,
    tilt_deg: float = 0.0,
    box: str | None = None,
) -> str:
    """What `aucamp depth-map` does and says. A camera of the twin is named by its socket: twin:/path/r1.camera.

    tilt_deg: how far the camera looks up. Raises Failed where the thing in the box has no single clear peak; the map
    is written all the same.
    """
    drawn = None if box is None else parse_box(box)
    known = None if calibration is None else load_calibration(calibration)
    if known is not None:
        known = replace(known, focus=at_tilt(known.focus, math.radians(tilt_deg)))
    result = with_bar(
        Console(stderr=True),
        "focus sweep",
        lambda progress: depth_map(source, out, block, Path(), known, progress, growth, drawn),
    )
    found, blocks = np.count_nonzero(result.accepted), result.accepted.size
    said = (
        f"{found} of {blocks} blocks have a clear peak, the picture grew by {result.growth:.1%}: "
        f"{out}, {out.with_suffix('.csv')}"
    )
    if isinstance(result.thing, Refused):
        raise Failed(f"box {box}: {result.thing.reason}; the map is in {out}")
    return said if result.thing is None else f"{said}, {out.with_suffix('.json')}\nin the box: {result.thing}"


def sweep(camera: Camera, block: int, progress: OnStep, growth: float | None = None, box: Box | None = None) -> Sweep:
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
    positions = _positions(camera)
    camera.set_focus(positions[0])
    camera.read(settle_s=HOME_SETTLE_S)
    focus, images = [], []
    for done, position in enumerate(positions, start=1):
        focus.append(float(camera.set_focus(position)))
        images.append(camera.read(settle_s=SETTLE_S).image)
        progress(done, len(positions))
    scale = np.array(camera.positions) if isinstance(camera, StackCamera) else np.array(focus)
    if growth is None:
        growth = measure_growth([luminance(image) for image in images]) or 0.0  # unknown: as good as any
    return clarity_of(images, scale, block, growth, box)


def clarity_of(images: list[Image], focus: Array, block: int, growth: float, box: Box | None = None) -> Sweep:
    """The frames of a sweep -> clarity on a grid that grows as they do; growth is linear in the lens position.

    A picture that grows spreads its gradients over more pixels: energy a pixel falls as size^-2 for texture coarser
    than a pixel, not at all for texture that is alike at every scale. Left alone this tilts every curve, and the wide
    ones' peaks most. With GROWTH_POWER the peaks of the twin's wall lie within 0.8 lens positions of the truth from
    0.29 to 1.35 m; without it they are up to 4.7 off, the nearer the more.
    """
    height, width = images[0].shape[:2]
    size = 1.0 + growth * (focus - focus[0]) / (focus[-1] - focus[0])
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
    boxed = None if box is None else box_clarity(images, size / size[reference], box)
    return Sweep(focus, clarity, sharp, growth, reference, boxed)


def _address(source: str) -> str:
    """Of the camera that is meant; a folder of photographs is one."""
    if Path(source).is_dir():
        return f"stack:{source}"
    if ":" not in source:
        what = "a file" if Path(source).exists() else "no such folder"
        raise ConfigError(f"{source}: {what}; give a folder of photographs, or a camera such as v4l2:/dev/video0")
    return source


def _positions(camera: Camera) -> list[int]:
    focus = camera.focus_range()
    if focus is None:
        raise CameraError("the focus of this source cannot be set; a depth map needs a camera or a stack: that can")
    if isinstance(camera, StackCamera):
        positions = list(range(focus.lowest, focus.highest + 1))
    else:
        wanted = np.linspace(focus.lowest, focus.highest, SWEEP_STEPS)
        positions = sorted({nearest(round(position), focus) for position in wanted})
    if len(positions) < MIN_POSITIONS:
        raise CameraError(f"{len(positions)} focus positions; a depth map needs at least {MIN_POSITIONS}")
    return positions


def measure(
    taken: Sweep,
    block: int,
    calibration: Calibration | None,
    method: Method = "matched",
    min_quality: float = MIN_QUALITY,
) -> DepthMap:
    """Peak of every block's curve, and its range where a calibration tells it; every method keeps the same blocks."""
    count, rows, cols = taken.clarity.shape
    peaks = block_peaks(taken.focus, taken.clarity.reshape(count, rows * cols).T, method)
    shape, sigma = (rows, cols), np.hypot(peaks.sigma, phase_sigma(peaks.width, block * block))
    textured = taken.clarity.max(axis=0) - np.median(taken.clarity, axis=0) >= MIN_RISE
    position = peaks.position.reshape(shape)
    accepted = (peaks.accepted & (peaks.quality >= min_quality)).reshape(shape) & textured
    range_m = None
    if calibration is not None:
        range_m = np.full(shape, np.nan)
        for cell in np.argwhere(accepted):
            z_m = h(calibration.focus, float(position[tuple(cell)]))
            if z_m is not None:  # else sharp at infinity
                range_m[tuple(cell)] = z_m
    return DepthMap(
        block_px=block,
        position=position,
        sigma=sigma.reshape(shape),
        quality=peaks.quality.reshape(shape),
        accepted=accepted,
        range_m=range_m,
        sharp=taken.sharp,
        growth=taken.growth,
    )


def write_csv(result: DepthMap, path: Path) -> None:
    """One line a block; x_px and y_px are its centre. What has no value is left empty."""
    columns = ["row", "col", "x_px", "y_px", "focus", "sigma", "quality", "accepted"]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns + (["range_m"] if result.range_m is not None else []))
        for row, col in np.ndindex(result.position.shape):
            cell = (row, col)
            centre = [(k + 0.5) * result.block_px - 0.5 for k in (col, row)]
            line: list[object] = [row, col, *centre, f"{result.position[cell]:.6g}", f"{result.sigma[cell]:.3g}"]
            line += [f"{result.quality[cell]:.4f}", int(result.accepted[cell])]
            if result.range_m is not None:
                line.append("" if np.isnan(result.range_m[cell]) else f"{result.range_m[cell]:.5g}")
            writer.writerow(line)


def draw(result: DepthMap, path: Path, box: Box | None = None) -> None:
    """The picture, everywhere sharp, and beside it the map with its colour bar; hatched: no distance."""
    from matplotlib.figure import Figure  # a second and 30 MB that an agent, which draws nothing, does without
    from matplotlib.patches import Rectangle

    height, width = result.sharp.shape[:2]
    figure = Figure(figsize=(12.0, 0.6 + 5.4 * height / width), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.imshow(result.sharp[..., ::-1])
    left.set_title("each block from its sharpest frame")
    if box is not None:
        left.add_patch(Rectangle((box.x, box.y), box.width, box.height, fill=False, color="C3"))
    if result.range_m is not None:
        values, label = result.range_m, "z-depth in metres"
    else:
        values, label = np.where(result.accepted, result.position, np.nan), "focus position of the clarity peak"
    shown = np.isfinite(values)
    right.set_title(f"{np.count_nonzero(shown)} of {shown.size} blocks of {result.block_px} px; hatched: no distance")
    draw_cells(right, values, result.block_px, label)
    for axes in (left, right):
        axes.set(xlim=(0, width), ylim=(height, 0), xlabel="x in px", ylabel="y in px")
    figure.savefig(path, dpi=100)


def draw_cells(
    axes: Axes,
    values: Array,
    block: int,
    label: str,
    limits: tuple[float, float] | None = None,
    colours: str = "viridis",
) -> None:
    """One colour a block, NaN hatched, with a scale; limits of the colours, by default from the values."""
    axes.patch.set(facecolor="0.88", edgecolor="0.65", hatch="///")  # seen through cells without a value
    axes.set_aspect("equal")
    shown = values[np.isfinite(values)]
    if shown.size == 0:
        return
    # A few wrong peaks shall not take the colours of all others.
    low, high = np.percentile(shown, (1, 99)) if limits is None else limits
    rows, cols = values.shape
    cells = axes.imshow(
        np.ma.masked_invalid(values), extent=(0, cols * block, rows * block, 0), vmin=low, vmax=high, cmap=colours
    )
    bar = axes.inset_axes((1.03, 0.0, 0.04, 1.0))  # as high as the map, whatever its shape
    axes.figure.colorbar(cells, cax=bar, label=label, extend="both")
