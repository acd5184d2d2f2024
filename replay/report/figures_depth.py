"""A sweep as a picture that is sharp everywhere, and beside it how far each block is."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from replay.viewers.whole_sweeps import SweepDepth


def depth_map(robot: str, t_s: float, depth: SweepDepth) -> Figure:
    """Both in pixels of the full frame; hatched: no clear peak, so no range. The scale leaves out 1 % at both ends."""
    rows, cols = depth.range_m.shape
    left, top = depth.left_px, depth.top_px
    across, down = left + cols * depth.block_px, top + rows * depth.block_px
    figure = Figure(figsize=(4.6, 1.4 + 4.0 * rows / (2 * cols)), layout="constrained")
    picture, map_ = figure.subplots(1, 2, sharex=True, sharey=True)
    height, width = depth.sharp.shape[:2]
    picture.imshow(depth.sharp[..., ::-1], extent=(left, left + width, top + height, top))
    map_.patch.set(facecolor="0.88", edgecolor="0.65", hatch="///")
    known = depth.range_m[np.isfinite(depth.range_m)]
    if known.size:
        low, high = np.percentile(known, (1, 99))
        blocks = np.ma.masked_invalid(depth.range_m)
        cells = map_.imshow(blocks, extent=(left, across, down, top), vmin=low, vmax=high, cmap="viridis")
        figure.colorbar(cells, ax=[picture, map_], location="bottom", label="z-depth, m", extend="both", aspect=40)
    figure.suptitle(f"{robot}, {t_s:.0f} s: {known.size} of {depth.range_m.size} blocks", fontsize="medium")
    picture.set(xlim=(left, across), ylim=(down, top), ylabel="v, px", xlabel="u, px")
    map_.set_xlabel("u, px")
    return figure
