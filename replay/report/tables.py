"""The tables of the report, each with its head first; cells are text."""

from __future__ import annotations

import math

from replay.report import figures_posture
from replay.report.errors import LATE, error_table, relative_percent
from replay.report.robot_timeline import RobotTimeline
from replay.report.run import Run

Row = list[str]
HEAD = ["robot", "x mm", "y mm", "z mm", "sigma mm", "first view", "iterations"]
ERRORS = ["error mm", "% of |x*|", "% of range"]  # before all else: a phone shows the first columns


def error_note(run: Run) -> str:
    if not run.truths_m:
        return "Nobody knows the truth of this run: the last estimate of each robot, as it states it."
    return (
        "Relative error: the distance to the target over the target's distance from the tank's corner, as in the "
        "paper, and over its distance from the robot. Below: priors over the whole run, posteriors over the last "
        f"{LATE} iterations; the last column is the share of errors within twice the standard deviation that the "
        "robot stated."
    )


def error_tables(run: Run) -> list[list[Row]]:
    """What each robot held at the end; and with a truth how far off its priors and posteriors were."""
    if not run.truths_m:
        return [[HEAD, *(_stated(timeline) for timeline in run.timelines)]]
    ends = [[HEAD[0], *ERRORS, *HEAD[1:]], *(_ended(run, timeline) for timeline in run.timelines)]
    ends += [_from_summary(name, row) for name, row in _silent(run).items()]
    rows = [["robot", "what", "axis", "n", "bias mm", "RMSE mm", "95 % mm", "largest mm", "within 2 sigma"]]
    for target, truth_m in run.truths_m.items():
        for e in error_table(run.about(target), truth_m):
            shown = [_number(e.bias, "+.2f"), *(f"{value:.2f}" for value in (e.rmse, e.p95, e.largest))]
            rows.append([e.robot, e.what, e.axis, str(e.n), *shown, _number(e.within_2_sigma, ".0%")])
    return [ends, rows] if len(rows) > 1 else [ends]


def _stated(timeline: RobotTimeline) -> Row:
    """The last belief of a robot."""
    if not timeline.beliefs:
        return [timeline.label]
    state = timeline.beliefs[-1].state
    place = [_mm(x) for x in state.posterior_m or [None] * 3]
    first = "never" if state.acquired_t is None else str(state.acquired_t)
    return [timeline.label, *place, _mm(state.posterior_sigma_m), first, str(state.t)]


def _ended(run: Run, timeline: RobotTimeline) -> Row:
    """The last belief of a robot, and its error where the truth is known."""
    name, *stated = _stated(timeline)
    truth_m = run.truths_m.get(timeline.target)
    if timeline.estimate is None or truth_m is None:
        return [name, *[""] * len(ERRORS), *stated]
    estimate_m, robot = timeline.estimate[0], run.fleet.robot[timeline.robot]
    eye_m = (robot.pose.x_m, robot.pose.y_m, run.fleet.tank.surface_m - robot.depth_m)
    relative = relative_percent(estimate_m, truth_m), relative_percent(estimate_m, truth_m, eye_m)
    errors = f"{1e3 * math.dist(estimate_m, truth_m):.2f}", *(f"{percent:.3f}" for percent in relative)
    return [name, *errors, *stated]


def _silent(run: Run) -> dict[str, dict[str, object]]:
    """Rows of summary.json about robots that left no recording."""
    agents: dict[str, dict[str, object]] = (run.summary or {}).get("agents", {})
    return {name: row for name, row in agents.items() if name not in {timeline.robot for timeline in run.timelines}}


def _from_summary(name: str, row: dict[str, object]) -> Row:
    estimate_m, error_mm = row.get("estimate_m"), row.get("error_mm")
    places = [_mm(x) for x in estimate_m] if isinstance(estimate_m, list) else [""] * 3
    return [name, f"{error_mm:.2f}" if isinstance(error_mm, float) else "", "", "", *places]


def events(run: Run) -> list[Row]:
    """What the robots wrote to their logs, without the sweeps: why somebody entered S or left it."""
    lines = [
        (t_s, line.robot, line.text)
        for timeline in run.robots
        for t_s, line in timeline.log
        if "sweep" not in line.text
    ]
    starts = [(t_s, timeline.robot, "starts again") for timeline in run.robots for t_s in timeline.starts_s[1:]]
    return [["robot", "s", "event"], *([robot, f"{t_s:.1f}", text] for t_s, robot, text in sorted([*lines, *starts]))]


def hover(run: Run) -> list[Row]:
    rows = [["robot", "depth error, rms mm", "tilt, rms deg"]]
    for timeline in run.robots:
        if timeline.boxes:  # the set-point is not on the network
            found = figures_posture.hover(timeline)
            shown = [f"{value:.2f}" for value in found.values()] if found else ["never at depth", ""]
            rows.append([timeline.robot, *shown])
    return rows


def link_note(run: Run) -> str:
    note = "Rows speak, columns hear: messages taken in of those given out. "
    if not run.boxes:
        return note + "Heard is what each robot counts, said is what the recorder saw; bytes are in black boxes alone."
    unknown = sum(link.unknown - link.after_end for link in run.links)
    if unknown:
        return note + f"{unknown} messages were heard that nobody said."
    return note + "All that was heard was said, byte for byte."


def matrix(run: Run) -> list[Row]:
    """A dash: not neighbours, or one of them left no recording."""
    cells = {(link.src, link.dst): f"{link.heard} / {'?' if link.said is None else link.said}" for link in run.links}
    names = list(run.fleet.robot)
    return [["says", *names], *([src, *(cells.get((src, dst), "-") for dst in names)] for src in names)]


def _mm(x_m: float | None) -> str:
    return "" if x_m is None else f"{1e3 * x_m:.2f}"


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)
