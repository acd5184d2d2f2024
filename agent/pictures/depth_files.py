"""A depth map as a table and as a picture."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from agent.kernel.ranging.focus import Array
from agent.perception.tracking.box import Box
from agent.pictures.depth_sweep import DepthMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def write_csv(result: DepthMap, path: Path) -> None:
    """One line a block; x_px and y_px are its centre. What has no value is left empty."""
    columns = ["row", "col", "x_px", "y_px", "focus", "sigma", "quality", "accepted"]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns + (["range_m"] if result.range_m is not None else []))
        for row, col in np.ndindex(result.lens_position.shape):
            cell = (row, col)
            centre = [(k + 0.5) * result.block_px - 0.5 for k in (col, row)]
            line: list[object] = [row, col, *centre, f"{result.lens_position[cell]:.6g}", f"{result.sigma[cell]:.3g}"]
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
    if result.range_m is not None and np.isfinite(result.range_m).any():
        values, label = result.range_m, "z-depth in metres"
    else:
        values, label = np.where(result.accepted, result.lens_position, np.nan), "lens position of the clarity peak"
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
