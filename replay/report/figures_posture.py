"""The robot's posture in the water: four pressures, the pulses of the four central thrusters, depth and tilt."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from replay.report.robot_timeline import Array, RobotTimeline

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


def hover(timeline: RobotTimeline, band_m: float = 0.010) -> dict[str, float] | None:
    """Root mean square of depth error (mm) and tilt (deg) since the depth was first within `band_m` of its goal.

    None if it never was.
    """
    p = timeline.posture
    if not timeline.set_depth_m or not len(p.t_s):
        return None
    wanted = timeline.set_depth_m[-1][1]
    near = np.flatnonzero(np.abs(p.depth_m - wanted) < band_m)
    if not len(near):
        return None
    since = slice(int(near[0]), None)
    tilt = np.hypot(p.roll_deg[since], p.pitch_deg[since])
    return {
        "depth_rms_mm": 1e3 * float(np.sqrt(np.mean((p.depth_m[since] - wanted) ** 2))),
        "tilt_rms_deg": float(np.sqrt(np.mean(tilt**2))),
    }
