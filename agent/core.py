"""Agent.step: the order of work and nothing else. No clock, no random numbers, no thread, no I/O.

The same inputs at the same times give the same bytes, which is what replay relies on.
"""

from __future__ import annotations

from agent.config import Fleet
from agent.control.attitude import AttitudeLog
from agent.control.seek import Seek
from agent.control.sweep import Measurement, Rejected
from agent.estimation.choice import estimator
from agent.estimation.face import Estimator, Prior, Update
from agent.estimation.mailbox import Mailbox
from agent.hearing import Hearing
from agent.messages import Estimate, Inputs, Outputs, SetPoint, State, SweepPlan
from agent.ranging.calibration import Calibration
from agent.ranging.fix import locate
from agent.ranging.focus import Refused
from agent.status import Status, inside

STATE_NS = 200_000_000  # 5 Hz to whoever looks
LATEST_ITERATION = 1.6  # an iteration waits for a running sweep, but no longer than this many of its periods


class Agent:
    """One robot's mind: what it knows between steps."""

    def __init__(self, fleet: Fleet, name: str, calibration: Calibration, incarnation: int) -> None:
        robot = fleet.robot[name]
        (self._target, self._ball), *_ = fleet.target.items()
        self._fleet, self._name, self._robot = fleet, name, robot
        self._calibration, self._incarnation = calibration, incarnation
        self._validity_ns = round(fleet.estimation.validity_s * 1e9)
        self._iteration_ns = round(fleet.estimation.iteration_s * 1e9)
        self._say_ns = round(1e9 / fleet.link.send_hz)

        self.mailbox = Mailbox(fleet.fleet, name, self._target, robot.neighbours)
        self.estimator: Estimator = estimator(fleet, name, self._target, incarnation)
        self.seek = Seek(fleet, robot, calibration)
        self.attitude = AttitudeLog()
        self.hearing = Hearing(self.mailbox, self.estimator, fleet.tank)
        self.status = Status(fleet.fleet, name, self._target, incarnation)

        self.prior: Prior | None = None  # measured since the last iteration
        self.update: Update | None = None
        self.last_state: State | None = None
        self._iterated_ns = self._say_due_ns = self._state_due_ns = 0
        self._said = 0

    def step(self, inputs: Inputs, now_ns: int) -> Outputs:
        """Take in all that arrived since the last step, decide, and say what to do and to send.

        `now_ns` never decreases and is later than every time stamp in `inputs`.
        """
        if self._iterated_ns == 0:
            self._iterated_ns = now_ns
            self.status.start(now_ns)
        self.hearing.take(inputs.heard, inputs.refused, self.status, now_ns)
        for telemetry in inputs.telemetry:
            self.attitude.add(telemetry)
            self.seek.sweep.telemetry(telemetry)
        for sighting in inputs.sightings:
            self.seek.watch(sighting)
        self.status.devices(inputs, self.attitude, now_ns)
        self._measure(now_ns)
        self._iterate(now_ns)
        sweep = self._act(now_ns)
        says = self._say(now_ns)
        state = self._state(now_ns)
        return Outputs(set_point=self._set_point(now_ns), sweep=sweep, says=says, state=state, log=self.status.lines())

    def _measure(self, now_ns: int) -> None:
        """A finished sweep becomes a prior: where the sharpest frame saw the target, in the world."""
        result = self.seek.finish(now_ns)
        if isinstance(result, Rejected):
            self.status.note("info", f"sweep rejected: {result.reason}", now_ns)
        if not isinstance(result, Measurement):
            return
        level = self.attitude.at(result.t_ns)
        if level is None:
            self.status.note("warning", "sweep rejected: no telemetry at the time of its sharpest frame", now_ns)
            return
        eye, cues = self.seek.eye(level), self._fleet.ranging.cues
        fix = locate(self._calibration, eye, result.outline, result.focus, result.sigma, self._ball, cues)
        if isinstance(fix, Refused):
            self.status.note("warning", f"sweep rejected: {fix.reason}", now_ns)
            return
        if not inside(fix.position_m, self._fleet.tank):
            self.status.note("warning", f"sweep rejected: peak at {result.focus:.0f} is outside the tank", now_ns)
            return
        self.prior = Prior(fix.position_m, fix.random_m2, result.t_ns, fix.systematic_m2)
        self.status.measured(self.prior)

    def _iterate(self, now_ns: int) -> None:
        """One iteration of the protocol each period; a sweep that is nearly done is waited for."""
        elapsed_ns = now_ns - self._iterated_ns
        waiting = self.prior is None and self.seek.sweep.running and elapsed_ns < LATEST_ITERATION * self._iteration_ns
        if elapsed_ns < self._iteration_ns or waiting:
            return
        self._iterated_ns = now_ns
        self.estimator.adopt(self.mailbox.newest_t(now_ns, self._validity_ns))
        self.update = self.estimator.tick(self.prior, self.mailbox, now_ns)
        self.status.iterated(self.estimator, self.update, now_ns)
        self.prior = None

    def _act(self, now_ns: int) -> SweepPlan | None:
        """Gimbal and lens."""
        newest = self.attitude.newest
        level = None if newest is None or self.attitude.silent(now_ns, 0) else self.attitude.at(newest.t_ns)
        believed = self.estimator.posterior
        return self.seek.act(now_ns, level, believed.x_m if believed else None, wanted=self.prior is None)

    def _say(self, now_ns: int) -> tuple[Estimate, ...]:
        """What the protocol has for each neighbour; without news it is still the heartbeat."""
        if now_ns < self._say_due_ns:
            return ()
        self._say_due_ns = next_due_ns(self._say_due_ns, self._say_ns, now_ns)
        self._said += 1
        return tuple(
            Estimate(
                fleet=self._fleet.fleet,
                src=self._name,
                dst=neighbour,
                incarnation=self._incarnation,
                seq=self._said,
                sent_ns=now_ns,
                target=self._target,
                t=self.estimator.t,
                valid=self.estimator.valid,
                **self.estimator.say(neighbour, now_ns)._asdict(),
            )
            for neighbour in self._robot.neighbours
        )

    def _state(self, now_ns: int) -> State | None:
        if now_ns < self._state_due_ns:
            return None
        self._state_due_ns = next_due_ns(self._state_due_ns, STATE_NS, now_ns)
        self.last_state = self.status.state(
            self.estimator,
            self.update,
            self.mailbox,
            self.hearing.refused,
            self.attitude,
            self.seek.gimbal_deg(),
            now_ns,
        )
        return self.last_state

    def _set_point(self, now_ns: int) -> SetPoint:
        pan_us, tilt_us = self.seek.pointing.servos_us(now_ns)
        centre_us = round(self._fleet.body.servo_centre_us)
        return SetPoint(depth_m=self._robot.depth_m, servos_us=(pan_us, tilt_us, centre_us, centre_us))


def next_due_ns(due_ns: int, period_ns: int, now_ns: int) -> int:
    """The next time on a period's grid, so that steps that come a little late do not lower the rate; a grid that is
    more than a period behind starts anew."""
    return due_ns + period_ns if now_ns - due_ns < period_ns else now_ns + period_ns
