"""A figure for each view: what is seen, what the blocks say, what is true, and the difference."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from agent.core.ranging.focus import Array
from agent.experiments.depth.run import Result
from agent.experiments.figure_files import Figures
from agent.perception.depth_sweep import DepthMap
from agent.tools.depth_map import draw_cells


def figures(result: Result) -> Figures:
    """One for each sensor and view."""
    for one in result.shown:
        yield f"depth_{one.sensor}_{one.number}.png", figure(one.depth_map, one.truth_m)


def figure(measured: DepthMap, truth_m: Array) -> Figure:
    """Distances in metres on one scale, errors in millimetres; hatched: no distance."""
    range_m = measured.range_on_parts()
    assert range_m is not None  # it was measured with a calibration
    height, width = measured.sharp.shape[:2]
    drawn = Figure(figsize=(12.0, 0.8 + 10.0 * height / width), layout="constrained")
    (view, found), (true, wrong) = drawn.subplots(2, 2)
    view.imshow(measured.sharp[..., ::-1])
    view.set_title("each part from its sharpest frame")
    limits = float(truth_m.min()), float(truth_m.max())
    side = measured.block_px / measured.along
    draw_cells(found, range_m, side, "z-depth in metres", limits)
    found.set_title(f"from focus, {np.isfinite(range_m).mean():.0%} of the view; hatched: no distance")
    draw_cells(true, truth_m, side, "z-depth in metres", limits)
    true.set_title("truth of the twin")
    error_mm = 1e3 * (range_m - truth_m)
    draw_cells(wrong, error_mm, side, "error in mm", (-30.0, 30.0), "RdBu")
    miss_mm = np.abs(error_mm[np.isfinite(error_mm)])
    wrong.set_title(
        f"error: mean {miss_mm.mean():.1f} mm, median {np.median(miss_mm):.1f} mm" if miss_mm.size else "error"
    )
    for axes in (view, found, true, wrong):
        axes.set(xlim=(0, width), ylim=(height, 0), xlabel="x in px", ylabel="y in px")
    return drawn
