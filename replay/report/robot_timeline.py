"""What a run's black boxes tell, in the shape in which figures need it: series over time, one timeline for each robot
and target.

Times are seconds since the first step of any robot of the run, by the robots' own clocks.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from agent.core.codec import decode
from agent.core.config import Fleet
from agent.core.messages import Answer, Estimate, LogLine, State, Symmetric, Vector
from agent.core.step_io import Inputs, Outputs, Sighting, SweepOutcome
from replay.check.black_box import STEP_BYTES, BlackBox

Array = NDArray[np.float64]


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
    t_s: float
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

    @property
    def estimate(self) -> tuple[Vector, Symmetric | None] | None:
        """The last posterior and its covariance."""
        held = [belief for belief in self.beliefs if belief.state.posterior_m is not None]
        return (held[-1].state.posterior_m, held[-1].cov_m2) if held and held[-1].state.posterior_m else None

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
    collected = _Collected()
    starts = []
    t_s = 0.0
    for box in boxes:
        for step in box.steps():
            t_s = (step.now_ns - start_ns) * 1e-9
            if step.number == 0:
                starts.append(t_s)
            inputs = decode(step.inputs, Inputs, limit=STEP_BYTES)
            collected.take_in(inputs, start_ns)
            if step.outputs is not None:
                collected.take_out(decode(step.outputs, Outputs, limit=STEP_BYTES), t_s)
        collected.end_box()
    posture = collected.posture()
    return [
        RobotTimeline(
            robot=boxes[0].robot,
            target=target,
            label=label(boxes[0].robot, target, boxes[0].fleet),
            boxes=tuple(boxes),
            starts_s=tuple(starts),
            ends_s=t_s,
            states=tuple(account.states),
            beliefs=tuple(account.beliefs),
            sweeps=tuple(sweep for sweep in collected.sweeps if sweep.target == target),
            posture=posture,
            set_depth_m=tuple(collected.set_depth_m),
            log=tuple(collected.log),
            answers=tuple(collected.answers),
        )
        for target, account in collected.accounts(boxes[0].fleet).items()
    ]


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
        if self.beliefs and self.beliefs[-1].t == state.t:
            cov_m2 = cov_m2 or self.beliefs[-1].cov_m2
            self.beliefs[-1] = Belief(state.t, self.beliefs[-1].t_s, state, cov_m2)
        else:
            self.beliefs.append(Belief(state.t, t_s, state, cov_m2))


class _Collected:
    """What one pass over a robot's steps leaves."""

    def __init__(self) -> None:
        self.sweeps: list[LoggedSweep] = []
        self.set_depth_m: list[tuple[float, float]] = []
        self.log: list[tuple[float, LogLine]] = []
        self.answers: list[tuple[float, Answer]] = []
        self._telemetry: list[tuple[float, ...]] = []
        self._swept: dict[tuple[str, int], list[tuple[float, Sighting]]] = {}  # by target and number, since the start
        self._outcomes: dict[tuple[str, int], SweepOutcome] = {}
        self._accounts: defaultdict[str, Account] = defaultdict(Account)

    def accounts(self, fleet: Fleet) -> dict[str, Account]:
        """The accounts by target, in the order of the fleet file; an empty one where nothing was shown."""
        return {target: self._accounts[target] for target in fleet.target}

    def take_in(self, inputs: Inputs, start_ns: int) -> None:
        for t in inputs.telemetry:
            t_s = (t.t_ns - start_ns) * 1e-9
            self._telemetry.append((t_s, t.depth_m, t.roll_deg, t.pitch_deg, *t.sensor_depth_m, *t.pulses_us))
        for sighting in inputs.sightings:
            if sighting.sweep:
                frames = self._swept.setdefault((sighting.target, sighting.sweep), [])
                frames.append(((sighting.t_ns - start_ns) * 1e-9, sighting))

    def take_out(self, outputs: Outputs, t_s: float) -> None:
        self.log += [(t_s, line) for line in outputs.log]
        self.answers += [(t_s, answer) for answer in outputs.answers or ()]
        if not self.set_depth_m or self.set_depth_m[-1][1] != outputs.set_point.depth_m:
            self.set_depth_m.append((t_s, outputs.set_point.depth_m))
        for estimate in outputs.says:
            self._accounts[estimate.target].say(estimate)
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
                self.sweeps.append(LoggedSweep(number, target, times_s[0], lens_positions, clarity, outcome))
        self._swept, self._outcomes = {}, {}

    def posture(self) -> Posture:
        rows = np.array(self._telemetry, float).reshape(-1, 16)
        return Posture(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3], rows[:, 4:8], rows[:, 8:16])
