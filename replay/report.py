"""`aucamp replay report`: a run as one page, from the recordings of its robots.

The paper's figures, drawn from the black boxes; the truth, where a twin knows it, comes from summary.json. All of it is
inline, so that the page can be mailed.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import matplotlib
from markupsafe import Markup
from matplotlib.figure import Figure

from agent.config import ConfigError, Fleet, load_fleet
from agent.messages import Vector
from replay import figures_belief, figures_focus, figures_map, figures_posture
from replay.blackbox import BlackBox, black_boxes, open_boxes
from replay.errors import LATE, error_table, relative_percent
from replay.links import Link, links
from replay.report_page import PAGE
from replay.story import Story, stories

Row = list[str]


class Section(NamedTuple):
    id: str
    title: str
    note: str
    tables: list[list[Row]]  # each with its head first
    figures: list[Markup]


def report(run: Path, out: Path | None = None) -> Path:
    """Write the page of a run's folder, or of one black box, and return its path.

    `out` is report.html in the folder, or NAME.html beside the file, if not given. A robot without a recording is left
    out of the figures. Raises ConfigError if there is nothing to show.
    """
    summary = _summary(run)
    boxes = _boxes(run)
    if not boxes and summary is None:
        raise ConfigError(f"{run}: no black box and no summary.json; give the folder of a run or a <robot>.mcap")
    fleet = boxes[0].fleet if boxes else load_fleet(run / "fleet.toml")
    told = {target: stories(boxes, target) for target in fleet.target}
    page = jinja2.Environment(autoescape=True).from_string(PAGE)
    out = out or (run / "report.html" if run.is_dir() else run.with_name(f"{run.name.split('.mcap')[0]}.html"))
    out.write_text(
        page.render(
            title=f"Fleet {fleet.fleet}",
            verdict=summary["verdict"] if summary else "",
            reasons=summary["reasons"] if summary else [],
            about=_about(fleet, boxes, next(iter(told.values())), summary),
            sections=_sections(fleet, boxes, told, summary),
        ),
        encoding="utf-8",
    )
    return out


def _summary(run: Path) -> dict[str, Any] | None:
    """What the demo found; None for a run without one."""
    path = run / "summary.json"
    if not path.exists():
        return None
    try:
        summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise ConfigError(f"{run}: no usable summary.json; repair it, or remove it to do without the truth") from None
    return summary


def _boxes(run: Path) -> list[BlackBox]:
    return open_boxes(black_boxes(run) if run.is_dir() else [run])


def _about(fleet: Fleet, boxes: Sequence[BlackBox], told: Sequence[Story], summary: dict[str, Any] | None) -> str:
    parts_ = [f"Protocol {fleet.estimation.protocol}, {len(told)} recordings of {len(fleet.robot)} robots."]
    if told:
        parts_.append(f"{max(story.ends_s for story in told):.0f} s, {sum(box.recorded for box in boxes)} steps.")
        run = boxes[0].run
        dirty = " with uncommitted changes" if run.get("dirty") == "yes" else ""
        parts_.append(f"aucamp {run.get('version.aucamp', '?')}, commit {run.get('commit', '?')[:10]}{dirty}.")
    if summary:
        truths = ((target, _of_target(summary, target)) for target in fleet.target)
        places = [(target, ", ".join(f"{1e3 * x:.1f}" for x in about["truth_m"])) for target, about in truths if about]
        where = [f"{target if len(places) > 1 else 'the target'} is at ({place}) mm" for target, place in places]
        parts_.append(f"Twin seed {summary['seed']}; by the twin {', '.join(where)}.")
    torn = [box.path.name for box in boxes if not box.complete]
    if torn:
        parts_.append(f"Not finished by their writer: {', '.join(torn)}.")
    return " ".join(parts_)


def _sections(
    fleet: Fleet,
    boxes: Sequence[BlackBox],
    told: Mapping[str, Sequence[Story]],
    summary: dict[str, Any] | None,
) -> list[Section]:
    """Those of each target, then those of the robots."""
    heard = links(boxes)
    sections = []
    for target, stories_ in told.items():
        of_target = _target_sections(fleet, stories_, _of_target(summary, target))
        if len(told) > 1:
            of_target = [s._replace(id=f"{s.id}_{target}", title=f"{s.title}: {target}") for s in of_target]
        sections += of_target
    return [*sections, *(_robot_sections(fleet, next(iter(told.values())), heard) if boxes else [])]


def _target_sections(fleet: Fleet, told: Sequence[Story], summary: dict[str, Any] | None) -> list[Section]:
    """What the robots know of one target; `summary` is that of the target."""
    truth_m: Vector | None = tuple(summary["truth_m"]) if summary else None
    against = "" if truth_m is None else " Dashed: the truth, by the twin."
    lower = "" if truth_m is None else " Coloured: each robot's distance from the truth."
    sections = [
        Section("errors", "Errors", _error_note(truth_m), _error_tables(fleet, told, summary, truth_m), []),
        Section(
            "iterations",
            "Prior and posterior",
            "Dots: the robot's own measurement x̂. Line: its estimate x after hearing its neighbours, with twice the "
            f"standard deviation it states. Green: its first view of the target.{against}",
            [],
            [_svg(figures_belief.iterations(story, truth_m)) for story in told],
        ),
        Section(
            "valid",
            "Valid set",
            "S is the set of robots that see the target. Nobody knows it; each row is what the observer could know.",
            [_events(told)],
            [_svg(figures_belief.valid_set(story)) for story in told],
        ),
        Section(
            "agreement",
            "Agreement",
            f"Black: the largest distance between what two robots believe at a time.{lower}",
            [],
            [_svg(figures_belief.disagreement(told, truth_m))] if told else [],
        ),
        Section(
            "above",
            "From above",
            "Robots where they were surveyed, and where they place the target; then the surroundings of the target.",
            [],
            [_svg(figures_map.above(fleet, told, truth_m)), _svg(figures_map.near_target(fleet, told, truth_m))],
        ),
        Section(
            "clarity",
            "Clarity",
            "Clarity over the lens position in some of the sweeps. Vertical: the peak, ± its standard deviation.",
            [],
            [_svg(figures_focus.clarity_curves(story)) for story in told],
        ),
    ]
    return [section for section in sections if told or section.id in ("errors", "above")]


def _robot_sections(fleet: Fleet, told: Sequence[Story], heard: Sequence[Link]) -> list[Section]:
    """What does not depend on the target."""
    return [
        Section(
            "calibration",
            "Calibration",
            "The range h at which the lens is sharp, as calibrated before the run, and the peaks of this run on it. "
            "RMSE is that of the range over the calibrated distances, once of the fit and once of distances left out.",
            [],
            [_svg(figures_focus.calibration_fit(story)) for story in told],
        ),
        Section(
            "posture",
            "Depth and attitude",
            "What the control module reports: its four pressure sensors below their tare, the pulses of the four "
            "central thrusters from neutral, depth against its set-point, roll and pitch.",
            [_hover(told)],
            [_svg(figures_posture.posture(story)) for story in told],
        ),
        Section("links", "Who heard whom", _link_note(heard), [_matrix(fleet, heard)], []),
    ]


def _of_target(summary: dict[str, Any] | None, target: str) -> dict[str, Any] | None:
    """The part of a summary that is about one target; those of fleets with one target need not have parts."""
    return summary and summary.get("targets", {}).get(target, summary)


# --- tables ---------------------------------------------------------------------------------------------------


def _error_note(truth_m: Vector | None) -> str:
    if truth_m is None:
        return "Nobody knows the truth of this run: the last estimate of each robot, as it states it."
    return (
        "Relative error: the distance to the target over the target's distance from the tank's corner, as in the "
        "paper, and over its distance from the robot. Below: priors over the whole run, posteriors over the last "
        f"{LATE} iterations; the last column is the share of errors within twice the standard deviation that the "
        "robot stated."
    )


def _error_tables(
    fleet: Fleet, told: Sequence[Story], summary: dict[str, Any] | None, truth_m: Vector | None
) -> list[list[Row]]:
    head = ["robot", "x mm", "y mm", "z mm", "sigma mm", "first view", "iterations"]
    if truth_m is None:
        return [[head, *(_stated(story) for story in told)]]
    assert summary is not None
    ends = [[*head, "error mm", "% of |x*|", "% of range"]]
    by_name = {story.robot: story for story in told}
    for name, row in summary["agents"].items():
        estimate = row.get("estimate_m")
        line = _stated(by_name[name]) if name in by_name else [name, *(_mm(x) for x in estimate or [None] * 3)]
        line += [""] * (len(head) - len(line))
        if estimate:
            robot = fleet.robot[name]
            eye_m = (robot.pose.x_m, robot.pose.y_m, fleet.tank.surface_m - robot.depth_m)
            relative = relative_percent(estimate, truth_m), relative_percent(estimate, truth_m, eye_m)
            line += [f"{row['error_mm']:.2f}", *(f"{percent:.3f}" for percent in relative)]
        ends.append(line)
    rows = [["robot", "what", "axis", "n", "bias mm", "RMSE mm", "95 % mm", "largest mm", "within 2 sigma"]]
    for e in error_table(told, truth_m):
        shown = [_number(e.bias, "+.2f"), *(f"{value:.2f}" for value in (e.rmse, e.p95, e.largest))]
        rows.append([e.robot, e.what, e.axis, str(e.n), *shown, _number(e.within_2_sigma, ".0%")])
    return [ends, rows] if len(rows) > 1 else [ends]


def _stated(story: Story) -> Row:
    """The last belief of a robot."""
    if not story.beliefs:
        return [story.robot]
    state = story.beliefs[-1].state
    place = [_mm(x) for x in state.posterior_m or [None] * 3]
    first = "never" if state.acquired_t is None else str(state.acquired_t)
    return [story.robot, *place, _mm(state.posterior_sigma_m), first, str(state.t)]


def _events(told: Sequence[Story]) -> list[Row]:
    """What the robots wrote to their logs, without the sweeps: why somebody entered S or left it."""
    lines = sorted(
        (t_s, line.robot, line.text) for story in told for t_s, line in story.log if "sweep" not in line.text
    )
    starts = [(t_s, story.robot, "starts again") for story in told for t_s in story.starts_s[1:]]
    return [["robot", "s", "event"], *([robot, f"{t_s:.1f}", text] for t_s, robot, text in sorted([*lines, *starts]))]


def _hover(told: Sequence[Story]) -> list[Row]:
    rows = [["robot", "depth error, rms mm", "tilt, rms deg"]]
    for story in told:
        hover = figures_posture.hover(story)
        rows.append([story.robot, *([f"{value:.2f}" for value in hover.values()] if hover else ["never at depth", ""])])
    return rows


def _link_note(heard: Sequence[Link]) -> str:
    unknown = sum(link.unknown - link.after_end for link in heard)
    proof = (
        f"{unknown} messages were heard that nobody said" if unknown else "All that was heard was said, byte for byte"
    )
    return f"Rows speak, columns hear: messages taken in of those given out. {proof}."


def _matrix(fleet: Fleet, heard: Sequence[Link]) -> list[Row]:
    """A dash: not neighbours, or one of them left no recording."""
    cells = {(link.src, link.dst): f"{link.heard} / {'?' if link.said is None else link.said}" for link in heard}
    names = list(fleet.robot)
    return [["says", *names], *([src, *(cells.get((src, dst), "-") for dst in names)] for src in names)]


def _mm(x_m: float | None) -> str:
    return "" if x_m is None else f"{1e3 * x_m:.2f}"


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _svg(figure: Figure) -> Markup:
    """The figure as an element of the page."""
    text = io.StringIO()
    with matplotlib.rc_context(
        {"svg.fonttype": "none", "svg.hashsalt": "aucamp"}
    ):  # text stays text; same ids each time
        figure.savefig(text, format="svg", metadata={"Date": None})
    svg = text.getvalue()[text.getvalue().index("<svg") :]
    return Markup(re.sub(r' (width|height)="[\d.]+pt"', "", svg, count=2))  # its box decides how large it is
