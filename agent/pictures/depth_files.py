"""A depth map as a table; and its squares in a figure of matplotlib."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from agent.kernel.ranging.focus import Array
from agent.pictures.depth_peaks import TEXTS, GridPeaks, Reason
from agent.pictures.depth_sweep import DepthMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Row = list[object]


def write_csv(result: DepthMap, path: Path) -> None:
    """One line a block, and one for each part of a block that is split; x_px and y_px are its centre, size_px its side.

    What has no value is left empty. The squares of the lines that are accepted do not overlap, and are the whole map.
    """
    columns = ["row", "col", "x_px", "y_px", "focus", "sigma", "quality", "accepted"]
    columns += ([] if result.blocks.range_m is None else ["range_m"]) + ["size_px", "reason"]
    used = result.used_parts()
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row, col in np.ndindex(result.blocks.reason.shape):
            writer.writerow([row, col, *_square(result.blocks, row, col, result.block_px)])
            place = tuple(slice(k * result.along, (k + 1) * result.along) for k in (row, col))
            if result.parts is not None and used[place].any():
                writer.writerows(
                    [row, col, *line] for line in _parts(result.parts, place, result.block_px / result.along)
                )


def _parts(parts: GridPeaks, place: tuple[slice, ...], size_px: float) -> Iterator[Row]:
    for row in range(place[0].start, place[0].stop):
        for col in range(place[1].start, place[1].stop):
            yield _square(parts, row, col, size_px)


def _square(grid: GridPeaks, row: int, col: int, size_px: float) -> Row:
    """The columns from x_px on."""
    line: Row = [f"{(k + 0.5) * size_px - 0.5:g}" for k in (col, row)]
    for field, shape in ((grid.lens_position, ".6g"), (grid.sigma, ".3g"), (grid.quality, ".4f")):
        line.append(_number(field[row, col], shape))
    line.append(int(grid.reason[row, col] == Reason.ACCEPTED))
    if grid.range_m is not None:
        line.append(_number(grid.range_m[row, col], ".5g"))
    return [*line, f"{size_px:g}", TEXTS[grid.reason[row, col]]]


def _number(value: float, shape: str) -> str:
    return "" if np.isnan(value) else format(value, shape)


def draw_cells(
    axes: Axes,
    values: Array,
    block: float,
    label: str,
    limits: tuple[float, float] | None = None,
    colours: str = "viridis",
) -> None:
    """One colour a square of `block` pixels, NaN hatched, with a scale; limits: values at its ends, if given."""
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
