"""The paper's figure of a push or a step: what the host saw above, what was true below, one column for each law."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agent.experiments.figure_files import Figures
from agent.experiments.orientation.manoeuvre import PUSH, PUSH_S, STEP, Manoeuvre, Response
from agent.experiments.orientation.run import Result
from agent.experiments.orientation.settling import DEPTH_M, LIMIT_S, TILT_DEG

BEFORE_S = 1.0
NEUTRAL_US = 1500


def figures(result: Result) -> Figures:
    """One of the push and one of the step, each as SVG and PNG: the first robot under each law."""
    pushed = {law: responses.push for law, responses in result.shown.items()}
    stepped = {law: responses.step for law, responses in result.shown.items()}
    for name, drawn in (("push", figure(pushed, PUSH)), ("step", figure(stepped, STEP))):
        for suffix in ("svg", "png"):
            yield f"orientation_{name}.{suffix}", drawn


def figure(responses: dict[str, Response], manoeuvre: Manoeuvre) -> Figure:
    """Responses by law, one and the same robot."""
    drawn = Figure(figsize=(4.2 * len(responses), 9.0), dpi=120, layout="constrained")
    panels = drawn.subplots(4, len(responses), sharex=True, sharey="row", squeeze=False)
    for column, (law, response) in enumerate(responses.items()):
        panels[0, column].set_title(law)
        panels[3, column].set_xlabel("s after the push" if manoeuvre.pushed else "s after the command")
        draw_telemetry(panels[0, column], panels[1, column], response)
        draw_truth(panels[2, column], panels[3, column], response, manoeuvre.goal_m)
        for panel in panels[:, column]:
            panel.axvspan(-PUSH_S if manoeuvre.pushed else 0.0, 0.0, color="C3", alpha=0.15, linewidth=0)
            panel.axvline(0.0, color="C3", linewidth=0.8)
    panels[0, 0].invert_yaxis()
    panels[2, 0].set(ylabel="depth error, mm (truth)")
    panels[3, 0].set(ylabel="tilt, deg (truth)", xlim=(-BEFORE_S, LIMIT_S))
    panels[0, 0].set(ylabel="pressure, cm of water")
    panels[1, 0].set(ylabel="PWM from neutral, us")
    for row in (0, 1, 3):
        panels[row, 0].legend(loc="upper right", fontsize="small", ncols=2)
    return drawn


def draw_telemetry(pressures: Axes, pulses: Axes, response: Response) -> None:
    """Four sensors and the four central thrusters, as the board reports them 50 times a second."""
    seen = [t for t in response.telemetry if t.t_ns >= -BEFORE_S * 1e9]
    t_s = np.array([t.t_ns for t in seen]) * 1e-9
    for k in range(4):
        pressures.plot(t_s, [100 * t.sensor_depth_m[k] for t in seen], linewidth=0.9, label=f"p{k + 1}")
        pulses.plot(t_s, [t.pulses_us[k] - NEUTRAL_US for t in seen], linewidth=0.9, label=f"T{k + 1}")


def draw_truth(depth: Axes, tilt: Axes, response: Response, goal_m: float) -> None:
    """Depth error, roll and pitch, with the bands in which a robot counts as recovered."""
    track = response.track.since(-BEFORE_S)
    depth.axhspan(-1e3 * DEPTH_M, 1e3 * DEPTH_M, color="C2", alpha=0.12, linewidth=0)
    depth.plot(track.t_s, 1e3 * (track.depth_m - goal_m), color="black", linewidth=1.0)
    tilt.axhspan(-TILT_DEG, TILT_DEG, color="C2", alpha=0.12, linewidth=0)
    tilt.plot(track.t_s, track.roll_deg, linewidth=1.0, label="roll")
    tilt.plot(track.t_s, track.pitch_deg, linewidth=1.0, label="pitch")
