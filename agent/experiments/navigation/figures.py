"""Paths over the basin and errors over time: every seed a line."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.experiments.figure_files import Figures
from agent.experiments.navigation.basin import TANK
from agent.experiments.navigation.run import Result
from agent.experiments.result import Row

SWUM = ("hold", "goto", "turn", "orbit", "orbit with gaps")


def figures(result: Result) -> Figures:
    """Paths, fixes and one crossing, of what was run; each as SVG and PNG."""
    draws = result.shown.draws
    drawn = {}
    if swum := [name for name in SWUM if name in draws]:
        drawn["navigation_paths"] = paths(draws, swum)
    if fixed := [row for row in draws.get("fix", ()) if "nees" in row]:
        drawn["navigation_fixes"] = fixes_figure(fixed)
    if "separation" in draws:
        drawn["navigation_crossing"] = crossing_figure(min(draws["separation"], key=lambda row: row["least_m"]))
    for name, figure in drawn.items():
        for suffix in ("svg", "png"):
            yield f"{name}.{suffix}", figure


def paths(draws: dict[str, list[Row]], names: Sequence[str]) -> Figure:
    """True places from above, and true yaw from where each began, over time."""
    drawn = Figure(figsize=(3.4 * len(names), 6.0), dpi=120, layout="constrained")
    panels = drawn.subplots(2, len(names), squeeze=False)
    for column, name in enumerate(names):
        above, below = panels[:, column]
        above.set_title(name)
        for row in draws[name]:
            t, x, y, psi = row["path"].T
            above.plot(x, y, linewidth=0.7)
            below.plot(t, np.degrees(np.unwrap(psi)) - np.degrees(psi[0]), linewidth=0.7)
        basin(above)
        below.set(xlabel="s", ylabel="yaw, deg from the first" if column == 0 else "")
    drawn.suptitle("where robots truly swam (twin)")
    return drawn


def fixes_figure(rows: Sequence[Row]) -> Figure:
    """Error against blur and against distance."""
    drawn = Figure(figsize=(7.2, 3.4), dpi=120, layout="constrained")
    for panel, key, words in zip(
        drawn.subplots(1, 2, sharey=True), ("blur_px", "distance_m"), ("blur, px", "distance, m"), strict=True
    ):
        known = [row for row in rows if row[key] is not None]
        panel.scatter([row[key] for row in known], [row["error_mm"] for row in known], s=8, label="error")
        panel.scatter([row[key] for row in known], [row["sigma_mm"] for row in known], s=8, label="as it says, 1 sigma")
        panel.set(xlabel=words, yscale="log")
    drawn.axes[0].set(ylabel="place, mm")
    drawn.axes[0].legend(fontsize="small")
    drawn.suptitle("fixes from rendered frames (twin)")
    return drawn


def crossing_figure(row: Row) -> Figure:
    """The seed in which two came nearest."""
    drawn = Figure(figsize=(6.0, 4.2), dpi=120, layout="constrained")
    panel = drawn.subplots()
    for path in row["path"].transpose(1, 0, 2):
        panel.plot(path[:, 0], path[:, 1], linewidth=0.8)
        panel.plot(*path[-1], "o", markersize=4)
    basin(panel)
    panel.set_title(f"robots cross, least distance {row['least_m']:.2f} m (planar)")
    return drawn


def basin(panel: Axes) -> None:
    panel.set(xlim=(0.0, TANK.size_m[0]), ylim=(0.0, TANK.size_m[1]), aspect="equal")
