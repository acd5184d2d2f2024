"""What leads a report: the sentence, the pictures, and each robot at the end; the page of a recording too."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from markupsafe import Markup

from agent.core.config import Fleet
from agent.core.messages import State, Symmetric
from replay.report.lead.ends import End, ends, truth_of
from replay.report.lead.outcome import outcome
from replay.report.lead.picture import Floor, Held, Robot, Thing, close_up, from_above
from replay.report.lead.sentence import Part, sentence
from replay.report.lead.view import Point
from replay.report.robot_timeline import RobotTimeline
from replay.report.run import Run
from replay.report.surveyed import SURVEYED, Surveyed, floor_known, survey_rows

MOST_POINTS = 400  # of a way: more cannot be told apart
KINDS = {1: "some", 2: "known", 3: "thing"}
KNOWS = {"sees": "sees it", "told": "told by others", "blind": "does not know"}


class Look(NamedTuple):
    caption: str
    svg: Markup


class Ends(NamedTuple):
    about: str
    rows: list[list[str]]  # its head first


class Lead(NamedTuple):
    said: list[Part]
    looks: list[Look]  # the tank, then each target
    ends: Ends


def lead(run: Run, survey: Surveyed | None) -> Lead:
    at_end = ends(run)
    every = (_drawn_robot(run.fleet, name, run.timelines) for name in run.fleet.robot)
    robots = [robot for robot in every if robot is not None]
    things = [_thing(run, target, at_end) for target in run.fleet.target]
    shown = [thing for thing in things if thing.held or thing.truth_m is not None]
    looks = [Look(_caption(robots, shown, survey), from_above(run.fleet, robots, shown, _floor(survey)))]
    for thing in shown:
        if (close := close_up(thing)) is not None:
            truth = "" if thing.truth_m is None else " Large cross: the truth, by the twin."
            rounded = any(end.target == thing.name and end.x_m and not end.cov_m2 for end in at_end)
            size = " A circle: of how sure that robot was only the size is recorded." if rounded else ""
            alike = " Of robots that agree the last covers the others." if len(thing.held) > 1 else ""
            about = f"The {thing.name} close up: where each robot places it, ellipses of three standard deviations."
            looks.append(Look(about + size + alike + truth, close))
    return Lead(sentence(outcome(run, at_end, survey)), looks, _ends(at_end, survey))


def _ends(at_end: Sequence[End], survey: Surveyed | None) -> Ends:
    if survey is not None and all(end.known_s is None for end in at_end):  # a survey looks for no target
        return Ends(SURVEYED, survey_rows(survey))
    exact = any(end.off_m is not None for end in at_end)
    rows = [["robot", "at the end", "first knew, s", "first saw, s", "sure to ± mm", *(["off by mm"] if exact else [])]]
    for end in at_end:
        knows = "-" if end.last is None else KNOWS[end.last.knows]
        numbers = [_number(end.known_s, 1.0), _number(end.seen_s, 1.0), _number(end.sigma_m, 1e3)]
        rows.append([end.label, knows, *numbers, *([_number(end.off_m, 1e3)] if exact else [])])
    about = "Each robot at the end; seconds since the first step of any. Sure to: one standard deviation, all axes "
    return Ends(f"{about}together, as the robot states it.", rows)


def _number(value: float | None, unit: float) -> str:
    return "-" if value is None else f"{unit * value:.1f}"


def _drawn_robot(fleet: Fleet, name: str, timelines: Sequence[RobotTimeline]) -> Robot | None:
    """None of one that swims and never said where it is."""
    mine = [each for each in timelines if each.robot == name]
    states = sorted((row for each in mine for row in each.states), key=lambda row: row[0])
    pose, way = fleet.robot[name].pose, _swum(states)
    x_m, y_m, yaw_deg = pose.x_m, pose.y_m, pose.yaw_deg
    if fleet.navigation is not None:
        if not way:
            return None
        at = next(state.whereabouts for _, state in reversed(states) if state.whereabouts)
        x_m, y_m, yaw_deg = at.x_m, at.y_m, at.yaw_deg
    return Robot(
        name=name,
        colour=list(fleet.robot).index(name),
        at=(x_m, y_m),
        yaw=math.radians(yaw_deg),
        looks=math.radians(yaw_deg + (states[-1][1].pan_deg if states else 0.0)),
        sees=any(each.states[-1][1].knows == "sees" for each in mine if each.states),
        way=_thinned(way),
        heard=bool(states),
    )


def _swum(states: Sequence[tuple[float, State]]) -> list[Point]:
    return [(state.whereabouts.x_m, state.whereabouts.y_m) for _, state in states if state.whereabouts]


def _thinned(way: Sequence[Point]) -> list[Point]:
    """Few points, the first and the last among them."""
    step = max(1, math.ceil(len(way) / MOST_POINTS))
    return [*way[:-1:step], *way[-1:]]


def _thing(run: Run, target: str, at_end: Sequence[End]) -> Thing:
    names, swims = list(run.fleet.robot), run.fleet.target[target].speed_m_s is not None
    of = [end for end in at_end if end.target == target]
    about = {timeline.robot: timeline for timeline in run.about(target)}
    held = [
        Held(
            colour=names.index(end.robot),
            x_m=end.x_m,
            cov_m2=end.cov_m2 or _round(end.sigma_m),
            way=_thinned([b.state.posterior_m[:2] for b in about[end.robot].beliefs if b.state.posterior_m])
            if swims
            else (),
        )
        for end in of
        if end.x_m is not None and end.robot in names
    ]
    newest_truth = max((end for end in of if end.truth_m is not None), key=lambda end: end.held_s or 0.0, default=None)
    truth_m = newest_truth.truth_m if newest_truth is not None else run.truths_m.get(target)
    return Thing(target, run.fleet.target[target].radius_m or 0.0, held, truth_m, _swam(run, target))


def _round(sigma_m: float | None) -> Symmetric | None:
    """A covariance of that size, alike in all directions, as the page has it: of what was not told to others no other
    is recorded."""
    return None if sigma_m is None else (sigma_m**2 / 3, 0.0, 0.0, sigma_m**2 / 3, 0.0, sigma_m**2 / 3)


def _swam(run: Run, target: str) -> list[Point]:
    """The true way of a target while robots were recorded."""
    way = truth_of(run, target)
    if way is None or run.start_ns is None:
        return []
    until_ns = run.start_ns + round(1e9 * max((timeline.ends_s for timeline in run.robots), default=0.0))
    inside = (way.t_ns >= run.start_ns) & (way.t_ns <= until_ns)
    return _thinned([(float(x), float(y)) for x, y, _ in way.x_m[inside]])


def _floor(survey: Surveyed | None) -> Floor | None:
    if survey is None or not survey.frames:
        return None
    grid, cells = survey.all.grid, {kind: list[Point]() for kind in KINDS.values()}
    for number, known in enumerate(floor_known(survey.all)):
        if known:
            y, x = divmod(number, grid.shape[0])
            cells[KINDS[known]].append((x * grid.cell_m, y * grid.cell_m))
    return Floor(grid.cell_m, cells)


def _caption(robots: Sequence[Robot], things: Sequence[Thing], survey: Surveyed | None) -> str:
    """Only what is in the picture."""
    said = ["From above, in metres. Arrows: robots"]
    said.append(
        " where they ended, after the ways that they swam (circle: where each began)."
        if any(robot.way for robot in robots)
        else "."
    )
    said.append(" Line: where its camera looked, dashed where it saw no target." if robots else "")
    said.append(" Crosses: where each robot places a target." if any(thing.held for thing in things) else "")
    said.append(" Dotted: where each believed it to swim." if any(h.way for t in things for h in t.held) else "")
    said.append(" Thin line: its true way, by the twin." if any(thing.swam for thing in things) else "")
    said.append(" Large cross: the truth, by the twin." if any(thing.truth_m for thing in things) else "")
    if survey is not None and survey.frames:
        said.append(" Of the floor: green is known as well as was asked for, yellow less well; grey: a thing above it.")
    return "".join(said)
