"""The surroundings of the target at a scale at which covariances can be seen."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from agent.core.config import Fleet
from agent.core.messages import Symmetric, Vector
from replay.report.robot_timeline import RobotTimeline


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
    a, b, c = cov_m2[0], cov_m2[1], cov_m2[3]  # xx, xy, yy
    mean, half = (a + c) / 2.0, math.hypot((a - c) / 2.0, b)
    large, small = (2e3 * math.sqrt(max(value, 0.0)) for value in (mean + half, mean - half))  # semi-axes, mm
    angle_deg = math.degrees(math.atan2(2.0 * b, a - c)) / 2.0
    panel.add_patch(Ellipse(centre_mm, 2.0 * large, 2.0 * small, angle=angle_deg, fill=False, color=colour))
