"""What a run's black boxes tell, in the shape in which figures need it: series over time, one story for each robot
and target.

Times are seconds since the first step of any robot of the run, by the robots' own clocks.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.config import Fleet
from agent.messages import Estimate, Inputs, LogLine, Outputs, Sighting, State, Symmetric, Vector, decode
from agent.ranging.focus import Peak, Refused, fit_peak
from replay.blackbox import STEP_BYTES, BlackBox

Array = NDArray[np.float64]


class Sweep(NamedTuple):
    """One sweep of the lens: clarity at each position, and the peak if there is one."""

    number: int
    target: str
    t_s: float
    focus: list[float]
    clarity: list[float]
    peak: Peak | Refused


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


class Story(NamedTuple):
    """One robot and one of its targets, over all of the robot's starts in the run."""

    robot: str
    target: str
    label: str  # what figures call it
    boxes: tuple[BlackBox, ...]  # none: told by what the robot showed on the network
    starts_s: tuple[float, ...]
    ends_s: float
    states: tuple[tuple[float, State], ...]  # every one that was shown
    beliefs: tuple[Belief, ...]  # the last of each iteration
    sweeps: tuple[Sweep, ...]
    posture: Posture
    set_depth_m: tuple[tuple[float, float], ...]  # (t_s, depth) where the set-point changed
    log: tuple[tuple[float, LogLine], ...]

    @property
    def estimate(self) -> tuple[Vector, Symmetric | None] | None:
        """The last posterior and its covariance."""
        held = [belief for belief in self.beliefs if belief.state.posterior_m is not None]
        return (held[-1].state.posterior_m, held[-1].cov_m2) if held and held[-1].state.posterior_m else None

    @property
    def priors(self) -> list[tuple[int, Vector]]:
        """(iteration, x̂) of each measurement that went into an iteration."""
        found: list[tuple[int, Vector]] = []
        before: State | None = None
        for _, state in self.states:
            if before is None or state.incarnation != before.incarnation:
                used = 0  # measurements that went into iterations until then
            elif state.t != before.t:
                # What was measured before the iteration counts, not what came between it and this state.
                measured = before if before.measurements > used else state
                if state.knows == "sees" and measured.measurements > used and measured.prior_m is not None:
                    found.append((state.t, measured.prior_m))
                    used = measured.measurements
            before = state
        return found


def first_ns(boxes: Sequence[BlackBox]) -> int | None:
    """Time of the first step of any robot; None without a step."""
    return min((step.now_ns for box in boxes for step in itertools.islice(box.steps(), 1)), default=None)


def stories(boxes: Sequence[BlackBox]) -> list[Story]:
    """The robots of one run, by name; of each its targets. Raises Refusal for steps of another version."""
    start_ns = first_ns(boxes) or 0
    robots = sorted({box.robot for box in boxes})
    return [story for name in robots for story in _stories([box for box in boxes if box.robot == name], start_ns)]


def _stories(boxes: Sequence[BlackBox], start_ns: int) -> list[Story]:
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
        collected.end_sweep(box)
    posture = collected.posture()
    return [
        Story(
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
        self.sweeps: list[Sweep] = []
        self.set_depth_m: list[tuple[float, float]] = []
        self.log: list[tuple[float, LogLine]] = []
        self._telemetry: list[tuple[float, ...]] = []
        self._frames: list[tuple[float, Sighting]] = []  # of the sweep that is under way
        self._ended: list[list[tuple[float, Sighting]]] = []
        self._accounts: defaultdict[str, Account] = defaultdict(Account)

    def accounts(self, fleet: Fleet) -> dict[str, Account]:
        """By target, in the order of the fleet file; one that says nothing where nothing was shown."""
        return {target: self._accounts[target] for target in fleet.target}

    def take_in(self, inputs: Inputs, start_ns: int) -> None:
        for t in inputs.telemetry:
            t_s = (t.t_ns - start_ns) * 1e-9
            self._telemetry.append((t_s, t.depth_m, t.roll_deg, t.pitch_deg, *t.sensor_depth_m, *t.pulses_us))
        for sighting in inputs.sightings:
            if self._frames and sighting.sweep != self._frames[-1][1].sweep:
                self._ended.append(self._frames)
                self._frames = []
            if sighting.sweep:
                self._frames.append(((sighting.t_ns - start_ns) * 1e-9, sighting))

    def take_out(self, outputs: Outputs, t_s: float) -> None:
        self.log += [(t_s, line) for line in outputs.log]
        if not self.set_depth_m or self.set_depth_m[-1][1] != outputs.set_point.depth_m:
            self.set_depth_m.append((t_s, outputs.set_point.depth_m))
        for estimate in outputs.says:
            self._accounts[estimate.target].say(estimate)
        if outputs.state is not None:
            self._accounts[outputs.state.target].show(outputs.state, t_s)

    def end_sweep(self, box: BlackBox) -> None:
        """At the end of a recording: fit the peaks of its sweeps, with the width that its calibration found."""
        fit, full = box.calibration.focus, box.fleet.camera.sweep_steps
        for frames in [*self._ended, self._frames] if self._frames else self._ended:
            good = [(t_s, f.focus, f.clarity) for t_s, f in frames if f.focus is not None and f.clarity is not None]
            if good:
                focus, clarity = [float(rho) for _, rho, _ in good], [float(value) for _, _, value in good]
                width = None if len(frames) >= full else fit.width
                peak = fit_peak(focus, clarity, width)
                first = frames[0][1]
                self.sweeps.append(Sweep(first.sweep, first.target, good[0][0], focus, clarity, peak))
        self._ended, self._frames = [], []

    def posture(self) -> Posture:
        rows = np.array(self._telemetry, float).reshape(-1, 16)
        return Posture(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3], rows[:, 4:8], rows[:, 8:16])
