"""A run as one page: summary, priors and posteriors over the iterations, and the tank from above.

Everything comes from the run's own folder; figures are inline, so that the page can be mailed.
"""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import jinja2
import matplotlib
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from agent.config import ConfigError, Fleet, load_fleet
from agent.messages import Outputs, State, decode
from replay.log import read

STEP_BYTES = 1024 * 1024  # a step's outputs are our own file's, not a stranger's
AXES = "xyz"

PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>{{ fleet }}: {{ summary.verdict }}</title>
<style>
body { font-family: sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em }
table { border-collapse: collapse } td, th { padding: .3em .8em; text-align: right; border-bottom: 1px solid #ccc }
.pass { color: #060 } .fail { color: #a00 } svg { max-width: 100%; height: auto }
</style>
<h1>Fleet {{ fleet }}: <span class="{{ summary.verdict }}">{{ summary.verdict }}</span></h1>
{% for reason in summary.reasons %}<p class="fail">{{ reason }}</p>{% endfor %}
<p>Protocol {{ summary.protocol }}, seed {{ summary.seed }}, {{ summary.wall_s }} s.
The target is at {{ truth }} mm, by the twin.</p>
<table><tr>{% for name in columns %}<th>{{ name }}</th>{% endfor %}</tr>
{% for row in rows %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</table>
<p>The relative error is the distance to the target over the target's distance from the tank's corner, as in the
paper.</p>
<h2>Prior and posterior</h2>
<p>Dots: the robot's own measurement. Line: its estimate after hearing its neighbours. Dashed: the truth. The vertical
line is the robot's first view of the target.</p>
{{ iterations }}
<h2>From above</h2>
{{ above }}
</html>
"""

COLUMNS = {
    "error mm": ("error_mm", "{:.2f}"),
    "relative error %": ("relative_error_percent", "{:.3f}"),
    "sigma mm": ("sigma_m", "{:.4f}"),
    "first view": ("acquired_iteration", "{}"),
    "iterations": ("iterations", "{}"),
    "prior RMSE mm": ("prior_rmse_mm", "{:.2f}"),
}


def report(run_dir: Path) -> Path:
    """Write `report.html` into the folder of a run and return its path.

    Needs summary.json, fleet.toml and the black boxes; a robot without one is left out of the figures. Raises
    ConfigError if the folder is not that of a run.
    """
    try:
        summary = json.loads((run_dir / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise ConfigError(f"{run_dir}: no usable summary.json; give a folder that `aucamp demo` wrote") from None
    fleet = load_fleet(run_dir / "fleet.toml")
    histories = {name: states for name in fleet.robot if (states := _states(run_dir, name))}
    page = jinja2.Environment(autoescape=True).from_string(PAGE)
    out = run_dir / "report.html"
    out.write_text(
        page.render(
            fleet=fleet.fleet,
            summary=summary,
            truth=", ".join(f"{1e3 * x:.1f}" for x in summary["truth_m"]),
            columns=["robot", *COLUMNS],
            rows=[_row(name, row) for name, row in summary["agents"].items()],
            iterations=_svg(_iterations(histories, summary["truth_m"])) if histories else "no black box",
            above=_svg(_above(fleet, summary)),
        ),
        encoding="utf-8",
    )
    return out


def _states(run_dir: Path, robot: str) -> list[State]:
    """The robot's last state of each iteration, from its black box, finished or not."""
    by_t: dict[int, State] = {}
    for path in [*run_dir.glob(f"{robot}.mcap*"), *sorted(run_dir.glob(f"{robot}.[0-9]*.mcap*"))]:
        for record in read(path):
            if record.channel == "/raw/step_out":
                state = decode(record.data, Outputs, limit=STEP_BYTES).state
                if state is not None:
                    by_t[state.t] = state
    return [by_t[t] for t in sorted(by_t)]


def _row(name: str, row: dict[str, Any]) -> list[str]:
    cells = [name]
    for title, (field, form) in COLUMNS.items():
        value = row.get(field)
        if value is not None and title == "sigma mm":
            value, form = 1e3 * value, "{:.2f}"
        cells.append("" if value is None else form.format(value))
    return cells


def _iterations(histories: dict[str, list[State]], truth_m: list[float]) -> Figure:
    """Rows: axes of the world; columns: robots."""
    figure = Figure(figsize=(3.6 * len(histories), 7), layout="constrained")
    panels = figure.subplots(3, len(histories), sharex=True, sharey="row", squeeze=False)
    for column, (robot, states) in enumerate(histories.items()):
        priors = [state for state in states if state.prior_m is not None]
        posteriors = [state for state in states if state.posterior_m is not None]
        for axis, name in enumerate(AXES):
            panel = panels[axis, column]
            panel.axhline(1e3 * truth_m[axis], color="black", linewidth=0.8, linestyle="--")
            panel.plot([s.t for s in priors], [1e3 * s.prior_m[axis] for s in priors if s.prior_m], ".", color="C1")
            panel.plot(
                [s.t for s in posteriors], [1e3 * s.posterior_m[axis] for s in posteriors if s.posterior_m], color="C0"
            )
            if states[-1].acquired_t is not None:
                panel.axvline(states[-1].acquired_t, color="C2", linewidth=0.8)
            if column == 0:
                panel.set_ylabel(f"{name}, mm")
        panels[0, column].set_title(robot)
        panels[2, column].set_xlabel("iteration")
    return figure


def _above(fleet: Fleet, summary: dict[str, Any]) -> Figure:
    """The tank from above, world axes: walls, robots and where they look, estimates, truth."""
    figure = Figure(figsize=(7, 6), layout="constrained")
    panel = figure.subplots()
    length_m, width_m, _ = fleet.tank.size_m
    panel.add_patch(Rectangle((0, 0), length_m, width_m, fill=False))
    truth_m = summary["truth_m"]
    radius_m = next(iter(fleet.target.values())).radius_m
    panel.add_patch(Circle((truth_m[0], truth_m[1]), radius_m, color="C3", alpha=0.2))
    panel.plot(truth_m[0], truth_m[1], "+", color="black", markersize=12, label="truth")
    for index, (name, robot) in enumerate(fleet.robot.items()):
        pose, colour = robot.pose, f"C{index}"
        yaw = math.radians(pose.yaw_deg)
        panel.arrow(pose.x_m, pose.y_m, 0.1 * math.cos(yaw), 0.1 * math.sin(yaw), color=colour, width=0.01)
        panel.annotate(name, (pose.x_m, pose.y_m), textcoords="offset points", xytext=(6, 6))
        estimate_m = summary["agents"].get(name, {}).get("estimate_m")
        if estimate_m:
            panel.plot(estimate_m[0], estimate_m[1], "x", color=colour, label=f"{name}'s estimate")
    panel.set_aspect("equal")
    panel.set(xlabel="x, m", ylabel="y, m", xlim=(-0.05, length_m + 0.05), ylim=(-0.05, width_m + 0.05))
    panel.legend(loc="upper right", fontsize="small")
    return figure


def _svg(figure: Figure) -> Markup:
    """The figure as an element of the page."""
    text = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):  # text stays text: smaller, and it can be searched
        figure.savefig(text, format="svg", metadata={"Date": None})
    return Markup(text.getvalue()[text.getvalue().index("<svg") :])
