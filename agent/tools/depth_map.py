"""`aucamp depth-map SOURCE`: sweep the focus once, give each block the distance of its clarity peak; as a picture, a
table and in words.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError, write_whole, writing
from agent.core.ranging.camera_model import CameraFit, FocusFit, at_lens_position, load_focus
from agent.core.ranging.focus import ANY_WAY, FARTHEST_M, Array, NoPeak, at_tilt, h
from agent.perception.clarity import INNER_BOX
from agent.perception.depth_peaks import (
    AWAY,
    STEP_SHARE,
    TEXTS,
    BoxRange,
    GridPeaks,
    any_part,
    as_json,
    box_range,
    cuts,
    each_part,
    middle_px,
)
from agent.perception.depth_sweep import DepthMap, OnStep, measure, outward, sweep
from agent.perception.tracking.appearance import Box
from agent.perception.tracking.follow import parse_box
from agent.process.command import Failed, new_file, plain_console, with_bar
from hw.camera import open_camera
from hw.camera.camera import Image

# --- as a picture ---
# A depth map as a picture, drawn by OpenCV: the library for figures takes longer to draw than the map to measure.

PANEL_PX = 640  # a panel's longer side, at most
LEFT_PX, TOP_PX, GAP_PX, BOTTOM_PX, BAR_PX, RIGHT_PX = 50, 34, 30, 30, 16, 110  # around the panels, and the scale
INK, LIGHT, GREY, RED = (40, 40, 40), (225, 225, 225), (165, 165, 165), (40, 40, 200)
HATCH_PX = 9  # from line to line of what has no distance
TICKS = 6  # along an axis, about
SHOWN = (1, 99)  # percent of the values between the ends of the scale: a few wrong ones shall not take all colours


def draw(result: DepthMap, path: Path, box: Box | None = None) -> None:
    """The picture, everywhere sharp, and beside it the map with its scale; hatched: no distance. Raises OSError."""
    height, width = result.sharp.shape[:2]
    scale = min(1.0, PANEL_PX / max(height, width))
    size = round(width * scale), round(height * scale)
    values, label = result.range_on_parts(), "z-depth in metres"
    if values is None or not np.isfinite(values).any():
        values, label = result.lens_position_on_parts(), "lens position of the clarity peak"
    right = LEFT_PX + size[0] + GAP_PX + LEFT_PX
    page = np.full((TOP_PX + size[1] + BOTTOM_PX, right + size[0] + RIGHT_PX, 3), 255, np.uint8)
    view = cv2.resize(result.sharp, size, interpolation=cv2.INTER_AREA)
    if box is not None:
        corners = [
            (round(scale * x), round(scale * y)) for x, y in ((box.x, box.y), (box.x + box.width, box.y + box.height))
        ]
        cv2.rectangle(view, corners[0], corners[1], RED, 2)
    limits = scale_of(values)
    drawn = coloured(values, scale * result.block_px / result.along, (size[1], size[0]), limits)
    for left, panel in ((LEFT_PX, view), (right, drawn)):
        page[TOP_PX : TOP_PX + size[1], left : left + size[0]] = panel
        for value, at in ticks(0.0, width, scale):
            text(page, f"{value:g}", (left + at, TOP_PX + size[1] + 18), "middle")
        for value, at in ticks(0.0, height, scale):
            text(page, f"{value:g}", (left - 6, TOP_PX + at + 4), "end")
    blocks = result.blocks.accepted
    split = f", {np.count_nonzero(result.used_parts())} parts of others" if result.used_parts().any() else ""
    text(page, "each part from its sharpest frame; pixels", (LEFT_PX, 22))
    text(page, f"{label}: {np.count_nonzero(blocks)} of {blocks.size} blocks{split}; hatched: none", (right, 22))
    if limits is not None:
        draw_scale(page[TOP_PX : TOP_PX + size[1], right + size[0] + 14 :], limits)
    done, encoded = cv2.imencode(".png", page)
    assert done  # of 8 bits it always is
    write_whole(path, encoded.tobytes())


def scale_of(values: Array) -> tuple[float, float] | None:
    """Values at the ends of the scale; None where there are none."""
    shown = values[np.isfinite(values)]
    if shown.size == 0:
        return None
    low, high = np.percentile(shown, SHOWN)
    return float(low), float(high if high > low else low + max(abs(low), 1.0) * 1e-3)


def coloured(values: Array, square_px: float, size: tuple[int, int], limits: tuple[float, float] | None) -> Image:
    """One colour a square of `square_px`, hatched where NaN or where there is no square; size: (height, width)."""
    rows, cols = (((np.arange(length) + 0.5) / square_px).astype(int) for length in size)
    wide = np.full((max(rows[-1] + 1, values.shape[0]), max(cols[-1] + 1, values.shape[1])), np.nan)
    wide[: values.shape[0], : values.shape[1]] = values
    low, high = limits or (0.0, 1.0)
    level = np.clip((np.nan_to_num(wide, nan=low) - low) / (high - low), 0.0, 1.0)
    picture: Image = colour_map((255.0 * level).round().astype(np.uint8))[rows][:, cols]
    blank = np.isnan(wide)[rows][:, cols]
    picture[blank] = LIGHT
    picture[blank & (np.add.outer(np.arange(size[0]), np.arange(size[1])) % HATCH_PX == 0)] = GREY
    return picture


def colour_map(levels: NDArray[np.uint8]) -> Image:
    """0 to 255 (rows, cols) -> blue green red (rows, cols, 3)."""
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS), np.uint8)


def draw_scale(place: Image, limits: tuple[float, float]) -> None:
    """The colours from the highest value down, with some of the values beside them."""
    height, (low, high) = len(place), limits
    levels = np.linspace(255, 0, height).round().astype(np.uint8)
    place[:, :BAR_PX] = colour_map(np.repeat(levels[:, None], BAR_PX, axis=1))
    for value, at in ticks(low, high, height / (high - low)):
        text(place, f"{value:g}", (BAR_PX + 6, height - 1 - at + 4))


def ticks(low: float, high: float, px_per_unit: float) -> Iterator[tuple[float, int]]:
    """Round values from low to high, and how many pixels from low each lies."""
    about = (high - low) / TICKS
    power = 10.0 ** math.floor(math.log10(about))
    step = next(power * k for k in (1, 2, 5, 10) if power * k >= about)
    for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1):
        yield round(k * step, 12), round((k * step - low) * px_per_unit)


def text(page: Image, words: str, at: tuple[int, int], anchor: str = "start") -> None:
    """Small dark letters, their left end, middle or right end at (x, y)."""
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.42
    (width, _), _ = cv2.getTextSize(words, font, size, 1)
    x = at[0] - {"start": 0, "middle": width // 2, "end": width}[anchor]
    cv2.putText(page, words, (x, at[1]), font, size, INK, 1, cv2.LINE_AA)


# --- in words ---
# What a calibration makes of the peaks of a map, in words: how many have a range, why the others have none.
#
# Nothing in a sweep says which camera took it. But peaks that the calibration cannot give a range to, that lie where
# it was not measured, or that are far wider or narrower than those it was made of, are rarely those of its camera.

UNEVEN_STEPS = 2.0  # longest to usual: then a wide peak leans to where positions are close, by more than its sigma
LEAST_SHARE = 0.05  # of the clear peaks: fewer ranges are chance, or what a speck of dirt in the view has
NEAR_POLE = 0.25  # of the peak's half width: warmth and sag shift the focus at infinity by less
STRANGE_WIDTH = 5.0  # times that of the calibration, or a part: texture and range change a peak's width twofold


def ranges_in_words(result: DepthMap, focus: FocusFit, calibration: Path, out: Path) -> list[str]:
    """No line where every clear peak has a range that was calibrated. Raises Failed where (nearly) none has one."""
    positions, ranges, widths = _accepted(result)
    count, given = positions.size, int(np.isfinite(ranges).sum())
    low, high = sorted((focus.lowest, focus.highest))
    covered = f"lens positions {low} to {high} ({_metres(focus, focus.highest)} to {_metres(focus, focus.lowest)})"
    where = f"the peaks lie at lens positions {positions.min():.4g} to {positions.max():.4g}, it was made at {covered}"
    if given < LEAST_SHARE * count:
        at_infinity = abs(float(np.median(positions)) - focus.rho0) <= NEAR_POLE * focus.width
        or_far = f", or all of the view is farther than {FARTHEST_M:g} m" if at_infinity else ""
        raise Failed(
            f"{calibration}: gives a range to {given or 'none'} of the {count} clear peaks, so it is a calibration of "
            f"another camera{or_far}: {where}. Give this camera's own; {out} is in lens positions"
        )
    told = []
    if given < count:
        beyond = int(np.sum(~np.isfinite(ranges) & ((positions - focus.rho0) * focus.b_m <= 0.0)))
        told.append(f"{count - given} of them have no range: {_why(beyond, count - given)}")
    outside = int(np.sum(np.isfinite(ranges) & ((positions < low) | (positions > high))))
    if outside:
        told.append(f"{outside} ranges are extrapolated: they are not at {covered}, where the calibration was made")
    ratio = float(np.median(widths)) / focus.width
    if not 1.0 / STRANGE_WIDTH <= ratio <= STRANGE_WIDTH:
        told.append(
            f"doubtful: peaks are {ratio:.2g} times as wide as those of {calibration}, which may be a calibration of "
            f"another camera; {where}"
        )
    return told


def _accepted(result: DepthMap) -> tuple[Array, Array, Array]:
    """Lens position, range and width of every clear peak, of blocks and of the parts of split ones."""
    grids = [(result.blocks, result.blocks.accepted)]
    if result.parts is not None:
        grids.append((result.parts, result.used_parts()))
    found = []
    for grid, used in grids:
        assert grid.range_m is not None  # it was measured with a calibration
        found.append((grid.lens_position[used], grid.range_m[used], grid.width[used]))
    positions, ranges, widths = (np.concatenate(field) for field in zip(*found, strict=True))
    return positions, ranges, widths


def _why(beyond: int, missing: int) -> str:
    """Beyond the pole of h is beyond infinity; the others are too far to tell, or nearer than any lens can focus."""
    reasons = []
    if beyond:
        reasons.append(f"{beyond} are sharp where the lens is set to infinity or beyond")
    if beyond < missing:
        reasons.append(f"{missing - beyond} would be farther than {FARTHEST_M:g} m, or nearer than the lens itself")
    return ", ".join(reasons)


def _metres(focus: FocusFit, lens_position: float) -> str:
    range_m = h(focus, lens_position)
    return "no range" if range_m is None else f"{range_m:.2f} m"


# --- what the map shows in a box ---
# One peak of all that is in a box may lie between two depths, where nothing is. The map's squares there tell.

FEW = 0.1  # of the squares in a box on either side of a gap: fewer may be wrong


class Squares(NamedTuple):
    """Those of the map in the middle of a box, the smallest that there are; each field (n,), lens positions."""

    at: Array
    sigma: Array
    width: Array


def squares_in(result: DepthMap, box: Box) -> Squares:
    """box: of the first picture."""
    peaks, side_px = result.blocks if result.parts is None else result.parts, result.block_px / result.along
    inner, rows = box.grown(INNER_BOX), list[tuple[float, float, float]]()
    for row, col in np.argwhere(peaks.accepted).tolist():
        x, y = middle_px(row, col, side_px, result.corner_px)
        if inner.x <= x < inner.x + inner.width and inner.y <= y < inner.y + inner.height:
            rows.append((peaks.lens_position[row, col], peaks.sigma[row, col], peaks.width[row, col]))
    return Squares(*np.array(sorted(rows)).reshape(-1, 3).T)


def two_depths(squares: Squares, step: float) -> NoPeak | None:
    """A gap with squares on both sides, of lens positions a `step` apart; a slope has some all along."""
    at, sigma, width = squares
    apart, least = np.maximum(AWAY * width, STEP_SHARE * step) + sigma, max(2, math.ceil(FEW * len(at)))
    for k in range(least, len(at) - least + 1):
        if at[k] - at[k - 1] > max(apart[k - 1], apart[k]):
            both = f"{np.median(at[:k]):.4g} and at {np.median(at[k:]):.4g}"
            return NoPeak(f"it holds two depths, sharp at {both}; draw it around one of them")
    return None


def spread(squares: Squares) -> float:
    """How far the squares scatter, beyond what they err by: a slope, or depths that are close, lens positions."""
    if len(squares.at) < 2:
        return 0.0
    return math.sqrt(max(float(np.var(squares.at) - np.mean(squares.sigma**2)), 0.0))


# --- as a table and a figure ---
# A depth map as a table; and its squares in a figure of matplotlib.

Line = list[object]


def write_csv(result: DepthMap, path: Path) -> None:
    """One line a block, and one for each part of a block that is split; x_px and y_px are its centre, size_px its side.

    What has no value is left empty. The squares of the lines that are accepted do not overlap, and are the whole map.
    """
    columns = ["row", "col", "x_px", "y_px", "focus", "sigma", "quality", "accepted"]
    columns += ([] if result.blocks.range_m is None else ["range_m"]) + ["size_px", "reason"]
    along = result.along
    split = any_part(result.used_parts(), along)
    corner = result.corner_px
    blocks = _lines(result.blocks, result.block_px, np.ones(split.shape, bool), corner)
    side = result.block_px / along
    parts = {} if result.parts is None else _lines(result.parts, side, each_part(split, along), corner)
    with writing(path), path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for (row, col), line in blocks.items():
            writer.writerow([row, col, *line])
            if split[row, col]:
                places = np.ndindex(along, along)
                writer.writerows([row, col, *parts[row * along + r, col * along + c]] for r, c in places)


def _lines(
    grid: GridPeaks, size_px: float, wanted: NDArray[np.bool_], corner_px: tuple[float, float]
) -> dict[tuple[int, int], Line]:
    """The columns from x_px on, by row and column of the square."""
    numbers = [(grid.lens_position, ".6g"), (grid.sigma, ".3g"), (grid.quality, ".4f")]
    columns = [_written(values[wanted], shape) for values, shape in numbers]
    columns.append(grid.accepted[wanted].astype(int).tolist())
    if grid.range_m is not None:
        columns.append(_written(grid.range_m[wanted], ".5g"))
    places, reasons = np.argwhere(wanted).tolist(), grid.reason[wanted].tolist()
    size = f"{size_px:g}"

    def middle(row: int, col: int) -> Line:
        return [f"{at + (k + 0.5) * size_px - 0.5:g}" for at, k in ((corner_px[0], col), (corner_px[1], row))]

    return {
        (row, col): [*middle(row, col), *values, size, TEXTS[reason]]
        for (row, col), reason, *values in zip(places, reasons, *columns, strict=True)
    }


def _written(values: Array, shape: str) -> Line:
    return ["" if value != value else format(value, shape) for value in values.tolist()]  # NaN is not itself


# --- `aucamp depth-map` ---


def depth_map(
    source: str,
    out: Path,
    block: int,
    twin_dir: Path,
    focus: FocusFit | None,
    progress: OnStep,
    growth: float | None = None,
    box: Box | None = None,
    lens: CameraFit | None = None,
) -> DepthMap:
    """Sweep `source` (a camera address, or a directory of photographs), write the PNG `out` and a CSV beside it.

    block: edge in pixels. growth: see `sweep`. box: around one thing, whose range goes into a JSON file beside them.
    lens: the camera as it was calibrated, so that ranges off its axis are right as well.
    Raises CameraError and ConfigError, each one line, and OSError where nothing can be written.
    """
    if out.suffix.lower() != ".png" or not out.parent.is_dir():
        raise ConfigError(f"{out}: give --out a name that ends in .png, in a folder that exists")
    for file in _files(out, box is not None):
        new_file(file)
    address, size = _address(source), None if lens is None else (lens.width_px, lens.height_px)
    camera = open_camera(address, twin_dir, None if address.startswith("stack:") else size)
    try:
        if size is not None and camera.size != size:
            given, calibrated = ("{}x{}".format(*each) for each in (camera.size, size))
            raise ConfigError(
                f"{source}: has pictures of {given} pixels, and the camera was calibrated at {calibrated}; "
                "give pictures as it takes them, or leave --calibration out"
            )
        taken = sweep(camera, block, progress, growth, box)
    finally:
        camera.close()
    result = measure(taken, block, focus, camera=lens)
    if box is not None and taken.box_clarity is not None:
        way = ANY_WAY
        if lens is not None:
            lens = at_lens_position(lens, float(taken.lens_positions[taken.reference]))
            left, top, width, height = box.grown(INNER_BOX).moved(-taken.corner_px[0], -taken.corner_px[1])
            rows, cols = (np.rint([first, first + size]).astype(int) for first, size in ((top, height), (left, width)))
            way = float(outward(taken, lens, rows, cols)[0, 0])
        x, squares = taken.lens_positions, squares_in(result, box)
        found = box_range(x, taken.box_clarity, box, focus, lens, way, spread(squares))
        between = two_depths(squares, float(np.ptp(x)) / (len(x) - 1)) if isinstance(found, BoxRange) else None
        result = result._replace(box_range=between or found)
    write_csv(result, out.with_suffix(".csv"))
    draw(result, out, box)
    if box is not None and isinstance(result.box_range, BoxRange):
        write_whole(out.with_suffix(".json"), as_json(box, result.box_range))
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

    tilt_deg: how far the camera looks up. Raises Failed where no block has a clear peak, where the calibration is not
    of this camera, or the thing in the box has no single clear peak; the map is written all the same.
    """
    drawn = None if box is None else parse_box(box)
    focus, lens = (None, None) if calibration is None else load_focus(calibration)
    focus = None if focus is None else at_tilt(focus, math.radians(tilt_deg))
    result = with_bar(
        plain_console(stderr=True),
        "focus sweep",
        lambda progress: depth_map(source, out, block, Path(), focus, progress, growth, drawn, lens),
    )
    blocks, parts = result.blocks.accepted, result.used_parts()
    if not blocks.any() and not parts.any():
        raise Failed(
            f"{source}: no block has a clear peak: nothing in the view has texture, or it is sharp nowhere in the "
            f"sweep; the map, which is empty, is in {out}"
        )
    files = ", ".join(map(str, _files(out, box is not None)))
    split = any_part(parts, result.along)
    also = f", {np.count_nonzero(split)} more in parts" if split.any() else ""
    said = [
        f"{np.count_nonzero(blocks)} of {blocks.size} blocks have a clear peak{also}, "
        f"the picture grew by {result.growth:.1%}: {files}"
    ]
    if cuts(block) == 1:
        said.append(f"blocks of {block} px are too small to be asked whether they hold two depths; take 20 px or more")
    if result.moved_px:
        said.append(f"the picture moved by {result.moved_px:.0f} px during the sweep, which was undone: fix the camera")
    if result.light > 1.0:
        said.append(
            f"brightness changed {result.light:.2f} times in the sweep, which was undone; set exposure and gain by hand"
        )
    if result.uneven > UNEVEN_STEPS:
        said.append(
            f"doubtful: steps between lens positions differ {result.uneven:.1f} times; peaks lean to the closer ones"
        )
    if focus is not None and lens is None:
        said.append(f"{calibration} has no [camera]: ranges off the axis are too short, by 6 % at 20 degrees in air")
    if focus is not None and calibration is not None:
        said += ranges_in_words(result, focus, calibration, out)
    if isinstance(result.box_range, NoPeak):
        raise Failed(f"box {box}: {result.box_range.reason}; the map is in {out}")
    return "\n".join(said if result.box_range is None else [*said, f"in the box: {result.box_range}"])


def _files(out: Path, box: bool) -> list[Path]:
    """What is written: the map, its numbers, and those of the box."""
    return [out, out.with_suffix(".csv"), *([out.with_suffix(".json")] if box else [])]


def _address(source: str) -> str:
    """The address of the camera that is meant; a folder of photographs is one."""
    if Path(source).is_dir():
        return f"stack:{source}"
    if ":" not in source:
        what = "a file" if Path(source).exists() else "no such folder"
        raise ConfigError(f"{source}: {what}; give a folder of photographs, or a camera such as v4l2:/dev/video0")
    return source
