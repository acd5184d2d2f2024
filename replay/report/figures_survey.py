"""Figures of a survey: how much was known when, and of which part of the floor."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from agent.core.config import Fleet
from replay.report.surveyed import Surveyed, floor_known

NONE, SOME, KNOWN, THING = "0.88", "#fee08b", "#1a9850", "#4d4d4d"


def known_over_time(fleet: Fleet, found: Surveyed, start_ns: int) -> Figure:
    """Above the share of the wanted cells that each robot's map knows, below the keyframes that it holds."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for index, name in enumerate(fleet.robot):
        rows = found.known.get(name, [])
        t_s = [(row.t_ns - start_ns) * 1e-9 for row in rows]
        above.plot(t_s, [100.0 * row.share for row in rows], color=f"C{index}", linewidth=1.0, label=name)
        below.plot(t_s, [row.held for row in rows], color=f"C{index}", linewidth=1.0)
    if fleet.coverage is not None:
        above.axhline(100.0 * fleet.coverage.share, color="black", linewidth=0.6, linestyle=":")
    above.set(ylabel="known, %", ylim=(0.0, 100.0))
    below.set(xlabel="time, s", ylabel="keyframes held", ylim=(0.0, None))
    above.legend(fontsize="small", ncols=len(fleet.robot), loc="upper left")
    return figure


def floor_above(fleet: Fleet, found: Surveyed) -> Figure:
    """World axes: each column of cells from above, by what is known of its floor, and whether something stands there;
    the ways of robots that swim, and a cross where each sweep was taken."""
    grid, (nx, ny, _) = found.all.grid, found.all.grid.shape
    shown = np.array(floor_known(found.all)).reshape(ny, nx)
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    panel = figure.subplots()
    colours = [NONE, SOME, KNOWN, THING]
    extent = (0.0, nx * grid.cell_m, 0.0, ny * grid.cell_m)
    panel.imshow(shown, origin="lower", extent=extent, cmap=ListedColormap(colours), vmin=-0.5, vmax=3.5)
    for index, name in enumerate(fleet.robot):
        path = np.array(found.paths.get(name, [])).reshape(-1, 2)
        panel.plot(path[:, 0], path[:, 1], color=f"C{index}", linewidth=0.7)
        places = np.array([frame.place[:2] for _, frame in found.frames if frame.origin == name], float).reshape(-1, 2)
        panel.plot(1e-4 * places[:, 0], 1e-4 * places[:, 1], "x", color=f"C{index}", markersize=5, label=name)
    panel.set(xlabel="x, m", ylabel="y, m")
    words = ("nothing known", "something", "all that is asked for", "a thing above it")
    patches = [Patch(facecolor=colour, label=word) for colour, word in zip(colours, words, strict=True)]
    lines = panel.get_legend_handles_labels()[0]
    figure.legend(handles=[*patches, *lines], loc="outside lower center", ncols=4, fontsize="small", frameon=False)
    return figure
