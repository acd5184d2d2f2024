"""The tables of a report, each with its head first; cells are text."""

from __future__ import annotations

import itertools
import math
import re
from collections import defaultdict
from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from msgspec import UNSET

from agent.core.messages import State, Symmetric, Vector
from agent.core.robot_view import AXES
from agent.core.step_io import SweepOutcome
from agent.core.verdict import ORDER
from agent.robot.arbiter import priorities
from replay.report import figures
from replay.report.figures import VARIANCES
from replay.report.lead import ORDERED, OVER, SURVEYED, End, ends, survey_rows, truth_of
from replay.report.page import Row, Table, cell, percent
from replay.report.timeline import Array, RobotTimeline, Run, Surveyed

# --- errors at the end ---
# The table of errors: what priors and posteriors missed the truth by, axis by axis, and whether they knew it.

LATE = 10  # iterations at the end over which the posterior is judged


class ErrorRow(NamedTuple):
    """Errors of one robot and target along one axis, or in space ("3-D", without a sign), in mm."""

    robot: str
    what: str  # prior, or posterior
    axis: str
    n: int
    bias: float | None
    rmse: float
    p95: float  # of the absolute error
    largest: float
    within_2_sigma: float | None  # share, by what the robot stated of that axis, or of space; None: it stated nothing


def error_table(timelines: Sequence[RobotTimeline], truth_m: Vector) -> list[ErrorRow]:
    """Priors over the whole run, posteriors over the last LATE iterations."""
    rows = []
    for timeline in timelines:
        if measured := [state for _, state in timeline.measured]:
            priors = np.array([state.prior_m for state in measured]) - truth_m
            stated = [[math.nan, math.nan, math.nan, _finite_mm(state.prior_sigma_m)] for state in measured]
            rows += _rows(timeline.label, "prior", 1e3 * priors, np.array(stated))
        if late := timeline.held[-LATE:]:
            errors = np.array([x_m for _, x_m in late]) - truth_m
            stated = [[*_axes_mm(belief.cov_m2), _finite_mm(belief.state.posterior_sigma_m)] for belief, _ in late]
            rows += _rows(timeline.label, "posterior", 1e3 * errors, np.array(stated))
    return rows


def _axes_mm(cov_m2: Symmetric | None) -> list[float]:
    return [1e3 * math.sqrt(cov_m2[k]) for k in VARIANCES] if cov_m2 else [math.nan] * 3


def _finite_mm(sigma_m: float | None) -> float:
    return math.nan if sigma_m is None else 1e3 * sigma_m


def _rows(robot: str, what: str, errors: Array, sigmas: Array) -> list[ErrorRow]:
    """errors (n, 3), mm, and the standard deviations stated of the axes and of the length (n, 4), mm; NaN: of none."""
    found = [
        _row(robot, what, axis, errors[:, k], float(errors[:, k].mean()), sigmas[:, k]) for k, axis in enumerate(AXES)
    ]
    return [*found, _row(robot, what, "3-D", np.linalg.norm(errors, axis=1), None, sigmas[:, 3])]


def _row(robot: str, what: str, axis: str, e: Array, bias: float | None, sigmas: Array) -> ErrorRow:
    size, known = np.abs(e), np.isfinite(sigmas)
    share = float(np.mean(size[known] <= 2.0 * sigmas[known])) if known.any() else None
    rmse, p95 = math.sqrt(float((e * e).mean())), float(np.percentile(size, 95))
    return ErrorRow(robot, what, axis, len(e), bias, rmse, p95, float(size.max()), share)


def relative_percent(estimate_m: Vector, truth_m: Vector, from_m: Vector = (0.0, 0.0, 0.0)) -> float:
    """|x - x*| over the target's distance from a place: the tank's corner as in the paper, or a robot's camera."""
    return 100.0 * math.dist(estimate_m, truth_m) / math.dist(from_m, truth_m)


# --- other tables ---

HEAD = ["robot", "x mm", "y mm", "z mm", "sigma mm", "first view", "iterations"]
EVENTS = ["robot", "s", "event"]
VIEW = re.compile(r"(^|: )(sees|told|blind) since iteration ")  # agent.robot.step writes it
REPEATS = re.compile(r" \((\d+) times more in [\d.]+ s\)$")  # agent.core.status
NUMBER = re.compile(r"\d+(\.\d+)?")
ERRORS = ["error mm", "% of |x*|", "% of range"]  # before all else: a phone shows the first columns


def error_note(run: Run) -> str:
    swim = [name for name in run.fleet.target if truth_of(run, name) is not None]
    if not run.truths_m and swim:
        return f"How far off robots were of what swims stands in the section about its track: {', '.join(swim)}."
    if not run.truths_m:
        return "Nobody knows the truth of this run, so there is no error to show."
    boxes = [name for name in run.truths_m if run.fleet.target[name].detector == "box"]
    to_a_surface = (
        f" Of a thing in a box ({', '.join(boxes)}) each robot measures the surface that faces it, and the truth here "
        "is the thing's middle: errors up to its size are none. The verdict counts how far outside of it an estimate "
        "lies (outside_mm in summary.json)."
    )
    return (
        "A prior is one measurement by a robot's own camera; a posterior is what the robot believes after it has heard "
        "the others. The truth comes from the twin; no robot knows it." + (to_a_surface if boxes else "")
    )


def errors_at_end(run: Run) -> Table:
    """What each robot held at the end; and with a truth how far off that was."""
    if not run.truths_m:
        held = "Where each robot placed the target at the end, and the standard deviation that it states itself."
        return Table(held, [HEAD, *(_stated(end) for end in ends(run))])
    rows = [[HEAD[0], *ERRORS, *HEAD[1:]], *(_ended(run, end) for end in ends(run))]
    rows += [_from_summary(name, row) for name, row in _silent(run).items()]
    about = (
        "How far off each robot was at the end: error is the distance from the truth, |x*| the target's distance from "
        "the tank's corner (the paper's measure, which should be below 0.4 %), range its distance from the robot, and "
        "sigma the standard deviation that the robot states itself."
    )
    return Table(about, rows)


def axis_table(run: Run) -> Table | None:
    """Errors axis by axis; None without a truth."""
    rows = [["robot", "what", "axis", "n", "bias mm", "RMSE mm", "95 % mm", "largest mm", "within 2 sigma"]]
    for target, truth_m in run.truths_m.items():
        for e in error_table(run.about(target), truth_m):
            shown = [cell(e.bias, "+.2f"), *(f"{value:.2f}" for value in (e.rmse, e.p95, e.largest))]
            rows.append([e.robot, e.what, e.axis, str(e.n), *shown, cell(e.within_2_sigma, ".0%")])
    if len(rows) == 1:
        return None
    return Table(
        f"Errors of priors over the whole run, and of posteriors in the last {LATE} iterations. Posteriors should be "
        "off by less, and near all errors should lie within twice the sigma that the robot stated; of a single "
        "prior it states one sigma for all axes together, so there is none for each axis (-), nor a bias in 3-D.",
        rows,
    )


def _stated(end: End) -> Row:
    """The last belief of a robot."""
    if end.last is None:
        return [end.label]
    place = [_mm(x) for x in end.last.posterior_m or [None] * 3]
    first = "never" if end.last.acquired_t is None else str(end.last.acquired_t)
    return [end.label, *place, _mm(end.last.posterior_sigma_m), first, str(end.last.t)]


def _ended(run: Run, end: End) -> Row:
    """The last belief of a robot, and its error where the truth is known."""
    name, *stated = _stated(end)
    truth_m = run.truths_m.get(end.target)  # of one that rests: the track of one that swims has tables of its own
    if end.x_m is None or end.off_m is None or truth_m is None:
        return [name, *[""] * len(ERRORS), *stated]
    robot = run.fleet.robot[end.robot]
    eye_m = (robot.pose.x_m, robot.pose.y_m, run.fleet.tank.surface_m - robot.depth_m)
    relative = relative_percent(end.x_m, truth_m), relative_percent(end.x_m, truth_m, eye_m)
    return [name, f"{1e3 * end.off_m:.2f}", *(f"{percent:.3f}" for percent in relative), *stated]


def _silent(run: Run) -> dict[str, dict[str, object]]:
    """Rows of summary.json about robots that left no recording."""
    agents: dict[str, dict[str, object]] = (run.summary or {}).get("agents", {})
    return {name: row for name, row in agents.items() if name not in {timeline.robot for timeline in run.timelines}}


def _from_summary(name: str, row: dict[str, object]) -> Row:
    estimate_m, error_mm = row.get("estimate_m"), row.get("error_mm")
    places = [_mm(x) for x in estimate_m] if isinstance(estimate_m, list) else [""] * 3
    return [name, f"{error_mm:.2f}" if isinstance(error_mm, float) else "", "", "", *places]


def events(run: Run) -> Table:
    """Why somebody entered S or left it, by the robots' logs."""
    lines = [
        (t_s, line.robot, line.text) for timeline in run.robots for t_s, line in timeline.log if _of_view(line.text)
    ]
    starts = [(t_s, timeline.robot, "starts again") for timeline in run.robots for t_s in timeline.starts_s[1:]]
    rows = [[robot, f"{t_s:.1f}", text] for t_s, robot, text in sorted([*lines, *starts])]
    return Table("When each robot came to know of the target (told) and when it saw it itself (sees).", [EVENTS, *rows])


def orders(run: Run) -> Table | None:
    """Who ordered what, and what became of it; one that came again stands once. None where nobody did."""
    found: dict[tuple[str, str, int, str, bool], float] = {}
    whys: dict[tuple[str, str, int, str, bool], str] = {}
    for timeline in run.robots:
        for t_s, answer in timeline.answers:
            about = answer.robot, answer.console, answer.id, answer.order, answer.ok
            found.setdefault(about, t_s)
            whys.setdefault(about, answer.why)
    if not found:
        return None
    rows = [
        [robot, f"{t_s:.1f}", console, order or "cannot be read", "does it" if ok else f"refused: {whys[about]}"]
        for about, t_s in sorted(found.items(), key=lambda item: item[1])
        for robot, console, _, order, ok in (about,)
    ]
    return Table(
        "What people ordered, and what the robots answered.", [["robot", "time, s", "who", "what", "answer"], *rows]
    )


def remarks(run: Run) -> Table | None:
    """What else the robots wrote to their logs, the same text once; None where there was nothing. Sweeps are left out:
    each has its figure."""
    found: dict[tuple[str, str], _Remark] = {}
    for timeline in run.robots:
        for t_s, line in timeline.log:
            if _of_view(line.text) or "sweep" in line.text or line.text.startswith(OVER) or ORDERED in line.text:
                continue
            again = REPEATS.search(line.text)
            text = line.text[: again.start()] if again else line.text
            before = found.setdefault((line.robot, NUMBER.sub("#", text)), _Remark(text, 0, t_s, t_s))
            times = before.times + (int(again[1]) if again else 1)
            found[line.robot, NUMBER.sub("#", text)] = before._replace(times=times, last_s=t_s)
    if not found:
        return None
    rows = [[robot, str(r.times), f"{r.first_s:.1f}", f"{r.last_s:.1f}", r.text] for (robot, _), r in found.items()]
    head = ["robot", "times", "first, s", "last, s", "what"]
    return Table(
        "Faults and remarks in the robots' logs. Lines that differ in numbers alone stand here once, and how often.",
        [head, *rows],
    )


class _Remark(NamedTuple):
    text: str
    times: int
    first_s: float
    last_s: float


def _of_view(text: str) -> bool:
    """Whether a line of the log is about who knows and sees the target, alone or of several: "stone: sees since"."""
    return VIEW.search(text) is not None


# --- trust ---
# Whether robots trusted what they believed of each target, and why not.

SAYS_TRUST = 3  # the schema from which on a State has a verdict
FIGURE = re.compile(r"\b\d+(\.\d+)?")  # not that of a robot's name


def trust(run: Run) -> Table | None:
    """Of each robot and target the share of the dive with each word; None where no robot could say one."""
    rows: list[Row] = [["robot", *ORDER]]
    for timeline in run.timelines:
        words = [state.verdict for _, state in _judged(timeline)]
        if words:
            rows.append([timeline.label, *(percent(words.count(word) / len(words)) for word in ORDER)])
    if len(rows) == 1:
        return None
    about = "Share of the time in which each robot knew of the target, by what it said of its own belief"
    return Table(f"{about}; docs/doubt.md has what the words mean.", rows)


def causes(run: Run) -> Table | None:
    """Why robots did not trust what they believed: each cause once, however often it came; None where all did."""
    found: dict[tuple[str, str], _Remark] = {}
    for timeline in run.timelines:
        held: set[str] = set()
        for t_s, state in _judged(timeline):
            kinds = {FIGURE.sub("#", text): text for text in state.causes}
            for kind, text in kinds.items():
                before = found.get((timeline.label, kind), _Remark(text, 0, t_s, t_s))
                found[timeline.label, kind] = _Remark(text, before.times + (kind not in held), before.first_s, t_s)
            held = set(kinds)
    if not found:
        return None
    rows = [[robot, f"{r.first_s:.1f}", f"{r.last_s:.1f}", str(r.times), r.text] for (robot, _), r in found.items()]
    head = ["robot", "began, s", "last, s", "times", "cause"]
    return Table(
        "Why not, as the robots say it: when each cause began first and stood last, and how many times it began. "
        "Causes that differ in figures alone stand here once, with the newest.",
        [head, *sorted(rows, key=lambda row: float(row[1]))],
    )


def _judged(timeline: RobotTimeline) -> list[tuple[float, State]]:
    """The states that say of a belief whether it can be trusted."""
    return [
        (t_s, state)
        for t_s, state in timeline.states
        if state.schema >= SAYS_TRUST and (state.posterior_m is not None or state.causes)
    ]


def hover(run: Run) -> Table:
    rows = [["robot", "depth error, rms mm", "tilt, rms deg"]]
    for timeline in run.robots:
        if timeline.boxes:  # the set-point is not on the network
            found = figures.hover(timeline)
            shown = [f"{value:.2f}" for value in found.values()] if found else ["never at depth", ""]
            rows.append([timeline.robot, *shown])
    return Table("How still each robot hung: a few millimetres and a fraction of a degree are good.", rows)


def survey_table(found: Surveyed) -> Table:
    """A row for each robot, at the end."""
    return Table(SURVEYED, survey_rows(found))


def link_note(run: Run) -> str:
    note = "Rows speak, columns hear: messages taken in of those given out. "
    if not run.boxes:
        return note + "Heard is what each robot counts, said is what the recorder saw; bytes are in black boxes alone."
    unknown = sum(link.unknown - link.after_end for link in run.links)
    if unknown:
        return note + f"{unknown} messages were heard that nobody said."
    return note + "All that was heard was said, byte for byte."


def matrix(run: Run) -> Table:
    """A dash: not neighbours, or one of them left no recording."""
    cells = {(link.src, link.dst): f"{link.heard} / {'?' if link.said is None else link.said}" for link in run.links}
    names = list(run.fleet.robot)
    rows = [["says", *names], *([src, *(cells.get((src, dst), "-") for dst in names)] for src in names)]
    return Table("Messages heard / said: both numbers nearly the same means that nothing was lost.", rows)


def _mm(x_m: float | None) -> str:
    return "" if x_m is None else f"{1e3 * x_m:.2f}"


# --- light ---
# Who lit for whom, in a fleet that lights for each other: a table of sweeps by their lamps, and when lamps burned.

SPOILED = "spoiled: "  # agent.capabilities.light.lights writes it
FREE = "0.75"  # of a lamp that is its own robot's


def sweeps(timelines: Sequence[RobotTimeline]) -> Table | None:
    """How each robot's sweeps went, by whose lamps burned; None for a fleet without light of its own."""
    rows: list[Row] = [["robot", "lamps", "sweeps", "gave a place", "spoiled by a lamp", "else rejected", "peak ±"]]
    for timeline in timelines:
        by: defaultdict[tuple[str, ...], list[SweepOutcome]] = defaultdict(list)
        for sweep in timeline.sweeps:
            if sweep.outcome is not None and sweep.outcome.lamps is not UNSET:
                by[tuple(sweep.outcome.lamps)].append(sweep.outcome)
        for lamps, outcomes in sorted(by.items()):
            placed = [outcome for outcome in outcomes if outcome.x_m is not None]
            spoiled = sum(outcome.rejected.startswith(SPOILED) for outcome in outcomes)
            sigmas = [outcome.sigma for outcome in placed if outcome.sigma is not None]
            other = len(outcomes) - len(placed) - spoiled
            counts = [str(number) for number in (len(outcomes), len(placed), spoiled, other)]
            rows.append([timeline.label, " ".join(lamps), *counts, f"{median(sigmas):.1f}" if sigmas else "-"])
    if len(rows) == 1:
        return None
    return Table(
        "Sweeps of each robot by the lamps that it took to burn. Spoiled: a lamp changed meanwhile, and what was "
        "measured was thrown away. Peak: median of the standard deviation that the fits state, in lens positions.",
        rows,
    )


def camera_lanes(timelines: Sequence[RobotTimeline]) -> Figure | None:
    """A lane for each robot: who had its camera when, by rows of the table of priorities. None where nobody but the
    target had one, or nobody said."""
    first = {timeline.robot: timeline for timeline in reversed(timelines)}  # grants are of a robot, not of its targets
    held = {
        name: [(t_s, grant.holder) for t_s, grant in each.grants if grant.resource == "camera"]
        for name, each in sorted(first.items())
    }
    holders = [row.holder for row in priorities() if row.resource == "camera"]
    used = [holder for holder in holders if any(holder == which for spans in held.values() for _, which in spans)]
    if set(used) <= {"target"}:
        return None
    figure = Figure(figsize=(9.0, 0.7 + 0.45 * len(held)), layout="constrained")
    panel = figure.subplots()
    for row, (name, spans) in enumerate(held.items()):
        for (t_s, holder), (until_s, _) in itertools.pairwise([*spans, (first[name].ends_s, "")]):
            colour = f"C{holders.index(holder)}" if holder in holders else FREE
            panel.barh(row, until_s - t_s, left=t_s, height=0.7, color=colour)
    panel.set(yticks=range(len(held)), yticklabels=list(held), xlabel="s", ylim=(len(held) - 0.5, -0.5))
    handles = [Patch(color=f"C{holders.index(holder)}", label=holder) for holder in used]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize="small", frameon=False)
    return figure


def lanes(timelines: Sequence[RobotTimeline]) -> Figure:
    """A lane for each robot's lamp: when it burned, in the colour of the robot for whose sweep; grey for itself while
    nobody had a lease. The line below a lane: when that robot had the light."""
    names = list(dict.fromkeys(timeline.robot for timeline in timelines))
    colours = {name: f"C{k}" for k, name in enumerate(names)}
    figure = Figure(figsize=(9.0, 0.7 + 0.6 * len(names)), layout="constrained")
    panel = figure.subplots()
    for row, name in enumerate(names):
        shown = sorted(
            ((t_s, state.lamp) for each in timelines if each.robot == name for t_s, state in each.states if state.lamp),
            key=lambda item: item[0],
        )
        for (t_s, lamp), (until_s, _) in itertools.pairwise(shown):
            leased = lamp.holder is not None and lamp.phase != "asks"
            if lamp.power > 0.0:
                colour = colours.get(lamp.holder or "", FREE) if leased else FREE
                panel.barh(row, until_s - t_s, left=t_s, height=0.55, color=colour, alpha=max(lamp.power, 0.3))
            if lamp.phase == "holds":
                panel.barh(row + 0.36, until_s - t_s, left=t_s, height=0.1, color=colours[name])
    panel.set(yticks=range(len(names)), yticklabels=names, xlabel="s", ylim=(len(names) - 0.45, -0.45))
    handles = [Patch(color=colour, label=f"for {name}") for name, colour in colours.items()]
    figure.legend(
        handles=[*handles, Patch(color=FREE, label="for itself")],
        loc="outside lower center",
        ncols=len(handles) + 1,
        fontsize="small",
        frameon=False,
    )
    return figure
