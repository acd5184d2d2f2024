"""What a run's black boxes tell, in the shape in which figures need it: series over time.

There is one story for each robot, about one target.

Times are seconds since the first step of any robot of the run, by the robots' own clocks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.messages import Estimate, Inputs, LogLine, Outputs, Sighting, State, Symmetric, Vector, decode
from agent.ranging.focus import Peak, Refused, fit_peak
from replay.blackbox import STEP_BYTES, BlackBox, Step

Array = NDArray[np.float64]


class Sweep(NamedTuple):
    """One sweep of the lens: clarity at each position, and the peak if there is one."""

    number: int
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
    """One robot over all of its starts in the run."""

    robot: str
    target: str
    boxes: tuple[BlackBox, ...]
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


def stories(boxes: Sequence[BlackBox], target: str | None = None) -> list[Story]:
    """The robots of one run, by name, and what they know of a target; of the fleet's first one if not given.

    Raises Refusal for steps of another version.
    """
    firsts = [step.now_ns for box in boxes for step in _first(box.steps())]
    start_ns = min(firsts, default=0)
    robots = sorted({box.robot for box in boxes})
    targets = boxes[0].fleet.target if boxes else {}
    target = target or next(iter(targets), "")
    others = tuple(f"{name}: " for name in targets if name != target)  # how lines of the log about these begin
    return [_story([box for box in boxes if box.robot == robot], start_ns, target, others) for robot in robots]


def _first(steps: Iterable[Step]) -> list[Step]:
    return [step for _, step in zip(range(1), steps, strict=False)]


def _story(boxes: Sequence[BlackBox], start_ns: int, target: str, others: tuple[str, ...]) -> Story:
    collected = _Collected(target)
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
    return Story(
        robot=boxes[0].robot,
        target=target,
        boxes=tuple(boxes),
        starts_s=tuple(starts),
        ends_s=t_s,
        states=tuple(collected.states),
        beliefs=tuple(collected.beliefs),
        sweeps=tuple(collected.sweeps),
        posture=collected.posture(),
        set_depth_m=tuple(collected.set_depth_m),
        log=tuple((t_s, line) for t_s, line in collected.log if not line.text.startswith(others)),
    )


class _Collected:
    """What one pass over a robot's steps leaves."""

    def __init__(self, target: str) -> None:
        self._target = target
        self.states: list[tuple[float, State]] = []
        self.beliefs: list[Belief] = []
        self.sweeps: list[Sweep] = []
        self.set_depth_m: list[tuple[float, float]] = []
        self.log: list[tuple[float, LogLine]] = []
        self._telemetry: list[tuple[float, ...]] = []
        self._frames: list[tuple[float, Sighting]] = []  # of the sweep that is under way
        self._ended: list[list[tuple[float, Sighting]]] = []
        self._said: Estimate | None = None

    def take_in(self, inputs: Inputs, start_ns: int) -> None:
        for t in inputs.telemetry:
            t_s = (t.t_ns - start_ns) * 1e-9
            self._telemetry.append((t_s, t.depth_m, t.roll_deg, t.pitch_deg, *t.sensor_depth_m, *t.pulses_us))
        for sighting in (s for s in inputs.sightings if s.target == self._target):
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
            if estimate.target == self._target:
                self._said = estimate
        if (state := outputs.state) is None or state.target != self._target:
            return
        self.states.append((t_s, state))
        cov_m2 = self._said.cov_m2 if self._said is not None and self._said.x_m == state.posterior_m else None
        if self.beliefs and self.beliefs[-1].t == state.t:
            cov_m2 = cov_m2 or self.beliefs[-1].cov_m2
            self.beliefs[-1] = Belief(state.t, self.beliefs[-1].t_s, state, cov_m2)
        else:
            self.beliefs.append(Belief(state.t, t_s, state, cov_m2))

    def end_sweep(self, box: BlackBox) -> None:
        """At the end of a recording: fit the peaks of its sweeps, with the width that its calibration found."""
        fit, full = box.calibration.focus, box.fleet.camera.sweep_steps
        for frames in [*self._ended, self._frames] if self._frames else self._ended:
            good = [(t_s, f.focus, f.clarity) for t_s, f in frames if f.focus is not None and f.clarity is not None]
            if good:
                focus, clarity = [float(rho) for _, rho, _ in good], [float(value) for _, _, value in good]
                width = None if len(frames) >= full else fit.width
                peak = fit_peak(focus, clarity, width)
                self.sweeps.append(Sweep(frames[0][1].sweep, good[0][0], focus, clarity, peak))
        self._ended, self._frames = [], []

    def posture(self) -> Posture:
        rows = np.array(self._telemetry, float).reshape(-1, 16)
        return Posture(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3], rows[:, 4:8], rows[:, 8:16])
