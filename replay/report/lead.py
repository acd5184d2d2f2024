"""What leads a report, and the page of a recording: the outcome in figures, one sentence of it, pictures, and each
robot at the end.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from markupsafe import Markup

from agent.capabilities.survey.coverage_map import CoverageMap
from agent.core.config import Fleet
from agent.core.messages import State, Symmetric, Vector
from agent.core.robot_view import robot_view
from agent.core.status import fault_kind
from replay.check.check import clocks_apart
from replay.report.creature_track import Path3, true_path
from replay.report.page import Floor, Held, Point, Robot, Thing, cell, close_up, from_above
from replay.report.timeline import RobotTimeline, Run, Surveyed
from replay.story import apart_m, listed

# --- each robot at the end ---
# Each robot at the end of a run, by target: what sentence, picture and tables say of it comes from here.


class End(NamedTuple):
    """One robot and one target."""

    robot: str
    target: str
    label: str  # the robot, and the target where there are several
    known_s: float | None  # when it first knew where the target is; None: it never did
    seen_s: float | None  # when it first said that it sees it
    last: State | None  # what it showed last
    x_m: Vector | None  # the last place that it held, world frame
    cov_m2: Symmetric | None
    held_s: float | None  # when it last said so
    truth_m: Vector | None  # where the target was then, by the twin
    off_m: float | None  # between these two

    @property
    def sigma_m(self) -> float | None:
        """What it states of the place that it holds at the end; None: it holds none then."""
        return None if self.last is None or self.last.posterior_m is None else self.last.posterior_sigma_m


def ends(run: Run) -> list[End]:
    """In the order of the timelines."""
    truths = {target: truth_at(run, target) for target in run.fleet.target}
    return [_end(run, timeline, truths[timeline.target]) for timeline in run.timelines]


def truth_of(run: Run, target: str) -> Path3 | None:
    """The true way of a target that swims; None of one that rests, and where no twin has left it."""
    folder = run.path if run.path.is_dir() else run.path.parent
    return None if run.fleet.target[target].speed_m_s is None else true_path(folder, target)


def truth_at(run: Run, target: str) -> Callable[[float], Vector | None]:
    """Where a target truly was, by the run's seconds; None where nobody knows."""
    way, stays_m, start_ns = truth_of(run, target), run.truths_m.get(target), run.start_ns or 0

    def at(t_s: float) -> Vector | None:
        if way is None:
            return stays_m
        x, y, z = way.at([start_ns + round(t_s * 1e9)])[0].tolist()
        return None if math.isnan(x + y + z) else (x, y, z)

    return at


def _end(run: Run, timeline: RobotTimeline, true_m: Callable[[float], Vector | None]) -> End:
    held_s = [t_s for t_s, state in timeline.states if state.posterior_m is not None]
    estimate, truth_m = timeline.estimate, true_m(held_s[-1]) if held_s else run.truths_m.get(timeline.target)
    return End(
        robot=timeline.robot,
        target=timeline.target,
        label=timeline.label,
        known_s=held_s[0] if held_s else None,
        seen_s=next((t_s for t_s, state in timeline.states if state.knows == "sees"), None),
        last=timeline.beliefs[-1].state if timeline.beliefs else None,
        x_m=estimate[0] if estimate else None,
        cov_m2=estimate[1] if estimate else None,
        held_s=held_s[-1] if held_s else None,
        truth_m=truth_m,
        off_m=math.dist(estimate[0], truth_m) if estimate and truth_m else None,
    )


# --- outcome in figures ---
# What came of a run, as figures: what its sentence is made of.

EARLY_S = 3.0  # before the last one: that early a robot ended, or fell silent, as on the page
LOUD = ("warning", "error")  # levels of the log
ORDERED = " orders: "  # agent.robot.operator: what people ordered is no trouble
SWEEP = "sweep"  # that one comes to nothing is no trouble: the next one follows
OVER = "over: "  # agent.core.status: the end of a fault
BARE = "no IMU"  # hw.stm32.protocol: what a robot is built without is no event of a dive; its log has it


class Found(NamedTuple):
    """What became of one target. Times are seconds of the run, by robot."""

    target: str
    seen_s: Mapping[str, float]  # who saw it, first when
    known_s: Mapping[str, float]  # who knew where it is, first when
    sigma_m: Mapping[str, float]  # who holds a place of it at the end, and how surely
    off_m: Mapping[str, float]  # how far each was off at the end; empty: nobody knows the truth
    has_size: bool = False  # a thing in a box: its surface is measured, and the truth is of its middle
    apart_m: float | None = None  # between the two places held that differ most; None of one that swims
    in_view: tuple[float, float] | None = None  # of one that swims: shares of the time, least and largest
    track_rms_m: float | None = None  # of one that swims: the robots' tracks off the true one


class Survey(NamedTuple):
    """How far it came: of what is wanted, by the robot that knows least."""

    share: float
    wanted: float
    keyframes: int
    alike: bool  # all maps are the same


# Its recording was finished by its writer; it was not; there is none, and this is what others heard of it.
Ending = Literal["ended", "torn", "silent"]


class RobotOutcome(NamedTuple):
    """How one robot fared."""

    ends_s: float
    starts: int = 1
    mode: str = "running"
    ending: Ending = "ended"
    faults: tuple[str, ...] = ()  # that stand at the end
    warned: tuple[str, ...] = ()  # what else its log warns of, each kind once


class Outcome(NamedTuple):
    fleet: tuple[str, ...]  # all robots of the fleet file
    robots: Mapping[str, RobotOutcome]  # those that were heard
    targets: tuple[Found, ...]
    missing: tuple[str, ...] = ()  # of whom there should be something, and is nothing
    survey: Survey | None = None
    torn: tuple[str, ...] = ()  # recordings that nobody finished
    left_out: tuple[str, ...] = ()  # what of recordings is not read
    clocks: tuple[str, ...] = ()  # of which robots they differ
    verdict: str = ""  # the demo's own: pass, fail; nothing for a run without
    reasons: tuple[str, ...] = ()  # why it failed

    @property
    def lasted_s(self) -> float:
        return max((robot.ends_s for robot in self.robots.values()), default=0.0)


def outcome(run: Run, at_end: Sequence[End], survey: Surveyed | None) -> Outcome:
    """By the recordings; a share of a survey and what a track was worth as the demo found it, where it did."""
    summary = run.summary or {}
    torn = [box.path.name for box in run.boxes if not box.complete]
    torn += [run.fleet_file.path.name] if run.fleet_file and not run.fleet_file.complete else []
    heard = {timeline.robot for timeline in run.robots}
    alone = run.fleet_file is None and not run.path.is_dir()  # one robot's recording, and only that was asked for
    return Outcome(
        fleet=tuple(run.fleet.robot),
        robots={timeline.robot: _robot(timeline) for timeline in run.robots},
        targets=tuple(
            _found(
                target,
                about.speed_m_s is not None,
                about.detector == "box",
                [end for end in at_end if end.target == target],
                summary.get("targets", {}).get(target, {}),
            )
            for target, about in run.fleet.target.items()
        ),
        missing=tuple(name for name in run.fleet.robot if name not in heard) if not alone else (),
        survey=_survey(run, survey),
        torn=tuple(torn),
        left_out=tuple(run.left_out),
        clocks=tuple(clocks_apart(run.links)),
        verdict=summary.get("verdict", ""),
        reasons=tuple(summary.get("reasons", ())),
    )


def _found(target: str, swims: bool, has_size: bool, of: Sequence[End], by_demo: Mapping[str, Any]) -> Found:
    held = [end.x_m for end in of if end.sigma_m is not None and end.x_m is not None]
    seen = [row["seen"] for row in by_demo.get("agents", {}).values() if row.get("seen") is not None] if swims else []
    rms_mm = by_demo.get("track_rms_mm") if swims else None
    return Found(
        target=target,
        seen_s={end.robot: end.seen_s for end in of if end.seen_s is not None},
        known_s={end.robot: end.known_s for end in of if end.known_s is not None},
        sigma_m={end.robot: end.sigma_m for end in of if end.sigma_m is not None},
        off_m={end.robot: end.off_m for end in of if end.off_m is not None and end.sigma_m is not None},
        has_size=has_size,
        apart_m=apart_m(held) if not swims else None,
        in_view=(min(seen), max(seen)) if seen else None,
        track_rms_m=None if rms_mm is None else 1e-3 * rms_mm,
    )


LEFT_NS = 5_000_000_000  # who said nothing of the survey for so long before its end has left it


def _survey(run: Run, found: Surveyed | None) -> Survey | None:
    if run.fleet.coverage is None or found is None:
        return None
    lasts = [rows[-1] for rows in found.known.values() if rows]
    if not lasts:
        return None
    newest_ns = max(last.t_ns for last in lasts)
    lasts = [last for last in lasts if last.t_ns > newest_ns - LEFT_NS]
    return Survey(
        share=min(last.share for last in lasts),
        wanted=run.fleet.coverage.share,
        keyframes=max(len(found.frames), *(last.held for last in lasts)),
        alike=len({last.digest for last in lasts}) == 1,
    )


def _robot(timeline: RobotTimeline) -> RobotOutcome:
    last = timeline.states[-1][1] if timeline.states else None
    warned: dict[str, None] = {}
    for _, line in timeline.log:
        if (
            line.level in LOUD
            and ORDERED not in line.text
            and SWEEP not in line.text
            and not line.text.startswith((OVER, BARE))
        ):
            warned.setdefault(fault_kind(line.text))
    faults = last.faults if last is not None else ()
    kinds = {fault_kind(fault) for fault in faults}
    return RobotOutcome(
        ends_s=timeline.ends_s,
        starts=max(1, len(timeline.starts_s)),
        mode=last.mode if last is not None else "running",
        ending="silent" if not timeline.boxes else "ended" if timeline.boxes[-1].complete else "torn",
        faults=faults,
        warned=tuple(kind for kind in warned if kind not in kinds),
    )


# --- outcome in one sentence ---
# What came of a run, in one sentence: who found what, when, how surely, and what went wrong. Pure.

NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
ENDINGS = {"ended": "{} ended", "torn": "the recording of {} breaks off", "silent": "{} fell silent"}
UNBROKEN = "\u00a0"  # a space at which no line ends
UNIT = re.compile(r"(?<=±) | (?=(?:mm|s|min|%)(?:\W|$))")  # the space between a number and what it counts


class Part(NamedTuple):
    """A piece of the sentence; all of them one after the other are it."""

    kind: Literal["", "good", "bad"]
    text: str


def sentence(about: Outcome) -> list[Part]:
    """First what came of it, then what went wrong."""
    if not about.robots:
        nothing = about._replace(missing=())
        return _one([("bad", "no robot of this run left a recording that can be read"), *_wrong(nothing)], about)
    clauses: list[tuple[Literal["", "good", "bad"], str]] = []
    if about.survey is not None:
        enough = about.survey.share >= about.survey.wanted
        clauses.append(("good" if enough else "bad", _surveyed(about.survey, about.lasted_s)))
    for found in about.targets:
        if about.survey is not None and not found.known_s:  # a survey looks for none
            continue
        clauses.append(("good" if found.sigma_m else "bad", _found_words(found, about)))
    return _one([*clauses, *_wrong(about)], about)


def _one(clauses: Sequence[tuple[Literal["", "good", "bad"], str]], about: Outcome) -> list[Part]:
    """Clauses with semicolons between them; a name of a robot stays as it is written."""
    parts = [Part(kind, UNIT.sub(UNBROKEN, f"{text}; ")) for kind, text in clauses]
    parts[-1] = parts[-1]._replace(text=parts[-1].text.removesuffix("; ") + ".")
    first = parts[0].text
    if first.split()[0].rstrip(",") not in about.fleet:
        parts[0] = parts[0]._replace(text=first[0].upper() + first[1:])
    return parts


def _found_words(found: Found, about: Outcome) -> str:
    if not found.known_s:
        return f"nobody found the {found.target} in {seconds(about.lasted_s)}"
    who = ", ".join(_who(found, about))
    if not found.sigma_m:
        return f"{who}; at the end nobody knew where it is"
    lost = [name for name in found.known_s if name not in found.sigma_m]
    who_knew = "all" if len(found.sigma_m) == len(about.fleet) > 1 else names(found.sigma_m, about)
    forgot = f", {names(lost, about)} no longer did" if lost else ""
    return f"{who}; at the end {who_knew} knew its place to {_how_surely(found)}{forgot}"


def _who(found: Found, about: Outcome) -> Iterator[str]:
    seen = sorted(found.seen_s, key=lambda name: found.seen_s[name])
    told = [name for name in found.known_s if name not in found.seen_s]
    never = [name for name in about.robots if name not in found.seen_s and name not in found.known_s]
    if not seen:
        first = seconds(min(found.known_s.values()))
        yield f"{names(told, about)} heard of the {found.target} after {first} and never saw it"
    elif len(seen) == 1:
        yield f"{seen[0]} found the {found.target} after {seconds(found.seen_s[seen[0]])}"
    else:
        yield f"{names(seen, about)} saw the {found.target} ({seen[0]} first, after {seconds(found.seen_s[seen[0]])})"
    if seen and told:
        yield f"{names(told, about)} {'was' if len(told) == 1 else 'were'} told of it"
    if never:
        yield f"{names(never, about)} never knew of it"
    if found.in_view is not None:
        least, most = (f"{100 * share:.0f}" for share in found.in_view)
        yield f"in view for {least} %" + (f" to {most} %" if most != least else "") + " of the time"


def _how_surely(found: Found) -> str:
    """Of those that hold a place at the end, the least sure and the one that is farthest off."""
    sure, several = f"± {millimetres(max(found.sigma_m.values()))}", len(found.sigma_m) > 1
    if found.track_rms_m is not None:
        return f"{sure}, and on the way {'were' if several else 'was'} {millimetres(found.track_rms_m)} off (rms)"
    if found.off_m:
        most = millimetres(max(found.off_m.values()))
        where = "from its middle" if found.has_size else "off"
        return f"{sure}, and {'were at most' if several else 'was'} {most} {where}"
    if found.apart_m is not None:
        return f"{sure}, within {millimetres(max(found.apart_m, 1e-4))} of each other"
    return sure


def _surveyed(survey: Survey, lasted_s: float) -> str:
    known = f"{100 * survey.share:.0f} % of what is wanted is known after {seconds(lasted_s)}"
    asked = f"{100 * survey.wanted:.0f} % were asked for"
    return f"{known}, from {survey.keyframes} keyframes, and {asked}" + (
        "" if survey.alike else ", and the maps differ"
    )


def _wrong(about: Outcome) -> Iterator[tuple[Literal["bad"], str]]:
    if about.missing:
        yield "bad", f"nothing was heard of {names(about.missing, about)}"
    for name, robot in about.robots.items():
        if robot.mode == "failed":
            yield "bad", f"{name} failed after {seconds(robot.ends_s)}"
        elif about.lasted_s - robot.ends_s > EARLY_S and not about.clocks:
            how = ENDINGS[robot.ending].format(name)
            yield "bad", f"{how} after {seconds(robot.ends_s)} of {seconds(about.lasted_s)}"
        if robot.starts > 1:
            yield "bad", f"{name} started again" + (f" {robot.starts - 1} times" if robot.starts > 2 else "")
    for what, text in (("ended with", "faults"), ("warned of", "warned")):
        by = {name: getattr(robot, text) for name, robot in about.robots.items() if getattr(robot, text)}
        if by:
            yield "bad", f"{names(by, about)} {what} {_first_of(list(dict.fromkeys(itertools.chain(*by.values()))))}"
    if about.torn:
        whose = "its writer" if len(about.torn) == 1 else "their writers"
        yield "bad", f"not finished by {whose}: {listed(about.torn)}"
    yield from (("bad", line) for line in (*about.clocks, *about.left_out))
    if about.verdict == "fail":
        yield "bad", f"it did not pass: {_first_of(about.reasons)}" if about.reasons else "it did not pass"


def _first_of(texts: Sequence[str]) -> str:
    more = len(texts) - 1
    return f"“{texts[0]}”" + (f" and {NUMBERS[more] if more < len(NUMBERS) else more} more" if more else "")


def names(of: Collection[str], about: Outcome) -> str:
    """Of robots, in the order of the fleet file: all of them are "all three robots"."""
    if len(of) == len(about.fleet) > 1:
        n = len(of)
        return "both robots" if n == 2 else f"all {NUMBERS[n] if n < len(NUMBERS) else n} robots"
    return listed([name for name in about.fleet if name in of])


def seconds(s: float) -> str:
    if s < 9.95:
        return f"{s:.1f} s"
    minutes, rest = divmod(round(s), 60)
    if minutes < 2:
        return f"{s:.0f} s"
    return f"{minutes} min {rest} s" if rest else f"{minutes} min"


def millimetres(m: float) -> str:
    return f"{1e3 * m:.1f} mm" if m < 0.00995 else f"{1e3 * m:.0f} mm"


def plain(parts: Sequence[Part]) -> str:
    """As one text with ordinary spaces."""
    return "".join(part.text for part in parts).replace(UNBROKEN, " ")


# --- the lead ---

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
        numbers = [cell(end.known_s, ".1f"), cell(end.seen_s, ".1f"), _mm(end.sigma_m)]
        rows.append([end.label, knows, *numbers, *([_mm(end.off_m)] if exact else [])])
    about = "Each robot at the end; seconds since the first step of any. Sure to: one standard deviation, all axes "
    return Ends(f"{about}together, as the robot states it.", rows)


SURVEYED = "At the end. Maps are equal where these digits are."  # about what `survey_rows` says


def survey_rows(found: Surveyed) -> list[list[str]]:
    """A row for each robot, at the end, under a head."""
    rows = [["robot", "keyframes of its own", "held", "knows", "map"]]
    for name, each in found.known.items():
        own = sum(frame.origin == name for _, frame in found.frames)
        last = each[-1] if each else None
        told = ["-", "-", "-"] if last is None else [str(last.held), f"{100 * last.share:.1f} %", last.digest]
        rows.append([name, str(own), *told])
    return rows


def _mm(value_m: float | None) -> str:
    return cell(None if value_m is None else 1e3 * value_m, ".1f")


def _drawn_robot(fleet: Fleet, name: str, timelines: Sequence[RobotTimeline]) -> Robot | None:
    """None of one that swims and never said where it is."""
    mine = [each for each in timelines if each.robot == name]
    states = sorted((row for each in mine for row in each.states), key=lambda row: row[0])
    bodies = [body for _, state in states if (body := robot_view(state, fleet).body) is not None]
    if fleet.navigation is not None and not bodies:
        return None
    at = bodies[-1] if bodies else fleet.robot[name].pose
    return Robot(
        name=name,
        colour=list(fleet.robot).index(name),
        at=(at.x_m, at.y_m),
        yaw=math.radians(at.yaw_deg),
        looks=math.radians(at.yaw_deg + (states[-1][1].pan_deg if states else 0.0)),
        sees=any(each.states[-1][1].knows == "sees" for each in mine if each.states),
        way=_thinned([(body.x_m, body.y_m) for body in bodies]) if fleet.navigation is not None else (),
        heard=bool(states),
    )


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
            way=_thinned([x_m[:2] for _, x_m in about[end.robot].held]) if swims else (),
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


def floor_known(found: CoverageMap) -> list[int]:
    """Each column of cells from above, x fastest: 0 nothing is known of its floor, 1 something, 2 all that is asked
    for, 3 a thing stands above it."""
    nx, ny, _ = found.grid.shape
    have = (found.cells.get(number, 0) for number in range(nx * ny))
    known = [2 if cell >= found.grid.goal else 1 if cell > 0 else 0 for cell in have]
    for number in found.solid():
        known[number % (nx * ny)] = 3
    return known


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
