"""Measuring targets by sweeps: whose turn it is, what a sweep measured, when its protocol iterates, what is said of it.

It proposes for the camera as capabilities do, on the last row of the table: what takes the camera from it has a reason.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from agent.core.attitude import AttitudeLog, zeros
from agent.core.capability import (
    CameraAct,
    Capability,
    Context,
    Illumination,
    OwnView,
    PoseSource,
    Proposal,
    Sample,
    Situation,
    Spoiled,
    TargetView,
)
from agent.core.config import Pose
from agent.core.estimation.evidence_table import inside
from agent.core.estimation.interface import Prior
from agent.core.estimation.protocols import iteration_ns
from agent.core.messages import Estimate, Level, Mode, State
from agent.core.ranging.camera_model import Eye
from agent.core.ranging.fix import EXACT, Fix, NoRange, OwnPose, cue_ratio, locate, shows_whole
from agent.core.ranging.sweep import LateFrames, Measurement, Rejected
from agent.core.status import Status, sweep_outcome
from agent.core.step_io import Sighting, SweepOutcome
from agent.core.step_transaction import Revertible, StepTransaction
from agent.core.target_state import TargetState
from agent.core.topics import next_due_ns
from agent.core.trust import common
from agent.robot.target_search import TargetScheduler, TargetSearch

FIXED_FOCUS = "the camera's focus is fixed: ranges are by the size of targets, nothing is swept"
TIMING = "camera timing: {}; run `aucamp calibrate run` again"
NEWS_HZ = 10.0  # a link of which so many rounds a second are asked bears news between them; a slower one is thin
LATEST_ITERATION = 1.6  # an iteration waits for a running sweep, but no longer than this many of its periods


class Targets(Revertible):
    """All targets as one robot knows them, between steps."""

    def __init__(self, context: Context, target_search: TargetSearch) -> None:
        fleet, name = context.fleet, context.name
        self._fleet, self._calibration, self._moored = fleet, context.calibration, fleet.robot[name].pose
        self._neighbours = fleet.robot[name].neighbours
        self._attitude: AttitudeLog = context.attitude
        self._log, self._target_search = context.log, target_search
        self._light: Illumination = context.light
        self._source: PoseSource = context.source
        self._iteration_ns = {target: iteration_ns(fleet, target) for target in fleet.target}
        digest = common(fleet)
        self.all = {target: TargetState(fleet, name, target, context.incarnation, digest) for target in fleet.target}
        self._scheduler = TargetScheduler(tuple(fleet.target))
        self._late = {target: LateFrames() for target in fleet.target}
        self._judged: Measurement | None = None  # a sweep whose light is not known to have stayed
        self._turned = False  # the turn changed in this step
        self.signed = False  # what others measured counts by their signatures
        self._iterated_ns = self._say_due_ns = 0

    @property
    def watched(self) -> str:
        """The target whose turn it is."""
        return self._scheduler.target

    @property
    def current(self) -> TargetState:
        return self.all[self.watched]

    def trust(self, keys: Mapping[str, bytes] | UnsetType) -> None:
        """Public keys of the robots, when they were read or changed."""
        if keys is not UNSET:
            self.signed = True
            for each in self.all.values():
                each.estimator.trust(keys)

    def begin(self, now_ns: int) -> None:
        """The first step."""
        self._iterated_ns = now_ns
        if self._calibration.focus is None:
            self._log.note("info", FIXED_FOCUS, now_ns)

    # --- measurements -----------------------------------------------------------------------------------------

    def measure(self, now_ns: int) -> SweepOutcome | UnsetType:
        """A finished sweep becomes a prior: where the sharpest frame saw the target, in the world."""
        if (late := self._source.settled(now_ns)) is not None:
            self.all[late[0]].measure(late[1])
        result = self._counted(self._target_search.finish(now_ns), now_ns)
        if (remark := self._target_search.remark()) is not None:
            self._note("warning", remark, now_ns)
        if result is None:
            return UNSET
        if isinstance(result, Rejected):
            self._note("info", f"sweep rejected: {result.reason}", now_ns)
            return self._light.marked(sweep_outcome(self.watched, result))
        known = self._source.at_sample(result.t_ns, now_ns)
        fix = self._fix(result, known)
        self._compare(result, isinstance(fix, NoRange) and fix.contradicts, now_ns)
        self._time(result)
        if isinstance(fix, NoRange):
            self._note("warning", f"sweep rejected: {fix.reason}", now_ns)
        else:
            prior = Prior(fix.position_m, fix.random_m2, result.t_ns, fix.systematic_m2, fix.lever_m, fix.drift_m2_s2)
            if known is None or not self._kept(result, known, prior, now_ns):
                self.current.measure(prior)
        return self._light.marked(sweep_outcome(self.watched, result, fix))

    def _counted(self, result: Measurement | Rejected | None, now_ns: int) -> Measurement | Rejected | None:
        """A sweep that ended counts as soon as its light is known not to have changed."""
        if isinstance(result, Rejected):
            self._light.failed(now_ns)
            self._time(result)
            return result
        if result is not None:
            self._judged = result
            self._light.ended(now_ns)
        if (pending := self._judged) is None or (found := self._light.verdict(now_ns)) is None:
            return None
        self._judged = None
        if not isinstance(found, Spoiled):
            return pending
        self._target_search.take_back()
        return Rejected(pending.sweep, f"spoiled: {found.reason}", held_width=pending.held_width)

    def _fix(self, peak: Measurement, known: Sample | None) -> Fix | NoRange:
        """Where a sweep's peak puts the target; known: where a robot that swims was then."""
        level = self._attitude.at(peak.t_ns)
        if level is None:
            return NoRange("no telemetry at the time of its sharpest frame")
        if known is None and self._source.moves:
            return NoRange("where it was itself at the time of its sharpest frame is not known")
        pose, own = (self._moored, None) if known is None else (known.pose, known.own)
        fix = self._located(peak, self._target_search.eye(level, pose), own)
        if isinstance(fix, Fix) and not inside(fix.position_m, self._fleet.tank.size_m):
            where = "it" if peak.lens_position is None else f"peak at {peak.lens_position:.0f}"
            return NoRange(f"{where} is outside the tank")
        return fix

    def _located(self, peak: Measurement, eye: Eye, own: OwnPose | None) -> Fix | NoRange:
        ball = self.current.ball
        outline, sigma, cues = self._light.corrected(peak, eye, ball, self._fleet.ranging.cues)
        budget = self._fleet.budget
        by_pressure = zeros(budget, self._attitude.on_s(peak.t_ns))
        return locate(self._calibration, eye, outline, peak.lens_position, sigma, ball, cues, own, budget, by_pressure)

    def _compare(self, peak: Measurement, refused: bool, now_ns: int) -> None:
        """Take note of what the sweep says of focus and size, where both speak."""
        level = self._attitude.at(peak.t_ns)
        if self._fleet.ranging.cues != "both" or self.current.ball.radius_m is None or level is None:
            return
        eye = self._target_search.eye(level, self._moored)
        outline, sigma, _ = self._light.corrected(peak, eye, self.current.ball, "both")
        ratio = cue_ratio(self._calibration, outline, peak.lens_position, sigma, self.current.ball, eye.tilt_rad)
        self.current.consistency.sweep(ratio, refused, now_ns)

    def _time(self, peak: Measurement | Rejected) -> None:
        """Take note of what the sweep says of the camera's timing, where nothing moves."""
        focus, target = self._calibration.focus, self.current
        if focus is not None and not self._source.moves and target.ball.speed_m_s is None:
            self._late[target.name].add(peak, focus.noise)

    def look(self, sightings: Iterable[Sighting], pose: Pose, own: OwnView | None) -> None:
        """Take note of frames that should show a target, with camera and lens at rest; see TargetState.looked."""
        for sighting in sightings:
            target = self.all.get(sighting.target)
            if target is None or (own is not None and own.own is None):
                continue
            if sighting.found:
                target.looked(True, sighting.t_ns)
            elif sighting.index < 0 and sighting.t_ns >= self._target_search.pointing.steady_from_ns:
                level, believed = self._attitude.at(sighting.t_ns), target.estimator.posterior
                if level is not None and believed is not None and target.name == self.watched:
                    eye = self._target_search.eye(level, pose)
                    if shows_whole(self._calibration, eye, target.ball, believed.x_m, believed.cov_m2):
                        target.looked(False, sighting.t_ns)

    def _kept(self, peak: Measurement, known: Sample, prior: Prior, now_ns: int) -> bool:
        """Whether a robot that swims keeps a measurement until it knows better where it was then."""
        level = self._attitude.at(peak.t_ns)
        if level is None:
            return False
        seen = self._located(peak, self._target_search.eye(level, known.pose), EXACT)
        if isinstance(seen, Fix):
            self._source.keep(self.watched, seen, known, prior, now_ns)
        return isinstance(seen, Fix)

    @property
    def _settling(self) -> bool:
        """A sweep has ended, and what it is worth is still to be known."""
        return self._light.judging or self._source.settling

    def faults(self, now_ns: int) -> tuple[str, ...]:
        """Targets whose belief cannot be trusted, and why; and a camera whose timing is not that of its calibration."""
        told = ((name, *each.consistency.verdict(now_ns)) for name, each in self.all.items())
        doubts = tuple(f"{word}: {name}: {causes[0]}" for name, word, causes in told if causes)
        late = next((late for each in self._late.values() if (late := each.contradiction()) is not None), None)
        return doubts if late is None else (*doubts, TIMING.format(late))

    # --- iterations -------------------------------------------------------------------------------------------

    def iterate(self, own: OwnView | None, equipment: Capability, now_ns: int) -> None:
        """One each period; a sweep that is nearly done is waited for, a frame of what swims does not wait itself."""
        target, elapsed_ns = self.current, now_ns - self._iterated_ns
        period_ns = self._iteration_ns[target.name]
        due_ns = 0 if own is not None and own.sighted == target.name else period_ns
        comes = target.prior is None and (self._target_search.measuring or self._settling)
        if elapsed_ns < due_ns or (comes and elapsed_ns < LATEST_ITERATION * period_ns):
            return
        self._iterated_ns = now_ns
        target.observe(equipment.bearing(target.name, lambda: target.estimator.posterior, now_ns))
        for each in self.all.values():
            each.catch_up(now_ns)
        if target.iterate(now_ns):
            self._note("info", f"{target.knows} since iteration {target.since_t}", now_ns)

    def take_turns(self, pursues: str | None) -> None:
        """Whose turn it is now. pursues: a target that the camera goes with."""
        before = self.watched
        busy = self._target_search.measuring or self._settling or self._light.claims
        if not busy and self.current.prior is None:
            self._scheduler.next({name: each.estimator.t for name, each in self.all.items()}, pursues)
        self._turned = self.watched != before

    def views(self, own: OwnView | None, watched: Collection[str], now_ns: int) -> tuple[TargetView, ...]:
        """What is known of each now: for a moored robot, of those that are watched."""
        return tuple(self._view(each, own, watched, now_ns) for each in self.all.values())

    def _view(self, target: TargetState, own: OwnView | None, watched: Collection[str], now_ns: int) -> TargetView:
        asked = target.name in watched or own is not None
        return TargetView(
            target.name,
            target.estimator.posterior if asked else None,
            target.estimate(now_ns) if own is not None and own.about == target.name else None,
        )

    # --- camera, words ----------------------------------------------------------------------------------------

    def propose(self, situation: Situation) -> Iterable[Proposal[CameraAct]]:
        return Proposal("camera", "target", self._watch), Proposal("camera", "hold", lambda at: CameraAct())

    def _watch(self, situation: Situation) -> CameraAct:
        """Look at the target whose turn it is, and sweep where a measurement is wanted."""
        own = situation.own
        calm = own is None or (own.calm and self.watched != own.pursues)
        wanted = self.current.prior is None and not self._settling and calm and situation.orders.sweeps
        plan = self._target_search.act(situation, wanted and self._light.consent(None, situation))
        if plan is not None:  # of a camera of fixed focus there is none, nor are there lamps
            self._light.began(situation)
        if self._turned:  # the first iteration of a turn begins when the camera has arrived
            self._iterated_ns = max(situation.now_ns, self._target_search.pointing.steady_from_ns)
        return CameraAct(plan=plan)

    def say(self, send_hz: float | None, pursues: str | None, now_ns: int) -> tuple[Estimate, ...]:
        """Say to each neighbour what there is about each target; at once what was just concluded of one that swims, and
        what is news where the link bears it."""
        fresh = pursues is not None and self._iterated_ns == now_ns
        send_hz = send_hz or self._fleet.link.send_hz
        pairs = [(target, neighbour) for target in self.all.values() for neighbour in self._neighbours]
        if now_ns < self._say_due_ns and not fresh:
            news = pairs if send_hz >= NEWS_HZ else ()
            return tuple(
                target.say(near, now_ns, between=True) for target, near in news if target.has_news(near, now_ns)
            )
        self._say_due_ns = next_due_ns(min(self._say_due_ns, now_ns), round(1e9 / send_hz), now_ns)
        return tuple(target.say(near, now_ns) for target, near in pairs)

    def _note(self, level: Level, text: str, now_ns: int) -> None:
        """A line of the log about the target that the camera is at; its name is needless where it is the only one."""
        about = f"{self.watched}: " if len(self.all) > 1 else ""
        self._log.note(level, about + text, now_ns)


# --- telemetry ---
# The State that a robot shows: one target after the other, so that each has the same rate, however many there are.

STATE_NS = 200_000_000  # 5 Hz


class Telemetry(Revertible):
    """Of one robot, between steps."""

    def __init__(
        self,
        targets: Mapping[str, TargetState],
        status: Status,
        attitude: AttitudeLog,
        equipment: Capability,
        transaction: StepTransaction,
    ) -> None:
        self._targets, self._status, self._attitude = tuple(targets.values()), status, attitude
        self._equipment, self._transaction = equipment, transaction
        self._period_ns = STATE_NS // len(targets)
        self._due_ns = self._shown = 0

    def state(
        self,
        refused: Mapping[str, int],
        gimbal_deg: tuple[float, float],
        signed: bool,
        ordered: tuple[str, ...] | UnsetType,
        now_ns: int,
    ) -> State | None:
        """What is known of the target whose turn it is; None: it is not time."""
        if now_ns < self._due_ns:
            return None
        self._due_ns = next_due_ns(self._due_ns, self._period_ns, now_ns)
        target = self._targets[self._shown % len(self._targets)]
        self._shown += 1
        state = self._status.state(target, dict(refused), self._attitude, gimbal_deg, now_ns)
        mode: Mode = "running" if self._transaction.fault(now_ns) is None else "degraded"
        parts = self._equipment.telemetry(now_ns)
        return target.show(replace(state, mode=mode, signed=signed, ordered=ordered, **parts))

    def last(self, target: TargetState, gimbal_deg: tuple[float, float], now_ns: int) -> State | None:
        """What can be shown while no step succeeds: the newest state there was, or what is known without one, and that
        it is no longer true."""
        if now_ns < self._due_ns:
            return None
        self._due_ns = next_due_ns(self._due_ns, self._period_ns, now_ns)
        seq = 1 if target.last_state is None else target.last_state.seq + 1
        last = target.last_state or self._status.state(target, {}, self._attitude, gimbal_deg, now_ns)
        why = self._transaction.fault(now_ns) or ""
        return target.show(replace(last, seq=seq, sent_ns=now_ns, mode="degraded", faults=(why,)))
