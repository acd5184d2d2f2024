"""What the robot shows of itself: its public state, one message for each target, and its faults."""

from __future__ import annotations

import math

from agent.control.attitude import AttitudeLog
from agent.estimation.mailbox import Mailbox
from agent.logbook import Logbook
from agent.messages import Inputs, NeighbourState, State, Symmetric
from agent.pursuit import Pursuit

NO_FRAMES_NS = 700_000_000  # nearly three frames of the slowest rate at which vision looks


class Status:
    """Keeps what only observers need: nothing here is read back by the control of the robot."""

    def __init__(self, fleet: str, robot: str, incarnation: int) -> None:
        self._fleet, self._robot, self._incarnation = fleet, robot, incarnation
        self.log = Logbook(robot)
        self._started_ns = 0
        self._frame_ns: int | None = None
        self._focus: int | None = None
        self._faults: tuple[str, ...] = ()

    def start(self, now_ns: int) -> None:
        self._started_ns = now_ns

    def devices(self, inputs: Inputs, attitude: AttitudeLog, now_ns: int) -> None:
        """Notice devices that fell silent and devices that came back."""
        for sighting in inputs.sightings:
            self._frame_ns = now_ns
            self._focus = sighting.focus if sighting.focus is not None else self._focus
        faults = []
        if now_ns - (self._frame_ns or self._started_ns) > NO_FRAMES_NS:
            faults.append("no frames")
        if attitude.silent(now_ns, self._started_ns):
            faults.append("no telemetry")
        elif attitude.newest is not None and attitude.newest.ladder > 0:
            faults.append(f"failsafe level {attitude.newest.ladder}")
        for fault in faults:
            if fault not in self._faults:
                self.log.note("warning", fault, now_ns)
        for fault in self._faults:
            if fault not in faults:
                self.log.note("info", f"over: {fault}", now_ns)
        self._faults = tuple(faults)

    def state(
        self,
        pursuit: Pursuit,
        refused: dict[str, int],
        attitude: AttitudeLog,
        gimbal_deg: tuple[float, float],
        now_ns: int,
    ) -> State:
        """The public state at this moment, about one of the targets."""
        telemetry, estimator, update, prior = attitude.newest, pursuit.estimator, pursuit.update, pursuit.measured
        posterior, used = estimator.posterior, update.used if update else ()
        return State(
            fleet=self._fleet,
            robot=self._robot,
            incarnation=self._incarnation,
            seq=pursuit.last_state.seq + 1 if pursuit.last_state else 1,
            sent_ns=now_ns,
            target=pursuit.target,
            knows=pursuit.knows,
            t=estimator.t,
            acquired_t=pursuit.acquired_t,
            measurements=pursuit.measurements,
            prior_m=prior.x_m if prior else None,
            prior_sigma_m=sigma_m(prior.cov_m2) if prior else None,
            posterior_m=posterior.x_m if posterior else None,
            posterior_sigma_m=sigma_m(posterior.cov_m2) if posterior else None,
            alpha=update.alpha if update else None,
            rule=update.rule if update else "",
            explain=update.explain if update else None,
            neighbours=tuple(
                neighbour_state(pursuit.mailbox, name, name in used, now_ns) for name in pursuit.mailbox.senders
            ),
            depth_m=telemetry.depth_m if telemetry else None,
            roll_deg=telemetry.roll_deg if telemetry else None,
            pitch_deg=telemetry.pitch_deg if telemetry else None,
            pan_deg=gimbal_deg[0],
            tilt_deg=gimbal_deg[1],
            focus=self._focus,
            armed=telemetry.armed if telemetry else False,
            refused=dict(refused),
            faults=self._faults,
        )


def neighbour_state(mailbox: Mailbox, name: str, used: bool, now_ns: int) -> NeighbourState:
    sender, age_ns = mailbox.senders[name], mailbox.age_ns(name, now_ns)
    return NeighbourState(
        robot=name,
        age_s=None if age_ns is None else age_ns * 1e-9,
        valid=sender.newest is not None and sender.newest.estimate.valid,
        used=used,
        heard=sender.heard,
        gaps=sender.gaps,
    )


def sigma_m(covariance_m2: Symmetric) -> float:
    """Root of the trace: the expected 3-D error."""
    return math.sqrt(covariance_m2[0] + covariance_m2[3] + covariance_m2[5])
