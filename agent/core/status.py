"""What the robot shows of itself: its public state, one message for each target, its faults, and its log."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from msgspec import UNSET

from agent.core.attitude import AttitudeLog
from agent.core.estimation.interface import EstimateCache
from agent.core.messages import MAX_TEXT, Level, LogLine, NeighbourState, State, Symmetric
from agent.core.ranging.fix import Fix, NoRange
from agent.core.ranging.sweep import Measurement, Rejected
from agent.core.step_io import Inputs, SweepOutcome, Telemetry
from agent.core.step_transaction import Revertible
from agent.core.target_state import TargetState

FAILSAFE = "failsafe level"
UNRECORDED = "not recording"  # how the fault of a recording that ended or stalls begins
NO_FRAMES_NS = 700_000_000  # nearly three frames at the slowest rate of vision


class Status(Revertible):
    """What only observers need: the control of the robot reads nothing of it."""

    def __init__(self, fleet: str, robot: str, incarnation: int) -> None:
        self._fleet, self._robot, self._incarnation = fleet, robot, incarnation
        self.log = Logbook(robot)
        self._started_ns = 0
        self._frame_ns: int | None = None
        self._lens_position: int | None = None
        self._faults: tuple[str, ...] = ()

    def start(self, now_ns: int) -> None:
        self._started_ns = now_ns

    def devices(self, inputs: Inputs, ours: tuple[str, ...], attitude: AttitudeLog, now_ns: int) -> None:
        """Notice devices that fell silent, devices that came back, and other faults.

        ours: faults that the kernel itself found, beside those that the host reports.
        """
        for sighting in inputs.sightings:
            self._frame_ns = now_ns
            self._lens_position = sighting.focus if sighting.focus is not None else self._lens_position
        faults = []
        if now_ns - (self._frame_ns or self._started_ns) > NO_FRAMES_NS:
            faults.append("no frames")
        if attitude.silent(now_ns, self._started_ns):
            faults.append("no telemetry")
            faults += [fault for fault in self._faults if fault.startswith(FAILSAFE)]  # it is not known to be over
        elif attitude.newest is not None:
            if attitude.newest.ladder > 0:
                faults.append(f"{FAILSAFE} {attitude.newest.ladder}")
            if bad := attitude.newest.bad_sensors:
                faults.append(f"pressure sensor bad: {' '.join(map(str, bad))}")
        told = () if inputs.faults is UNSET else inputs.faults
        self._show_faults((*faults, *(text[:MAX_TEXT] for text in (*told, *ours))), now_ns)

    def _show_faults(self, faults: tuple[str, ...], now_ns: int) -> None:
        """Log what has changed since the last step; of a fault whose words change, the newest now and then."""
        before, after = ({fault_kind(fault) for fault in all_of} for all_of in (self._faults, faults))
        for fault in faults:
            if fault_kind(fault) not in before:
                self.log.note("warning", fault, now_ns)
            elif fault not in self._faults:
                self.log.note_seldom("warning", fault_kind(fault), fault, now_ns)
        for kind in dict.fromkeys(map(fault_kind, self._faults)):
            if kind not in after:
                self.log.note("info", f"over: {kind}", now_ns)
        self._faults = faults

    def state(
        self,
        target: TargetState,
        refused: dict[str, int],
        attitude: AttitudeLog,
        gimbal_deg: tuple[float, float],
        now_ns: int,
    ) -> State:
        """The public state at this moment, about one of the targets."""
        telemetry, estimator, update, prior = attitude.newest, target.estimator, target.update, target.measured
        posterior, used = estimator.posterior, update.used if update else ()
        verdict, causes = target.consistency.verdict(now_ns)
        return State(
            fleet=self._fleet,
            robot=self._robot,
            incarnation=self._incarnation,
            seq=target.last_state.seq + 1 if target.last_state else 1,
            sent_ns=now_ns,
            verdict=verdict,
            causes=causes,
            target=target.name,
            knows=target.knows,
            t=estimator.t,
            acquired_t=target.acquired_t,
            measurements=target.measurements,
            prior_m=prior.x_m if prior else None,
            prior_sigma_m=sigma_m(prior.cov_m2) if prior else None,
            posterior_m=posterior.x_m if posterior else None,
            posterior_sigma_m=sigma_m(posterior.cov_m2) if posterior else None,
            alpha=update.alpha if update else None,
            rule=update.rule if update else "",
            explain=update.explain if update else None,
            neighbours=tuple(
                neighbour_state(target.cache, name, name in used, now_ns) for name in target.cache.senders
            ),
            depth_m=telemetry.depth_m if telemetry else None,
            roll_deg=telemetry.roll_deg if telemetry else None,
            pitch_deg=telemetry.pitch_deg if telemetry else None,
            pan_deg=gimbal_deg[0],
            tilt_deg=gimbal_deg[1],
            focus=self._lens_position,
            armed=heard.armed if (heard := attitude.heard(now_ns)) else None,
            battery_v=round(telemetry.battery_v, 2) if telemetry else UNSET,
            ladder=telemetry.ladder if telemetry else UNSET,
            **module_state(telemetry, attitude.status),
            refused=dict(refused),
            faults=self._faults,
        )


def module_state(newest: Telemetry | None, status: Telemetry | None) -> dict[str, Any]:
    """Of State what is left out while there is nothing to say: by the newest telemetry, and the newest status."""
    found: dict[str, Any] = {}
    if newest is not None:
        if bad := newest.bad_sensors:
            found["sensors_bad"] = bad
        if at := newest.saturated or 0:
            found["saturated"] = ("", "T1-T4", "T5-T8", "T1-T8")[at & 3]
        if newest.parameters_dirty:
            found["unsaved"] = True
    if status is not None:
        for name, value, scale in (
            ("current_a", status.current_a, 1.0),
            ("water_c", status.temperature_c, 1.0),
            ("heap_free_kb", status.heap_free_b, 1e-3),
        ):
            if value is not UNSET:
                found[name] = round(value * scale, 1)
    return found


def neighbour_state(cache: EstimateCache, name: str, used: bool, now_ns: int) -> NeighbourState:
    sender, age_ns = cache.senders[name], cache.age_ns(name, now_ns)
    return NeighbourState(
        robot=name,
        age_s=None if age_ns is None else age_ns * 1e-9,
        valid=sender.newest is not None and sender.newest.message.valid,
        used=used,
        heard=sender.heard,
        gaps=sender.gaps,
    )


def sweep_outcome(target: str, result: Measurement | Rejected, fix: Fix | NoRange | None = None) -> SweepOutcome:
    """What the log shows of a finished sweep; `fix`: where its peak puts the target, if it has one."""
    if isinstance(result, Rejected):
        return SweepOutcome(sweep=result.sweep, target=target, held_width=result.held_width, rejected=result.reason)
    swept = result.lens_position is not None
    return SweepOutcome(
        sweep=result.sweep,
        target=target,
        t_ns=result.t_ns,
        lens_position=result.lens_position,
        sigma=result.sigma if swept else None,
        width=result.width if swept else None,
        held_width=result.held_width,
        quality=result.quality,
        x_m=fix.position_m if isinstance(fix, Fix) else None,
        rejected=fix.reason if isinstance(fix, NoRange) else "",
    )


def sigma_m(covariance_m2: Symmetric) -> float:
    """Root of the trace: the expected 3-D error."""
    return math.sqrt(covariance_m2[0] + covariance_m2[3] + covariance_m2[5])


def fault_kind(fault: str) -> str:
    """The kind of a fault in State.faults, without its details."""
    return fault.partition(":")[0]


# --- log ---
# A line that could come with every step or every message is thinned, and counted.

AGAIN_NS = 1_000_000_000  # the same text at most once in this time
SELDOM_NS = 5_000_000_000  # about one subject at most one line in this time, for texts that are never the same


class Held(NamedTuple):
    """A text that was written lately."""

    level: Level
    written_ns: int
    more: int = 0  # how often it came again since, unwritten


class Logbook(Revertible):
    """The lines since they were last fetched, and which texts were written lately."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._lines: list[LogLine] = []
        self._lately: dict[str, Held] = {}
        self._about_ns: dict[str, int] = {}  # subject -> when it last had a line

    def note(self, level: Level, text: str, now_ns: int) -> None:
        """Write a line, or count it when it was written within the last second."""
        text = text[:MAX_TEXT]
        held = self._lately.get(text)
        if held is None:
            self._write(level, text, text, now_ns)
        else:
            self._lately[text] = held._replace(more=held.more + 1)

    def note_seldom(self, level: Level, about: str, text: str, now_ns: int) -> None:
        """A line whose text differs each time: at most one in five seconds for each subject."""
        last_ns = self._about_ns.get(about)
        if last_ns is None or now_ns - last_ns > SELDOM_NS:
            self._about_ns[about] = now_ns
            self.note(level, text, now_ns)

    def fetch(self, now_ns: int) -> tuple[LogLine, ...]:
        """The lines since the last call; to be called with every step. It ends with what was held back for a second."""
        for text, held in tuple(self._lately.items()):
            if now_ns - held.written_ns < AGAIN_NS:
                continue
            del self._lately[text]
            if held.more:
                count = f" ({held.more} times more in {(now_ns - held.written_ns) * 1e-9:.1f} s)" * (held.more > 1)
                self._write(held.level, text, text[: MAX_TEXT - len(count)] + count, now_ns)
        lines, self._lines = tuple(self._lines), []
        return lines

    def _write(self, level: Level, text: str, shown: str, now_ns: int) -> None:
        self._lately[text] = Held(level, now_ns)
        self._lines.append(LogLine(robot=self._robot, sent_ns=now_ns, level=level, text=shown))
