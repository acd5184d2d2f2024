"""A depth map as a table; and its squares in a figure of matplotlib."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.focus import Array
from agent.perception.depth_edges import any_part
from agent.perception.depth_peaks import TEXTS, GridPeaks, each_part
from agent.perception.depth_sweep import DepthMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Line = list[object]


def write_csv(result: DepthMap, path: Path) -> None:
    """One line a block, and one for each part of a block that is split; x_px and y_px are its centre, size_px its side.

    What has no value is left empty. The squares of the lines that are accepted do not overlap, and are the whole map.
    """
    columns = ["row", "col", "x_px", "y_px", "focus", "sigma", "quality", "accepted"]
    columns += ([] if result.blocks.range_m is None else ["range_m"]) + ["size_px", "reason"]
    along = result.along
    split = any_part(result.used_parts(), along)
    blocks = _lines(result.blocks, result.block_px, np.ones(split.shape, bool))
    parts = {} if result.parts is None else _lines(result.parts, result.block_px / along, each_part(split, along))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for (row, col), line in blocks.items():
            writer.writerow([row, col, *line])
            if split[row, col]:
                places = np.ndindex(along, along)
                writer.writerows([row, col, *parts[row * along + r, col * along + c]] for r, c in places)


def _lines(grid: GridPeaks, size_px: float, wanted: NDArray[np.bool_]) -> dict[tuple[int, int], Line]:
    """The columns from x_px on, by row and column of the square."""
    numbers = [(grid.lens_position, ".6g"), (grid.sigma, ".3g"), (grid.quality, ".4f")]
    columns = [_written(values[wanted], shape) for values, shape in numbers]
    columns.append(grid.accepted[wanted].astype(int).tolist())
    if grid.range_m is not None:
        columns.append(_written(grid.range_m[wanted], ".5g"))
    places, reasons = np.argwhere(wanted).tolist(), grid.reason[wanted].tolist()
    size = f"{size_px:g}"
    return {
        (row, col): [*(f"{(k + 0.5) * size_px - 0.5:g}" for k in (col, row)), *values, size, TEXTS[reason]]
        for (row, col), reason, *values in zip(places, reasons, *columns, strict=True)
    }


def _written(values: Array, shape: str) -> Line:
    return ["" if value != value else format(value, shape) for value in values.tolist()]  # NaN is not itself


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
