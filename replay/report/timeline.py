"""What there is of a run, in the shape that tables and figures need: series over time of each robot and target, from
black boxes or from the fleet recorder.

It has what each robot believed, whom it says it heard, its depth and tilt. It has no frames, no sweeps, no pressures
and no pulses, and not what a robot really took in: that is in black boxes alone.
"""

from __future__ import annotations

import itertools
import json
from array import array
from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from agent.capabilities.survey.coverage_map import CoverageMap, grid_of
from agent.core.capability_messages import Claim, Frame, Keyframe, frame_fault, holds
from agent.core.codec import READABLE, Refusal, decode
from agent.core.config import ConfigError, Fleet, check_depth, convert, read_text
from agent.core.messages import Answer, Estimate, LogLine, State, Symmetric, Vector
from agent.core.step_io import Grant, Heard, Inputs, Outputs, Sighting, SweepOutcome
from agent.core.topics import CLAIM, KEYFRAME
from agent.core.trust import common, keyframe_bytes, verify_signature
from agent.robot.fleet_reader import load_fleet
from replay.check.check import Link, links
from replay.check.reexecute import (
    STEP_BYTES,
    BlackBox,
    attached_toml,
    head,
    open_boxes,
    other_kind,
    schema_of,
)
from replay.files.channels import CLOCK, LINES
from replay.files.info import Moment, in_dive, moment
from replay.files.log import parts, read
from replay.files.mcap_file import left_out
from replay.files.recover import black_boxes, fleet_recordings, recordings
from replay.story import said_in

# --- one robot, by its black box ---
# What a run's black boxes tell, in the shape in which figures need it: series over time, one timeline for each robot
# and target.
#
# Times are seconds since the first step of any robot of the run, by the robots' own clocks.

Array = NDArray[np.float64]
UNKNOWN = (np.nan,) * 12  # of a posture without telemetry: sensors and pulses


class LoggedSweep(NamedTuple):
    """One sweep of the lens as the log has it: clarity at each position, and what the kernel made of it."""

    number: int
    target: str
    t_s: float
    lens_positions: list[int]
    clarity: list[float]
    outcome: SweepOutcome | None  # None: the recording ends before it, or is older than outcomes in the log

    @property
    def peak(self) -> float | None:
        """Lens position of the peak that the kernel found."""
        return self.outcome.lens_position if self.outcome is not None else None


class Belief(NamedTuple):
    """What a robot held after one iteration."""

    t: int
    t_s: float  # when it was shown first
    shown_s: float  # and last, with `state`: what that says of posture and faults is of then
    state: State
    cov_m2: Symmetric | None  # of the posterior; only what was said to neighbours has it


class Posture(NamedTuple):
    """Telemetry as arrays over n frames."""

    t_s: Array  # (n,)
    depth_m: Array  # (n,)
    roll_deg: Array  # (n,)
    pitch_deg: Array  # (n,)
    sensors_m: Array  # (n, 4), depth of each pressure sensor
    pulses_us: Array  # (n, 8)


class RobotTimeline(NamedTuple):
    """One robot and one of its targets, over all of the robot's starts in the run."""

    robot: str
    target: str
    label: str  # what figures call it
    boxes: tuple[BlackBox, ...]  # none: known by what the robot showed on the network
    starts_s: tuple[float, ...]
    ends_s: float
    states: tuple[tuple[float, State], ...]  # every one that was shown
    beliefs: tuple[Belief, ...]  # the last of each iteration
    sweeps: tuple[LoggedSweep, ...]
    posture: Posture
    set_depth_m: tuple[tuple[float, float], ...]  # (t_s, depth) where the set-point changed
    log: tuple[tuple[float, LogLine], ...]
    answers: tuple[tuple[float, Answer], ...]  # to what people ordered
    grants: tuple[tuple[float, Grant], ...] = ()  # who got camera, body and lamp, and when

    @property
    def held(self) -> list[tuple[Belief, Vector]]:
        """The beliefs that place the target, and where."""
        return [(belief, belief.state.posterior_m) for belief in self.beliefs if belief.state.posterior_m is not None]

    @property
    def estimate(self) -> tuple[Vector, Symmetric | None] | None:
        """The last posterior and its covariance."""
        held = self.held[-1:]
        return (held[0][1], held[0][0].cov_m2) if held else None

    @property
    def priors(self) -> list[tuple[int, Vector]]:
        """(iteration, x̂) of each measurement that went into an iteration."""
        return [(t, state.prior_m) for t, state in self.measured if state.prior_m is not None]

    @property
    def measured(self) -> list[tuple[int, State]]:
        """(iteration, state that shows it) of each measurement that went into an iteration."""
        found: list[tuple[int, State]] = []
        before: State | None = None
        for _, state in self.states:
            if before is None or state.incarnation != before.incarnation:
                used = 0  # measurements that went into iterations until then
            elif state.t != before.t:
                # What was measured before the iteration counts, not what came between it and this state.
                measured = before if before.measurements > used else state
                if state.knows == "sees" and measured.measurements > used and measured.prior_m is not None:
                    found.append((state.t, measured))
                    used = measured.measurements
            before = state
        return found


def first_ns(boxes: Sequence[BlackBox]) -> int | None:
    """Time of the first step of any robot; None without a step."""
    return min((step.now_ns for box in boxes for step in itertools.islice(box.steps(), 1)), default=None)


def timelines(boxes: Sequence[BlackBox]) -> list[RobotTimeline]:
    """The robots of one run, by name; of each its targets. Raises Refusal for steps of another version."""
    start_ns = first_ns(boxes) or 0
    robots = sorted({box.robot for box in boxes})
    return [
        timeline for name in robots for timeline in _timelines([box for box in boxes if box.robot == name], start_ns)
    ]


def _timelines(boxes: Sequence[BlackBox], start_ns: int) -> list[RobotTimeline]:
    gathered = _Gathered()
    for box in boxes:
        for step in box.steps():
            gathered.ends_s = t_s = (step.now_ns - start_ns) * 1e-9
            if step.number == 0:
                gathered.starts_s.append(t_s)
            gathered.take_in(decode(step.inputs, Inputs, limit=STEP_BYTES), start_ns)
            if step.outputs is not None:
                gathered.take_out(decode(step.outputs, Outputs, limit=STEP_BYTES), t_s)
        gathered.end_box()
    return gathered.timelines(boxes[0].robot, boxes[0].fleet, boxes)


def label(robot: str, target: str, fleet: Fleet) -> str:
    """The robot's name, and the target's where there are several."""
    return robot if len(fleet.target) == 1 else f"{robot}, {target}"


class Account:
    """What a robot shows of one target, as it comes."""

    def __init__(self) -> None:
        self.states: list[tuple[float, State]] = []
        self.beliefs: list[Belief] = []
        self._said: Estimate | None = None

    def say(self, estimate: Estimate) -> None:
        self._said = estimate

    def show(self, state: State, t_s: float) -> None:
        self.states.append((t_s, state))
        cov_m2 = self._said.cov_m2 if self._said is not None and self._said.x_m == state.posterior_m else None
        since_s = t_s
        if self.beliefs and self.beliefs[-1].t == state.t:
            before = self.beliefs.pop()
            since_s, cov_m2 = before.t_s, cov_m2 or before.cov_m2
        self.beliefs.append(Belief(state.t, since_s, t_s, state, cov_m2))


class _Gathered:
    """What one pass over a robot's steps leaves, or over what it showed on the network."""

    def __init__(self) -> None:
        self.starts_s: list[float] = []
        self.ends_s = 0.0
        self.log: list[tuple[float, LogLine]] = []
        self.answers: list[tuple[float, Answer]] = []
        self._grants: list[tuple[float, Grant]] = []
        self._sweeps: list[LoggedSweep] = []
        self._set_depth_m: list[tuple[float, float]] = []
        self._postures = array("d")  # 16 of each; hours of them are held at once
        self._swept: dict[tuple[str, int], list[tuple[float, Sighting]]] = {}  # by target and number, since the start
        self._outcomes: dict[tuple[str, int], SweepOutcome] = {}
        self._accounts: defaultdict[str, Account] = defaultdict(Account)
        self._newest: dict[int, State] = {}  # by incarnation, of what it showed on the network

    def timelines(self, robot: str, fleet: Fleet, boxes: Sequence[BlackBox] = ()) -> list[RobotTimeline]:
        """One for each target, in the order of the fleet file; an empty one where nothing was shown."""
        columns = np.array(self._postures).reshape(-1, 16)
        t_s, depth_m, roll_deg, pitch_deg = columns.T[:4]
        posture = Posture(t_s, depth_m, roll_deg, pitch_deg, columns[:, 4:8], columns[:, 8:16])
        return [
            RobotTimeline(
                robot=robot,
                target=target,
                label=label(robot, target, fleet),
                boxes=tuple(boxes),
                starts_s=tuple(self.starts_s),
                ends_s=self.ends_s,
                states=tuple(self._accounts[target].states),
                beliefs=tuple(self._accounts[target].beliefs),
                sweeps=tuple(sweep for sweep in self._sweeps if sweep.target == target),
                posture=posture,
                set_depth_m=tuple(self._set_depth_m),
                log=tuple(self.log),
                answers=tuple(self.answers),
                grants=tuple(self._grants),
            )
            for target in fleet.target
        ]

    def say(self, estimate: Estimate) -> None:
        self._accounts[estimate.target].say(estimate)

    def show(self, state: State, t_s: float) -> None:
        """What it showed on the network: of its posture depth and tilt alone."""
        if state.incarnation not in self._newest:
            self.starts_s.append(t_s)
        self._newest[state.incarnation] = state
        self._accounts[state.target].show(state, t_s)
        self.ends_s = t_s
        if state.depth_m is not None and state.roll_deg is not None and state.pitch_deg is not None:
            self._postures.extend((t_s, state.depth_m, state.roll_deg, state.pitch_deg, *UNKNOWN))

    def heard(self) -> Counter[str]:
        """Messages from each neighbour, by this robot's own count, over all of its starts."""
        total: Counter[str] = Counter()
        for state in self._newest.values():
            total.update({neighbour.robot: neighbour.heard for neighbour in state.neighbours})
        return total

    def take_in(self, inputs: Inputs, start_ns: int) -> None:
        for t in inputs.telemetry:
            t_s = (t.t_ns - start_ns) * 1e-9
            self._postures.extend((t_s, t.depth_m, t.roll_deg, t.pitch_deg, *t.sensor_depth_m, *t.pulses_us))
        for sighting in inputs.sightings:
            if sighting.sweep:
                frames = self._swept.setdefault((sighting.target, sighting.sweep), [])
                frames.append(((sighting.t_ns - start_ns) * 1e-9, sighting))

    def take_out(self, outputs: Outputs, t_s: float) -> None:
        self.log += [(t_s, line) for line in outputs.log]
        self.answers += [(t_s, answer) for answer in outputs.answers or ()]
        self._grants += [(t_s, grant) for grant in outputs.grants or ()]
        if not self._set_depth_m or self._set_depth_m[-1][1] != outputs.set_point.depth_m:
            self._set_depth_m.append((t_s, outputs.set_point.depth_m))
        for estimate in outputs.says:
            self.say(estimate)
        if outputs.state is not None:
            self._accounts[outputs.state.target].show(outputs.state, t_s)
        if outputs.outcome is not UNSET:
            self._outcomes[outputs.outcome.target, outputs.outcome.sweep] = outputs.outcome

    def end_box(self) -> None:
        """Call it at the end of a recording: the next start of the robot numbers its sweeps anew."""
        for (target, number), frames in self._swept.items():
            good = [(t_s, f.focus, f.clarity) for t_s, f in frames if f.focus is not None and f.clarity is not None]
            if good:
                times_s, lens_positions, clarity = (list(column) for column in zip(*good, strict=True))
                outcome = self._outcomes.get((target, number))
                self._sweeps.append(LoggedSweep(number, target, times_s[0], lens_positions, clarity, outcome))
        self._swept, self._outcomes = {}, {}


# --- a fleet, by its recorder ---


class FleetFile(NamedTuple):
    path: Path
    paths: tuple[Path, ...]  # this one, and those in which a recorder that was started again went on
    fleet: Fleet
    run: dict[str, str]  # the header
    complete: bool  # finished by its writer, nothing torn


class Overheard(NamedTuple):
    timelines: list[RobotTimeline]
    links: list[Link]  # as the robots count what they heard, of what the recorder saw
    start_ns: int | None  # since when times are counted; None: nobody showed anything


def open_fleet_file(path: Path) -> FleetFile:
    """Read the header of a recording of a fleet, or of the one in a folder. Raises ConfigError if it is no such, if
    there is none, or one of another version."""
    found = fleet_recordings(path) if path.is_dir() else [[path]]
    if not found:
        raise ConfigError(f"{path}: has no recording of a fleet in it; give the folder of a run, or what record wrote")
    opened = [_open_fleet_file(each) for each in found[0]]
    of_one_fleet(opened)
    return opened[0]._replace(paths=tuple(found[0]), complete=all(each.complete for each in opened))


def _open_fleet_file(path: Path) -> FleetFile:
    heads = [head(file) for file in parts(path)]
    run, text = heads[0].run, heads[0].attachments.get("fleet.toml")
    if run.get("kind") != "fleet" or text is None:
        raise ConfigError(f"{other_kind(path, run, 'recording of a fleet')}; give what `aucamp record` wrote")
    schema_of(path, run)
    fleet = attached_toml(path, "fleet.toml", heads[0].attachments, Fleet)
    return FleetFile(path, (path,), fleet, run, all(each.complete for each in heads))


def of_one_fleet(opened: Sequence[BlackBox | FleetFile]) -> None:
    """Raises ConfigError for recordings that are not of one fleet: what they say does not belong together."""
    for each in opened[1:]:
        if common(each.fleet) != common(opened[0].fleet):
            name, other = each.fleet.fleet, opened[0].fleet.fleet
            what = f"is of the fleet '{name}', not '{other}'" if name != other else "was made with another fleet file"
            raise ConfigError(f"{each.path}: {what} as {opened[0].path}; move one away, or give one of them alone")


def overheard(file: FleetFile, start_ns: int | None = None, known: Container[str] = ()) -> Overheard:
    """The robots of a fleet file by name, those in `known` left out. Times are by the robots' own clocks, since
    `start_ns`, or since the first state of any of them; lines of a log may be older. What does not decode is passed
    over.
    """
    robots = {name: _Gathered() for name in file.fleet.robot}
    asides: list[tuple[_Gathered, LogLine | Answer]] = []
    said: dict[tuple[str, str], set[tuple[int, int]]] = {}
    for _, topic, chunks, message in said_in(file.paths):
        robot = robots.get(chunks[topic.writer])
        if robot is None:
            continue
        if isinstance(message, Estimate):
            said.setdefault((message.src, message.dst), set()).add((message.incarnation, message.seq))
            robot.say(message)
        elif isinstance(message, State):
            start_ns = message.sent_ns if start_ns is None else start_ns
            robot.show(message, (message.sent_ns - start_ns) * 1e-9)
        elif isinstance(message, LogLine | Answer):
            asides.append((robot, message))
    if start_ns is None:  # no robot came as far as its first step; why may stand in its log
        start_ns = min((message.sent_ns for _, message in asides), default=None)
    for robot, message in asides:
        t_s = (message.sent_ns - (start_ns or 0)) * 1e-9
        if isinstance(message, Answer):
            robot.answers.append((t_s, message))
            continue
        robot.log.append((t_s, message))
        if not robot.starts_s:
            robot.ends_s = max(robot.ends_s, t_s)
    found = [
        timeline
        for name, robot in robots.items()
        if name not in known and (robot.starts_s or robot.log)  # else it was never up
        for timeline in robot.timelines(name, file.fleet)
    ]
    heard = {(src, dst): n for dst, robot in robots.items() for src, n in robot.heard().items()}
    pairs = sorted({*said, *(pair for pair, n in heard.items() if n)})
    links = [Link(*pair, len(said.get(pair, ())), heard.get(pair, 0), 0, 0) for pair in pairs]
    return Overheard(found, links, start_ns)


# --- a run ---
# What there is of one run, gathered for its report: black boxes, the fleet file, and what a twin knows.


class Run(NamedTuple):
    path: Path
    fleet: Fleet
    boxes: list[BlackBox]
    fleet_file: FleetFile | None  # only where some robot left no black box
    timelines: list[RobotTimeline]  # by robot and target
    links: list[Link]
    summary: dict[str, Any] | None  # what the demo found
    truths_m: dict[str, Vector]  # by target, where a twin knows it
    start_ns: int | None  # since when times are counted: the first step of any robot
    clock: list[Moment]  # of a dive in the twin, how fast its clock went

    @property
    def robots(self) -> list[RobotTimeline]:
        """One timeline for each robot: what is not about a target is the same in all."""
        return list({timeline.robot: timeline for timeline in reversed(self.timelines)}.values())[::-1]

    @property
    def left_out(self) -> list[str]:
        """What of its recordings is not read, a line each."""
        of_fleet = [left_out(path) for path in self.fleet_file.paths] if self.fleet_file else []
        return [*(line for box in self.boxes for line in box.left_out), *(line for line in of_fleet if line)]

    def about(self, target: str) -> list[RobotTimeline]:
        return [timeline for timeline in self.timelines if timeline.target == target]


def open_run(path: Path) -> Run:
    """A run's folder, or one recording of either kind. What robots without a black box said comes from the fleet file.

    Raises ConfigError if there is nothing to show, or if a recording cannot be read by this version.
    """
    summary, told = _summary(path) or (None, None)
    boxes, fleet_path = _recordings(path)
    if not boxes and summary is None and fleet_path is None:
        raise ConfigError(f"{path}: no recording and no summary.json; give the folder of a run, or a recording")
    start_ns = first_ns(boxes)
    drawn, heard, file = timelines(boxes), links(boxes), None
    known = {box.robot for box in boxes}
    if fleet_path is not None and (not boxes or known != set(boxes[0].fleet.robot)):
        file = open_fleet_file(fleet_path)
    of_one_fleet([*boxes, *([file] if file is not None else [])])
    if file is not None:
        more = overheard(file, start_ns, known)
        start_ns = more.start_ns
        drawn = sorted([*drawn, *more.timelines], key=lambda timeline: timeline.robot)
        heard = _joined(heard, more, known)
    fleet = boxes[0].fleet if boxes else file.fleet if file else load_fleet(path / "fleet.toml")
    clock, lines = _beside_steps([*(box.path for box in boxes), *(file.paths if file else ())])
    drawn = [_with_lines(timeline, lines[timeline.robot], start_ns or 0) for timeline in drawn]
    if told is not None:
        _refuse_another(path / "summary.json", told, boxes, drawn)
    return Run(path, fleet, boxes, file, drawn, heard, summary, _truths(told, fleet), start_ns, clock)


def _recordings(path: Path) -> tuple[list[BlackBox], Path | None]:
    if path.is_dir():
        return open_boxes(black_boxes(path)), path if recordings(path, "fleet") else None
    if head(parts(path)[0]).run.get("kind") == "fleet":
        return [], path
    return open_boxes([path]), None


def _beside_steps(paths: Iterable[Path]) -> tuple[list[Moment], dict[str, list[LogLine]]]:
    """What all these recordings hold beside steps: notes of one clock, and by robot lines that no step said."""
    notes, lines = list[Moment | None](), defaultdict[str, list[LogLine]](list)
    for record in itertools.chain.from_iterable(map(read, paths)):
        if record.channel == CLOCK.name:
            notes.append(moment(record.log_time_ns, record.data))
        elif record.channel == LINES.name:
            line = decode(record.data, LogLine, accepted=READABLE)
            lines[line.robot].append(line)
    return in_dive(each for each in notes if each is not None), lines


def _with_lines(timeline: RobotTimeline, lines: Iterable[LogLine], start_ns: int) -> RobotTimeline:
    told = [((line.sent_ns - start_ns) * 1e-9, line) for line in lines]
    return timeline._replace(log=tuple(sorted([*timeline.log, *told], key=lambda each: each[0])))


def _joined(heard: Sequence[Link], more: Overheard, known: set[str]) -> list[Link]:
    """Links by black boxes where both ends left one, by the fleet file where not."""
    between = [link for link in heard if link.src in known and link.dst in known]
    return sorted([*between, *(link for link in more.links if not {link.src, link.dst} <= known)])


class _Ended(msgspec.Struct):
    """Of a target in summary.json."""

    swims: bool = False
    truth_m: Vector | None = None


class _Summary(msgspec.Struct):
    """What is read of summary.json by name."""

    incarnations: dict[str, list[int]] | None = None  # that were heard, by robot; None: of an older demo

    truth_m: Vector | None = None  # of the first target, in older summaries
    targets: dict[str, _Ended] | None = None
    agents: dict[str, dict[str, Any]] = {}
    verdict: str = ""
    reasons: list[str] = []


def _summary(run: Path) -> tuple[dict[str, Any], _Summary] | None:
    """What the demo found, and of it what is read by name; None for a run without one."""
    path = run / "summary.json"
    if not path.exists():
        return None
    try:
        text = read_text(path, "repair it")
        check_depth(text, path)
        summary: dict[str, Any] = json.loads(text)
    except ValueError:
        raise ConfigError(f"{run}: no usable summary.json; repair it, or remove it to do without the truth") from None
    return summary, convert(summary, _Summary, path)


def _refuse_another(path: Path, told: _Summary, boxes: Iterable[BlackBox], drawn: Iterable[RobotTimeline]) -> None:
    """Raises ConfigError for a summary of another dive than the recordings beside it."""
    ours = {(box.robot, box.incarnation) for box in boxes}
    ours |= {(timeline.robot, state.incarnation) for timeline in drawn for _, state in timeline.states}
    for robot, heard in (told.incarnations or {}).items():
        if heard and robot in dict(ours) and ours.isdisjoint((robot, each) for each in heard):
            raise ConfigError(f"{path}: is of another dive than the recordings of {robot} beside it; move it away")


def _truths(told: _Summary | None, fleet: Fleet) -> dict[str, Vector]:
    if told is None:
        return {}
    ended = {next(iter(fleet.target)): _Ended(truth_m=told.truth_m)} if told.targets is None else told.targets
    return {target: one.truth_m for target, one in ended.items() if not one.swims and one.truth_m is not None}


# --- a survey ---
# What the robots of a survey said of it: how much each knew when, and what they measured.


class Known(NamedTuple):
    """What one robot said once."""

    t_ns: int
    share: float  # of the wanted cells that its map knows
    held: int  # keyframes
    digest: str


class Surveyed(NamedTuple):
    known: dict[str, list[Known]]  # by robot
    frames: list[tuple[int, Frame]]  # that were told, by when they first were
    paths: dict[str, list[tuple[float, float]]]  # where each believed to be, m, world frame; empty: it is moored
    all: CoverageMap  # of all frames


def surveyed(run: Run) -> Surveyed | None:
    """None: of a fleet without [coverage], or whose robots said nothing of a survey."""
    if run.fleet.coverage is None:
        return None
    known: dict[str, list[Known]] = {timeline.robot: [] for timeline in run.robots}
    frames: dict[tuple[str, int, int], tuple[int, Frame]] = {}
    for robot, said in _said_of_survey(run):
        if isinstance(said, Keyframe):
            frame = said.frame
            if frame.origin not in run.fleet.robot or frame_fault(frame, run.fleet.tank.size_m) is not None:
                continue  # no robot believed it
            frames.setdefault((frame.origin, frame.incarnation, frame.number), (said.sent_ns, frame))
        elif said.sent_ns != (rows[-1].t_ns if (rows := known.setdefault(robot, [])) else None):  # to each neighbour
            rows.append(Known(said.sent_ns, said.share, holds(said)[1], said.digest))
    if not frames and not any(known.values()):
        return None
    ats = {each.robot: [state.whereabouts for _, state in each.states] for each in run.robots}
    paths = {robot: [(at.x_m, at.y_m) for at in found if at] for robot, found in ats.items()}
    together = CoverageMap(grid_of(run.fleet))
    told = sorted(frames.values(), key=lambda each: each[0])
    for _, frame in told:
        together.add(frame)
    together.let_go()
    return Surveyed(known, told, paths, together)


def _said_of_survey(run: Run) -> Iterator[tuple[str, Claim | Keyframe]]:
    """By whom. What a robot's own black box lacks is in the fleet file, or in what another robot heard from it."""
    for box in run.boxes:
        keys: Mapping[str, bytes] = {}
        for step in box.steps():
            inputs = decode(step.inputs, Inputs, STEP_BYTES)
            keys = keys if inputs.keys is UNSET else inputs.keys
            heard = (each for each in inputs.heard if each.topic == KEYFRAME.name)
            yield from ((each.src, said) for each in heard if (said := _own_keyframe(each, keys)) is not None)
            if step.outputs is not None:
                outputs = decode(step.outputs, Outputs, STEP_BYTES)
                yield from ((box.robot, said) for row in (CLAIM, KEYFRAME) for said in outputs.said(row))
    boxed = {box.robot for box in run.boxes}  # their claims are told
    for _, topic, chunks, message in said_in(run.fleet_file.paths, (CLAIM, KEYFRAME)) if run.fleet_file else ():
        if topic is KEYFRAME or chunks[topic.writer] not in boxed:
            yield chunks[topic.writer], message


def _own_keyframe(heard: Heard, keys: Mapping[str, bytes]) -> Keyframe | None:
    """None: it does not decode, or its origin did not say it."""
    try:
        said = decode(heard.payload, Keyframe, KEYFRAME.limit, READABLE)
    except Refusal:
        return None
    key, signed = keys.get(heard.src, b""), keyframe_bytes(said.fleet, said.frame)
    genuine = not keys or verify_signature(key, said.signature or b"", signed)
    return said if genuine and said.frame.origin == heard.src else None
