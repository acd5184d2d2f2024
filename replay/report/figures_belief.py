"""What each robot believed: prior and posterior per axis, the valid set as it saw it, and how far they disagreed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from agent.core.messages import State, Vector
from replay.report.robot_timeline import Belief, RobotTimeline

AXES = "xyz"
VARIANCES = (0, 3, 5)  # of x, y, z among xx xy xz yy yz zz
KNOWS = {"blind": "0.85", "told": "C1", "sees": "C2"}


def iterations(timeline: RobotTimeline, truth_m: Vector | None) -> Figure:
    """x̂ as dots and x as a line with ± 2σ, one panel for each axis; the upper scale is time."""
    figure = Figure(figsize=(4.6, 6.4), layout="constrained")
    panels = figure.subplots(3, 1, sharex=True)
    held = [belief for belief in timeline.beliefs if belief.state.posterior_m is not None]
    for axis, (name, panel) in enumerate(zip(AXES, panels, strict=True)):
        if truth_m is not None:
            panel.axhline(1e3 * truth_m[axis], color="black", linewidth=0.8, linestyle="--", label="truth")
        panel.plot(
            [t for t, _ in timeline.priors], [1e3 * x[axis] for _, x in timeline.priors], ".", color="C1", label="x̂"
        )
        t, x, sigma = _series(held, axis)
        panel.plot(t, x, color="C0", label="x")
        panel.fill_between(t, x - 2 * sigma, x + 2 * sigma, color="C0", alpha=0.2, linewidth=0, label=r"$\pm 2\sigma$")
        for first in sorted({b.state.acquired_t for b in timeline.beliefs if b.state.acquired_t is not None}):
            panel.axvline(first, color="C2", linewidth=0.8)
        panel.set_ylabel(f"{name}, mm")
        panel.margins(x=0.02)
    panels[0].legend(fontsize="small", ncols=4, loc="best")
    panels[2].set_xlabel("iteration")
    if len(timeline.beliefs) > 1:
        ticks = timeline.beliefs[:: max(1, len(timeline.beliefs) // 5)]
        above = panels[0].secondary_xaxis("top")
        above.set_xticks([belief.t for belief in ticks], [f"{belief.t_s:.0f}" for belief in ticks])
        above.set_xlabel(f"{timeline.label}: time, s")
    return figure


def _series(held: Sequence[Belief], axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Iteration, posterior and its standard deviation in mm along one axis; NaN where it is not recorded."""
    x = [1e3 * belief.state.posterior_m[axis] for belief in held if belief.state.posterior_m]
    variances = [belief.cov_m2[VARIANCES[axis]] if belief.cov_m2 else math.nan for belief in held]
    return np.array([belief.t for belief in held]), np.array(x), 1e3 * np.sqrt(np.array(variances, float))


def valid_set(timeline: RobotTimeline) -> Figure:
    """The observer's own view of S: what it knows itself, and which neighbours counted in its updates."""
    names = sorted({n.robot for _, state in timeline.states for n in state.neighbours})
    figure = Figure(figsize=(4.6, 0.9 + 0.36 * (1 + len(names))), layout="constrained")
    panel = figure.subplots()
    times = [*[t_s for t_s, _ in timeline.states], timeline.ends_s]
    states = [state for _, state in timeline.states]
    rows = [[KNOWS[state.knows] for state in states], *([_seen(state, name) for state in states] for name in names)]
    for row, colours in enumerate(rows):
        for colour, begin, end in _bars(colours, times):
            panel.barh(row, end - begin, left=begin, height=0.7, color=colour, linewidth=0)
    panel.set_yticks(range(1 + len(names)), ["itself", *names])
    panel.invert_yaxis()
    panel.set(xlabel="time, s", title=f"S as {timeline.robot} sees it" + timeline.label.removeprefix(timeline.robot))
    # One key for both kinds of rows: green is in S, orange has an estimate without a view.
    keys = {"in S, counted": "C2", "in S, not counted": "C9", "told": "C1", "not in S": "0.85", "unheard": "white"}
    handles = [Patch(facecolor=colour, edgecolor="0.6", label=label) for label, colour in keys.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize="x-small", frameon=False)
    figure.set_figheight(figure.get_figheight() + 0.45)
    return figure


def _bars(colours: Sequence[str], times: Sequence[float]) -> Iterator[tuple[str, float, float]]:
    """Neighbours of one colour joined: (colour, begin, end); colours[k] holds from times[k] to times[k + 1]."""
    k = 0
    for colour, same in itertools.groupby(colours):
        n = len(list(same))
        yield colour, times[k], times[k + n]
        k += n


def _seen(state: State, name: str) -> str:
    """How a neighbour stands in an observer's eyes."""
    neighbour = next((n for n in state.neighbours if n.robot == name), None)
    if neighbour is None or neighbour.age_s is None:
        return "white"
    if neighbour.used:
        return "C2"
    return "C9" if neighbour.valid else "0.85"


def disagreement(timelines: Sequence[RobotTimeline], truth_m: Vector | None) -> Figure:
    """The largest distance between two posteriors at a time, of the timelines about one target; with a truth also that
    of each robot from it."""
    figure = Figure(figsize=(4.6, 3.5), layout="constrained")
    panel = figure.subplots()
    if truth_m is not None:
        for k, timeline in enumerate(timelines):
            errors = [
                (b.t_s, 1e3 * math.dist(b.state.posterior_m, truth_m)) for b in timeline.beliefs if b.state.posterior_m
            ]
            panel.plot(
                [t for t, _ in errors], [e for _, e in errors], color=f"C{k}", linewidth=0.9, label=timeline.robot
            )
        limit_mm = 1e3 * 0.004 * math.hypot(*truth_m)
        panel.axhline(limit_mm, color="0.5", linestyle=":", linewidth=1.0, label="0.4 % of |x*|")
    times, apart = _apart(timelines)
    panel.plot(times, apart, color="black", linewidth=1.2, label="disagreement")
    about = timelines[0].label.removeprefix(timelines[0].robot)  # the target, where there are several
    panel.set(xlabel="time, s", ylabel="mm", title=f"posteriors{about}: error and largest distance", yscale="log")
    figure.legend(loc="outside lower center", ncols=5, fontsize="x-small", frameon=False)
    return figure


def _apart(timelines: Sequence[RobotTimeline]) -> tuple[list[float], list[float]]:
    """The largest distance of two newest posteriors at each iteration of any robot: times in s, and mm."""
    newest: dict[str, Vector] = {}
    times, apart = [], []
    for belief in sorted((b for timeline in timelines for b in timeline.beliefs), key=lambda b: b.t_s):
        if belief.state.posterior_m is not None:
            newest[belief.state.robot] = belief.state.posterior_m
        if len(newest) > 1:
            times.append(belief.t_s)
            largest = max(math.dist(a, b) for a, b in itertools.combinations(newest.values(), 2))
            apart.append(1e3 * largest or math.nan)  # a logarithmic scale has no zero: a gap
    return times, apart
