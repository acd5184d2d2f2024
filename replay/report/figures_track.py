"""A target that swims: its track from above, who saw it when, how far off each robot was, and whose word that was."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from agent.core.config import Fleet
from replay.report.creature_track import EVERY_NS, CreatureTrack, Held

SEES, TRACK_KNOWS, BLIND = "C2", "C1", "0.85"


def track_above(fleet: Fleet, track: CreatureTrack) -> Figure:
    """World axes: walls, the true way in black, and where each robot believed it to be."""
    figure = Figure(figsize=(6.4, 4.8), layout="constrained")
    panel = figure.subplots()
    length_m, width_m, _ = fleet.tank.size_m
    panel.add_patch(Rectangle((0, 0), length_m, width_m, fill=False))
    for index, name in enumerate(fleet.robot):
        rows = track.held.get(name, [])
        if rows:
            x, y = ([row.x_m[k] for row in rows] for k in (0, 1))
            panel.plot(x, y, ".", color=f"C{index}", markersize=2.5, alpha=0.6, label=f"{name} believes")
    since = np.searchsorted(track.truth.t_ns, track.begins_ns)
    true = track.truth.x_m[since : np.searchsorted(track.truth.t_ns, track.ends_ns) + 1]
    panel.plot(true[:, 0], true[:, 1], color="black", linewidth=0.9, label="truth")
    if len(true):
        panel.plot(*true[0, :2], "o", color="black", markersize=5, fillstyle="none", label="first frame")
    panel.set_aspect("equal")
    panel.set(xlabel="x, m", ylabel="y, m", xlim=(-0.05, length_m + 0.05), ylim=(-0.05, width_m + 0.05))
    figure.legend(loc="outside lower center", ncols=5, fontsize="small", frameon=False)
    return figure


def seen_when(fleet: Fleet, track: CreatureTrack, start_ns: int) -> Figure:
    """Above a row for each robot: sees it, knows of it from others, knows nothing. Below how far off each was, and
    three of the standard deviations that it stated."""
    names = list(fleet.robot)
    figure = Figure(figsize=(6.4, 3.4 + 0.3 * len(names)), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1 + len(names), 6))
    moments = track.moments(track.begins_ns)
    times_s = (moments - start_ns) * 1e-9
    for row, name in enumerate(names):
        sees = track.sees(name, moments) if name in track.looks else np.zeros(len(moments), bool)
        first_ns = track.held[name][0].t_ns if track.held.get(name) else None
        knows = moments >= first_ns if first_ns is not None else np.zeros(len(moments), bool)
        for mask, colour in ((~sees & ~knows, BLIND), (~sees & knows, TRACK_KNOWS), (sees, SEES)):
            above.broken_barh(_spans(times_s, mask), (row - 0.4, 0.8), color=colour, linewidth=0)
    above.set_yticks(range(len(names)), names)
    above.invert_yaxis()
    shown = [("sees it", SEES), ("is told", TRACK_KNOWS), ("knows nothing", BLIND)]
    above.legend(
        handles=[Patch(color=colour, label=text) for text, colour in shown],
        ncols=3,
        fontsize="small",
        frameon=False,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
    )
    for index, name in enumerate(names):
        rows = track.held.get(name, [])
        if not rows:
            continue
        t_s = [(row.t_ns - start_ns) * 1e-9 for row in rows]
        off = np.linalg.norm(np.array([row.x_m for row in rows]) - track.truth.at([row.t_ns for row in rows]), axis=1)
        below.plot(t_s, 1e3 * off, color=f"C{index}", linewidth=0.8, label=name)
        below.plot(t_s, [3e3 * _sigma_m(row) for row in rows], color=f"C{index}", linewidth=0.6, linestyle=":")
    below.set_yscale("log")
    below.set(xlabel="time, s", ylabel="off the truth, mm")
    if below.get_legend_handles_labels()[0]:
        below.legend(fontsize="small", ncols=len(names), loc="best")
    return figure


def made_of(fleet: Fleet, track: CreatureTrack, start_ns: int) -> Figure:
    """For each robot, whose word its belief was made of: shares of each robot's sightings, over time."""
    names = [name for name in fleet.robot if track.held.get(name)]
    figure = Figure(figsize=(6.4, 0.8 + 1.0 * max(len(names), 1)), layout="constrained")
    panels = np.atleast_1d(figure.subplots(max(len(names), 1), 1, sharex=True))
    for panel, name in zip(panels, names, strict=False):
        rows = track.held[name]
        t_s = [(row.t_ns - start_ns) * 1e-9 for row in rows]
        shares = np.array([[row.shares.get(other, 0.0) for row in rows] for other in fleet.robot])
        panel.stackplot(t_s, shares, colors=[f"C{k}" for k in range(len(fleet.robot))], labels=list(fleet.robot))
        panel.set(ylim=(0, 1), ylabel=name, yticks=(0, 1))
    panels[-1].set_xlabel("time, s")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels) or 1, fontsize="small", frameon=False)
    return figure


def _sigma_m(row: Held) -> float:
    return math.sqrt(row.cov_m2[0] + row.cov_m2[3] + row.cov_m2[5])


def _spans(times_s: np.ndarray, mask: np.ndarray) -> list[tuple[float, float]]:
    """(start, width) of the runs of moments in a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(float(times_s[a]), float((b - a) * EVERY_NS * 1e-9)) for a, b in edges.reshape(-1, 2)]
