"""The figures of a report: what robots believed, posture, clock, depth, focus, map, survey, and a target that swims."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Patch, Rectangle

from agent.core.config import Fleet
from agent.core.messages import State, Symmetric, Vector
from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.focus import h
from agent.core.robot_view import AXES
from agent.core.status import sigma_m
from replay.files.info import Moment
from replay.report.creature_track import EVERY_NS, CreatureTrack
from replay.report.lead import floor_known
from replay.report.page import ellipse
from replay.report.timeline import Array, LoggedSweep, RobotTimeline, Surveyed
from replay.story import apart_m
from replay.viewers.viewer_channels import SweepDepth

VARIANCES = (0, 3, 5)  # of x, y, z among xx xy xz yy yz zz
KNOWS = {"blind": "0.85", "told": "C1", "sees": "C2"}


def iterations(timeline: RobotTimeline, truth_m: Vector | None) -> Figure:
    """x̂ as dots and x as a line with ± 2σ, one panel for each axis; the upper scale is time."""
    figure = Figure(figsize=(4.6, 6.4), layout="constrained")
    panels = figure.subplots(3, 1, sharex=True)
    for axis, (name, panel) in enumerate(zip(AXES, panels, strict=True)):
        if truth_m is not None:
            panel.axhline(1e3 * truth_m[axis], color="black", linewidth=0.8, linestyle="--", label="truth")
        panel.plot(
            [t for t, _ in timeline.priors], [1e3 * x[axis] for _, x in timeline.priors], ".", color="C1", label="x̂"
        )
        t, x, sigma = _series(timeline, axis)
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


def _series(timeline: RobotTimeline, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Iteration, posterior and its standard deviation in mm along one axis; NaN where it is not recorded."""
    x = [1e3 * x_m[axis] for _, x_m in timeline.held]
    variances = [belief.cov_m2[VARIANCES[axis]] if belief.cov_m2 else math.nan for belief, _ in timeline.held]
    return np.array([belief.t for belief, _ in timeline.held]), np.array(x), 1e3 * np.sqrt(np.array(variances, float))


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
            times_s = [belief.t_s for belief, _ in timeline.held]
            errors = [1e3 * math.dist(x_m, truth_m) for _, x_m in timeline.held]
            panel.plot(times_s, errors, color=f"C{k}", linewidth=0.9, label=timeline.robot)
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
        if (largest_m := apart_m(newest.values())) is not None:
            times.append(belief.t_s)
            apart.append(1e3 * largest_m or math.nan)  # a logarithmic scale has no zero: a gap
    return times, apart


# --- posture ---
# The robot's posture in the water: four pressures, the pulses of the four central thrusters, depth and tilt.

NEUTRAL_US = 1500  # a pulse at which a thruster stands still
CENTRAL = 4  # the first four of eight thrusters point up and down
POINTS = 600  # of a line; more cannot be told apart on a screen


def posture(timeline: RobotTimeline) -> Figure:
    """Panels over time, all by the robot's own sensors; without a black box depth and tilt alone."""
    p = timeline.posture
    every = thin(p.t_s)
    inside = bool(np.isfinite(p.sensors_m).any())
    figure = Figure(figsize=(4.6, 7.4 if inside else 4.0), layout="constrained")
    *upper, depth, tilt = panels = list(figure.subplots(4 if inside else 2, 1, sharex=True))
    if upper:
        pressures, pulses = upper
        for k in range(4):
            pressures.plot(p.t_s[every], 1e3 * p.sensors_m[every, k], linewidth=0.8, label=f"ζ{k + 1}")
        for k in range(CENTRAL):
            pulses.plot(p.t_s[every], p.pulses_us[every, k] - NEUTRAL_US, linewidth=0.8, label=f"T{k + 1}")
        pressures.set_ylabel("pressure, mm of water")
        pressures.invert_yaxis()
        pulses.set_ylabel("Δ PWM, µs")
    depth.plot(p.t_s[every], 1e3 * p.depth_m[every], color="black", linewidth=0.9, label="depth")
    steps = [*timeline.set_depth_m, (timeline.ends_s, timeline.set_depth_m[-1][1])] if timeline.set_depth_m else []
    depth.step([t for t, _ in steps], [1e3 * d for _, d in steps], where="post", color="C3", label="set-point")
    tilt.plot(p.t_s[every], p.roll_deg[every], linewidth=0.9, label="roll")
    tilt.plot(p.t_s[every], p.pitch_deg[every], linewidth=0.9, label="pitch")
    depth.set_ylabel("depth, mm")
    tilt.set(ylabel="tilt, deg", xlabel="time, s")
    depth.invert_yaxis()
    panels[0].set_title(timeline.robot)
    for panel in panels:
        panel.legend(fontsize="x-small", ncols=4, loc="best")
    return figure


def thin(t_s: Array) -> slice:
    """Every so many frames, that a line has at most POINTS."""
    return slice(None, None, max(1, -(-len(t_s) // POINTS)))


def hover(timeline: RobotTimeline) -> dict[str, float] | None:
    """Root mean square of depth error (mm) and tilt (deg) since the depth was first within 10 mm of its goal.

    None if it never was.
    """
    p = timeline.posture
    if not timeline.set_depth_m or not len(p.t_s):
        return None
    wanted = timeline.set_depth_m[-1][1]
    near = np.flatnonzero(np.abs(p.depth_m - wanted) < 0.010)
    if not len(near):
        return None
    since = slice(int(near[0]), None)
    tilt = np.hypot(p.roll_deg[since], p.pitch_deg[since])
    return {
        "depth_rms_mm": 1e3 * float(np.sqrt(np.mean((p.depth_m[since] - wanted) ** 2))),
        "tilt_rms_deg": float(np.sqrt(np.mean(tilt**2))),
    }


# --- clock ---
# How fast the dive's clock went, over the run.


def rate(moments: Sequence[Moment], start_ns: int) -> Figure:
    """Run time per time on the wall, as it was noted; times are the clock's, from start_ns on."""
    figure = Figure(figsize=(4.6, 2.4), layout="constrained")
    axes = figure.subplots()
    t_s = np.array([each.now_ns - start_ns for each in moments]) * 1e-9
    every = thin(t_s)
    axes.plot(t_s[every], [each.noted.rate for each in moments[every]], color="black", linewidth=0.9)
    axes.axhline(1.0, color="gray", linestyle="--", linewidth=0.8)
    axes.set(xlabel="time, s", ylabel="times real time")
    axes.set_ylim(bottom=0.0)
    return figure


# --- depth ---
# A sweep as a picture that is sharp everywhere, and beside it how far each block is.


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


# --- focus ---
# The lens: clarity curves with their peaks, and the calibrated hyperbola with the peaks of this run on it.

SHOWN = 6  # sweeps in one figure; more hide each other
WIDTH_IN, HEIGHT_IN = 4.6, 3.3  # read on a phone: 10 pt stays 10 pt at the width of its screen


def clarity_curves(timeline: RobotTimeline) -> Figure:
    """Clarity T over the lens position of some sweeps spread over the run, their model and their peak ± sigma."""
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    panel = figure.subplots()
    for k, sweep in enumerate(spread(timeline.sweeps)):
        order = np.argsort(sweep.lens_positions)
        lens_positions, clarity = np.array(sweep.lens_positions)[order], np.array(sweep.clarity)[order]
        ended = "" if sweep.peak is not None else ", no peak" if sweep.outcome is not None else ", not finished"
        label = f"{sweep.t_s:.0f} s{ended}"
        panel.plot(lens_positions, clarity, ".-", color=f"C{k}", linewidth=0.8, markersize=4, label=label)
        if sweep.outcome is not None and sweep.peak is not None:
            sigma = sweep.outcome.sigma or 0.0
            panel.axvline(sweep.peak, color=f"C{k}", linewidth=0.8)
            panel.axvspan(sweep.peak - sigma, sweep.peak + sigma, color=f"C{k}", alpha=0.25, linewidth=0)
    peaks = sum(sweep.peak is not None for sweep in timeline.sweeps)
    panel.set_title(f"{timeline.label}: {len(timeline.sweeps)} sweeps, {peaks} with a peak")
    panel.set(xlabel="lens position", ylabel="clarity T (Tenengrad), grey levels²")
    if timeline.sweeps:
        panel.legend(fontsize="small", title="begun at", title_fontsize="small", loc="best")
    return figure


def calibration_fit(timeline: RobotTimeline) -> Figure:
    """h(rho), the ranges that this run's peaks gave, and below how well h is known. Raises ConfigError for a
    camera of fixed focus."""
    fit = timeline.boxes[-1].calibration.swept
    figure = Figure(figsize=(WIDTH_IN, 1.35 * HEIGHT_IN), layout="constrained")
    panel, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    rho = np.linspace(fit.lowest, fit.highest, 200)
    panel.plot(rho, [h(fit, float(r)) or np.nan for r in rho], color="black", linewidth=1.0, label="h, calibrated")
    peaks = [sweep.peak for sweep in timeline.sweeps if sweep.peak is not None]
    seen = [(peak, u) for peak in peaks if (u := h(fit, peak)) is not None]
    panel.plot([p for p, _ in seen], [u for _, u in seen], ".", color="red", markersize=4, label="peaks of this run")
    errors = f"RMSE {1e3 * fit.rmse_m:.1f} mm, held out {1e3 * fit.held_out_rmse_m:.1f} mm"
    panel.set_title(f"{timeline.label}: R² {fit.r2:.5f}, {errors}", fontsize="medium")
    panel.set_ylabel("z-depth u from the gimbal, m")
    panel.legend(fontsize="small", loc="best")  # said, or matplotlib warns where the machine is busy
    below.plot(rho, 2e3 * deviation_m(fit, rho), color="black", linewidth=1.0)
    below.set(xlabel=r"lens position $\rho^*$", ylabel=r"$2\sigma$ of h, mm", ylim=(0.0, None))
    return figure


def deviation_m(fit: FocusFit, rho: Array) -> Array:
    """Standard deviation of h(rho) by the covariance of its three parameters, (n,)."""
    travel = rho - fit.rho0
    J = np.stack([np.ones_like(rho), 1.0 / travel, fit.b_m / travel**2])  # (3, n): d/du_inf, d/db, d/drho0
    c00, c01, c02, c11, c12, c22 = fit.covariance
    C = np.array([[c00, c01, c02], [c01, c11, c12], [c02, c12, c22]])
    deviation: Array = np.sqrt(np.maximum((J * (C[:, :, None] * J[None, :, :]).sum(axis=1)).sum(axis=0), 0.0))
    return deviation


def spread(sweeps: tuple[LoggedSweep, ...]) -> list[LoggedSweep]:
    """The longest sweep, and others evenly over the run."""
    if len(sweeps) <= SHOWN:
        return list(sweeps)
    longest = max(range(len(sweeps)), key=lambda k: (len(sweeps[k].lens_positions), -k))
    chosen = {longest, *np.linspace(0, len(sweeps) - 1, SHOWN - 1).round().astype(int).tolist()}
    return [sweeps[k] for k in sorted(chosen)]


# --- map ---
# The surroundings of the target at a scale at which covariances can be seen.


def near_target(fleet: Fleet, timelines: Sequence[RobotTimeline], truth_m: Vector | None) -> Figure:
    """Priors as dots and last posteriors with their 2σ ellipse, of the timelines about one target, in mm from the truth
    or from the posteriors' mean.
    """
    figure = Figure(figsize=(4.6, 4.2), layout="constrained")
    panel = figure.subplots()
    names = list(fleet.robot)
    last = {timeline.robot: timeline.estimate for timeline in timelines}
    held = [estimate[0] for estimate in last.values() if estimate is not None]
    if not held:
        panel.set_title("nobody has an estimate")
        return figure
    origin_m = truth_m or tuple(float(x) for x in np.mean(held, axis=0))
    for timeline in timelines:
        colour = f"C{names.index(timeline.robot)}" if timeline.robot in names else "0.5"
        priors = [(1e3 * (x[0] - origin_m[0]), 1e3 * (x[1] - origin_m[1])) for _, x in timeline.priors]
        panel.plot([x for x, _ in priors], [y for _, y in priors], ".", color=colour, alpha=0.35, markersize=4)
        estimate = last[timeline.robot]
        if estimate is not None:
            x, y = (1e3 * (estimate[0][k] - origin_m[k]) for k in (0, 1))
            panel.plot(x, y, "x", color=colour, label=timeline.robot)
            if estimate[1] is not None:
                add_ellipse(panel, (x, y), estimate[1], colour)
    if truth_m is not None:
        panel.plot(0, 0, "+", color="black", markersize=14, label="truth")
    panel.set_aspect("equal", adjustable="datalim")
    about = "" if len(fleet.target) == 1 else f"{timelines[0].target}: "
    title = about + r"x̂ as dots, x with its $2\sigma$ ellipse"
    where = "the truth" if truth_m is not None else "the mean of the estimates"
    panel.set(xlabel=f"x from {where}, mm", ylabel="y, mm", title=title)
    figure.legend(loc="outside lower center", ncols=5, fontsize="small", frameon=False)
    return figure


def add_ellipse(panel: Axes, centre_mm: tuple[float, float], cov_m2: Symmetric, colour: str) -> None:
    """The 2σ contour of the horizontal part of a covariance."""
    large_m, small_m, angle_deg = ellipse(cov_m2)
    panel.add_patch(Ellipse(centre_mm, 4e3 * large_m, 4e3 * small_m, angle=angle_deg, fill=False, color=colour))


# --- survey ---
# Figures of a survey: how much was known when, and of which part of the floor.

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


# --- a target that swims ---
# A target that swims: its track from above, who saw it when, how far off each robot was, and whose word that was.


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
        for mask, colour in ((~sees & ~knows, KNOWS["blind"]), (~sees & knows, KNOWS["told"]), (sees, KNOWS["sees"])):
            above.broken_barh(_spans(times_s, mask), (row - 0.4, 0.8), color=colour, linewidth=0)
    above.set_yticks(range(len(names)), names)
    above.invert_yaxis()
    shown = [("sees it", KNOWS["sees"]), ("is told", KNOWS["told"]), ("knows nothing", KNOWS["blind"])]
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
        below.plot(t_s, [3e3 * sigma_m(row.cov_m2) for row in rows], color=f"C{index}", linewidth=0.6, linestyle=":")
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


def _spans(times_s: np.ndarray, mask: np.ndarray) -> list[tuple[float, float]]:
    """(start, width) of the runs of moments in a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(float(times_s[a]), float((b - a) * EVERY_NS * 1e-9)) for a, b in edges.reshape(-1, 2)]
