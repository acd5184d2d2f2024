"""What the robot shows of itself: its public state, its faults, and the lines of its log."""

from __future__ import annotations

import math
from typing import Literal

from agent.config import Tank
from agent.control.attitude import AttitudeLog
from agent.estimation.face import Estimator, Prior, Update
from agent.estimation.mailbox import Mailbox
from agent.messages import Inputs, Level, LogLine, NeighbourState, State, Symmetric, Vector

NO_FRAMES_NS = 700_000_000  # nearly three frames of the slowest rate at which vision looks
SELDOM_NS = 5_000_000_000  # a line that repeats is said once in this time
TANK_MARGIN_M = 0.2  # an estimate may lie this far outside before it is nonsense


class Status:
    """Keeps what only observers need: nothing here is read back by the control of the robot."""

    def __init__(self, fleet: str, robot: str, target: str, incarnation: int) -> None:
        self._fleet, self._robot, self._target, self._incarnation = fleet, robot, target, incarnation
        self._started_ns = 0
        self._frame_ns: int | None = None
        self._focus: int | None = None
        self._faults: tuple[str, ...] = ()
        self._lines: list[LogLine] = []
        self._said_ns: dict[str, int] = {}
        self._seq = 0
        self._prior: Prior | None = None
        self._measurements = 0
        self._acquired_t: int | None = None
        self._knows: Literal["blind", "told", "sees"] = "blind"

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
                self.note("warning", fault, now_ns)
        for fault in self._faults:
            if fault not in faults:
                self.note("info", f"over: {fault}", now_ns)
        self._faults = tuple(faults)

    def measured(self, prior: Prior) -> None:
        self._prior = prior
        self._measurements += 1

    def iterated(self, estimator: Estimator, update: Update, now_ns: int) -> None:
        """Note the first view and every change between blind, told and sees."""
        knows: Literal["blind", "told", "sees"] = "blind"
        if estimator.valid:
            knows = "sees"
        elif estimator.posterior is not None:
            knows = "told"
        if estimator.valid and self._acquired_t is None:
            self._acquired_t = update.t
        if knows != self._knows:
            self.note("info", f"{knows} at iteration {update.t}", now_ns)
            self._knows = knows

    def note(self, level: Level, text: str, now_ns: int) -> None:
        self._lines.append(LogLine(robot=self._robot, sent_ns=now_ns, level=level, text=text[:400]))

    def note_seldom(self, level: Level, about: str, text: str, now_ns: int) -> None:
        """A line that could come with every message: at most one in five seconds for each subject."""
        said_ns = self._said_ns.get(about)
        if said_ns is None or now_ns - said_ns > SELDOM_NS:
            self._said_ns[about] = now_ns
            self.note(level, text, now_ns)

    def lines(self) -> tuple[LogLine, ...]:
        """The lines since the last call."""
        lines, self._lines = tuple(self._lines), []
        return lines

    def state(
        self,
        estimator: Estimator,
        update: Update | None,
        mailbox: Mailbox,
        refused: dict[str, int],
        attitude: AttitudeLog,
        gimbal_deg: tuple[float, float],
        now_ns: int,
    ) -> State:
        """The public state at this moment."""
        self._seq += 1
        telemetry, posterior, used = attitude.newest, estimator.posterior, update.used if update else ()
        return State(
            fleet=self._fleet,
            robot=self._robot,
            incarnation=self._incarnation,
            seq=self._seq,
            sent_ns=now_ns,
            target=self._target,
            knows=self._knows,
            t=estimator.t,
            acquired_t=self._acquired_t,
            measurements=self._measurements,
            prior_m=self._prior.x_m if self._prior else None,
            prior_sigma_m=sigma_m(self._prior.cov_m2) if self._prior else None,
            posterior_m=posterior.x_m if posterior else None,
            posterior_sigma_m=sigma_m(posterior.cov_m2) if posterior else None,
            alpha=update.alpha if update else None,
            rule=update.rule if update else "",
            explain=update.explain if update else None,
            neighbours=tuple(neighbour_state(mailbox, name, name in used, now_ns) for name in mailbox.senders),
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


def inside(x_m: Vector, tank: Tank) -> bool:
    """Whether a position can be meant: in the tank, or a little outside it."""
    return all(-TANK_MARGIN_M <= x <= size + TANK_MARGIN_M for x, size in zip(x_m, tank.size_m, strict=True))


def sigma_m(covariance_m2: Symmetric) -> float:
    """Root of the trace: the expected 3-D error."""
    return math.sqrt(covariance_m2[0] + covariance_m2[3] + covariance_m2[5])
