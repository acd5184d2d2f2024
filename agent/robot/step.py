"""Agent.step: the order of work and nothing else. No clock, no random numbers, no thread, no I/O.

The same inputs at the same times give the same bytes, which is what replay relies on. A step is a transaction
(step_transaction.Net): one that raises is undone, and done again without what broke it.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from agent.capabilities.light.lights import Lights, lights_of
from agent.capabilities.survey.survey import Conduct
from agent.capabilities.swim.pose_filter import Belief
from agent.capabilities.swim.pursuit import Pursuit
from agent.capabilities.swim.swimmer import Swimmer, pose_of
from agent.core.attitude import AttitudeLog
from agent.core.config import Fleet, common
from agent.core.control.sweep import Measurement, Rejected
from agent.core.control.target_search import Seek, TargetScheduler
from agent.core.estimation.evidence_table import inside
from agent.core.estimation.interface import Prior
from agent.core.estimation.protocols import iteration_ns
from agent.core.messages import SCHEMA, Estimate, Level, Mode, State
from agent.core.ranging.camera_model import Calibration, Eye
from agent.core.ranging.fix import EXACT, Fix, NoRange, OwnPose, locate
from agent.core.status import Status, sweep_outcome
from agent.core.step_io import Inputs, Outputs, SetPoint, SweepOutcome, SweepPlan
from agent.core.step_transaction import Net, Revertible
from agent.core.target_state import TargetState
from agent.core.topics import next_due_ns
from agent.robot.inbox import Inbox
from agent.robot.operator import Desk

LATEST_ITERATION = 1.6  # an iteration waits for a running sweep, but no longer than this many of its periods


class Agent(Revertible):
    """One robot's mind: what it knows between steps."""

    def __init__(
        self, fleet: Fleet, name: str, calibration: Calibration, incarnation: int, schema: int = SCHEMA
    ) -> None:
        """schema: of the messages that are taken in; an older one is for replay alone."""
        robot = fleet.robot[name]
        self._fleet, self._robot, self._calibration = fleet, robot, calibration
        self._iteration_ns = {target: iteration_ns(fleet, target) for target in fleet.target}

        shared = common(fleet)
        self.targets = {target: TargetState(fleet, name, target, incarnation, shared) for target in fleet.target}
        self.scheduler = TargetScheduler(tuple(fleet.target))
        self.seek = Seek(fleet, robot, calibration)
        self.swimmer = Swimmer(fleet, name, calibration, incarnation) if fleet.navigation else None
        self.pursuit = Pursuit(fleet, name, calibration, self.swimmer)
        self.attitude = AttitudeLog()
        neighbours = self.swimmer.company.neighbours if self.swimmer else None
        self.status = Status(fleet.fleet, name, incarnation)
        self.lights = lights_of(fleet, name, calibration, incarnation, self.swimmer, self.status.log)
        self.survey = Conduct(fleet, name, calibration, incarnation, self.swimmer, self.lights.views)
        self.inbox = Inbox(self.targets, fleet.tank, shared, schema, neighbours, self.survey, self.lights)
        self.net = Net()
        shown = (self.targets, self.status, self.inbox, self.attitude, self.seek, self.swimmer, self.lights, self.net)
        self.showing = Showing(*shown)
        self.desk = Desk(fleet, name, incarnation, self.swimmer, self.lights, self.status.log)
        self._signed = False

        self._iterated_ns = self._say_due_ns = 0
        self._said = 0

    @property
    def current(self) -> TargetState:
        """What is known of the target that the camera is at."""
        return self.targets[self.scheduler.target]

    def step(self, inputs: Inputs, now_ns: int) -> Outputs:
        """Take in all that arrived since the last step, decide, and say what to do and to send.

        `now_ns` never decreases and is later than every time stamp in `inputs`.
        """
        outputs = self.net.step(self, self._step, inputs, now_ns)
        if self.net.holds:
            outputs = msgspec.structs.replace(outputs, state=self.showing.last(self.current, now_ns))
        return self.desk.complete(outputs, inputs.orders, now_ns)

    def _step(self, inputs: Inputs, now_ns: int) -> Outputs:
        if self._iterated_ns == 0:
            self._iterated_ns = now_ns
            self.status.start(now_ns)
        if inputs.keys is not UNSET:
            self._signed = True
            for each in self.targets.values():
                each.estimator.trust(inputs.keys)
        self.inbox.receive(inputs.heard, inputs.refused, self.status, now_ns)
        self.desk.take(inputs.orders, now_ns)
        for telemetry in inputs.telemetry:
            self.attitude.add(telemetry)
            self.seek.add_telemetry(telemetry)
        for sighting in inputs.sightings:
            self.seek.add_sighting(sighting)
        self.pursuit.see(inputs.sightings)
        if self.swimmer is not None:
            self.swimmer.feel(inputs.telemetry)
            self.swimmer.see(inputs.landmarks or (), inputs.flow or (), self.attitude, self.seek, now_ns)
        self.survey.see(inputs.blocks or (), self.attitude, self.seek, self.status, now_ns)
        self.status.devices(inputs, self._faults(now_ns), self.attitude, now_ns)
        outcome = self.lights.marked(self._measure(now_ns))
        self._iterate(now_ns)
        self.lights.tick(self.attitude, now_ns)
        sweep = self._act(now_ns)
        self.lights.burn(self.seek, self.current, self.attitude, now_ns)
        claims, keyframes = self.survey.say(now_ns)
        return Outputs(
            sweep=sweep,
            says=self._say(now_ns),
            state=self.showing.state(self._signed, self.desk.ordered, now_ns),
            log=self.status.log.fetch(now_ns),
            set_point=self._set_point(now_ns),
            near=UNSET if self.swimmer is None else self.swimmer.say(self.attitude, now_ns) or UNSET,
            claims=claims,
            keyframes=keyframes,
            light=self.lights.say(now_ns),
            lens=self.lights.lens(self.pursuit.lens()),
            outcome=outcome,
        )

    def _measure(self, now_ns: int) -> SweepOutcome | UnsetType:
        """A finished sweep becomes a prior: where the sharpest frame saw the target, in the world."""
        if self.swimmer is not None and (late := self.swimmer.localizer.settled(now_ns)) is not None:
            self.targets[late[0]].measure(late[1])
        result = self.lights.judged(self.seek.finish(now_ns), self.seek, now_ns)
        if (remark := self.seek.remark()) is not None:
            self._note("warning", remark, now_ns)
        if result is None:
            return UNSET
        if isinstance(result, Rejected):
            self._note("info", f"sweep rejected: {result.reason}", now_ns)
            return sweep_outcome(self.current.name, result)
        known = None if self.swimmer is None else self.swimmer.localizer.of_sample(result.t_ns, now_ns)
        fix = self._fix(result, known)
        if isinstance(fix, NoRange):
            self._note("warning", f"sweep rejected: {fix.reason}", now_ns)
        else:
            prior = Prior(fix.position_m, fix.random_m2, result.t_ns, fix.systematic_m2)
            if known is None or not self._sight(result, known, prior, now_ns):
                self.current.measure(prior)
        return sweep_outcome(self.current.name, result, fix)

    def _fix(self, peak: Measurement, known: tuple[Belief, OwnPose] | None) -> Fix | NoRange:
        """Where a sweep's peak puts the target; known: where a robot that swims was then."""
        level = self.attitude.at(peak.t_ns)
        if level is None:
            return NoRange("no telemetry at the time of its sharpest frame")
        pose, own = None, None
        if self.swimmer is not None:
            if known is None:
                return NoRange("where it was itself at the time of its sharpest frame is not known")
            pose, own = pose_of(known[0]), known[1]
        fix = self._located(peak, self.seek.eye(level, pose), own)
        if isinstance(fix, Fix) and not inside(fix.position_m, self._fleet.tank.size_m):
            return NoRange(f"peak at {peak.lens_position:.0f} is outside the tank")
        return fix

    def _located(self, peak: Measurement, eye: Eye, own: OwnPose | None) -> Fix | NoRange:
        ball = self.current.ball
        outline, sigma, cues = self.lights.seen(peak, eye, ball, self._fleet.ranging.cues)
        return locate(self._calibration, eye, outline, peak.lens_position, sigma, ball, cues, own)

    def _sight(self, peak: Measurement, known: tuple[Belief, OwnPose], prior: Prior, now_ns: int) -> bool:
        """Whether a robot that swims keeps a measurement until it knows better where it was then. The sighting may also
        tell it where it is, by what others say of the target."""
        level = self.attitude.at(peak.t_ns)
        if self.swimmer is None or level is None:
            return False
        seen = self._located(peak, self.seek.eye(level, pose_of(known[0])), EXACT)
        if isinstance(seen, Fix):
            self.swimmer.localizer.sight(self.current.name, seen, known, prior, now_ns)
        return isinstance(seen, Fix)

    @property
    def _settling(self) -> bool:
        """A sweep has ended, and what it is worth is still to be known."""
        return self.lights.judging or (self.swimmer is not None and self.swimmer.localizer.settling)

    def _iterate(self, now_ns: int) -> None:
        """One each period; a sweep that is nearly done is waited for, a frame of what swims does not wait itself."""
        target, elapsed_ns = self.current, now_ns - self._iterated_ns
        period_ns = self._iteration_ns[target.name]
        due_ns = period_ns // 2 if self.pursuit.sees(target) else period_ns
        comes = target.prior is None and (self.seek.measuring or self._settling)
        if elapsed_ns < due_ns or (comes and elapsed_ns < LATEST_ITERATION * period_ns):
            return
        self._iterated_ns, target.bearing = now_ns, self.pursuit.bearing(target, self.attitude, now_ns)
        for each in self.targets.values():
            each.catch_up(now_ns)
        if target.iterate(now_ns):
            self._note("info", f"{target.knows} since iteration {target.since_t}", now_ns)

    def _act(self, now_ns: int) -> SweepPlan | None:
        """Which target's turn it is, gimbal and lens."""
        before = self.scheduler.target
        busy = self.seek.measuring or self._settling or self.lights.claims
        if not busy and self.current.prior is None:
            self.scheduler.next({name: each.estimator.t for name, each in self.targets.items()}, self.pursuit.target)
        newest = self.attitude.newest
        level = None if newest is None or self.attitude.silent(now_ns, 0) else self.attitude.at(newest.t_ns)
        if self.swimmer is not None:
            by = self.swimmer.localizer.aid.target
            self.swimmer.steer(self.seek, None if by is None else self.targets[by].estimator.by_others(), now_ns)
            about = self.targets.get(self.swimmer.about or "")
            did = self.swimmer.does
            self.swimmer.survey(self.survey.goal())
            self.swimmer.heed(about.estimate(now_ns) if about else None, self.seek, now_ns)
            if self.swimmer.does != did:
                self.status.log.note("info", f"{did} is over, now {self.swimmer.does}", now_ns)
        if self.swimmer is not None and not self.seek.measuring and not self.lights.obeys:
            pursues = self.pursuit.goes_with(self.current, self.seek)
            if self.swimmer.glance(self.seek, level, pursues, now_ns):
                return None
        if self.desk.looks(self.seek, now_ns):
            return None
        surveys, plan = self.survey.act(self.seek, level, self.status, now_ns) if self.desk.surveys else (False, None)
        if surveys:
            return plan
        if self.pursuit.look(self.current, self.seek, level, now_ns):
            self.lights.released(now_ns)
            return None
        calm = self.swimmer is None or (self.swimmer.calm(now_ns) and self.current.name != self.pursuit.target)
        wanted = self.current.prior is None and not self._settling and calm and self.desk.wishes.sweeps
        wanted = self.lights.may_sweep(self.seek, self.current, level, wanted, now_ns)
        plan = self.seek.act(now_ns, self.scheduler.target, level, self.current.believed_m, wanted)
        if plan is not None:
            self.lights.began(now_ns)
        if self.scheduler.target != before:  # the first iteration of a turn begins when the camera has arrived
            self._iterated_ns = max(now_ns, self.seek.pointing.steady_from_ns)
        return plan

    def _say(self, now_ns: int) -> tuple[Estimate, ...]:
        """Say to each neighbour what there is about each target; at once what was just concluded of one that swims."""
        fresh = self.pursuit.target is not None and self._iterated_ns == now_ns
        say_ns = round(1e9 / (self.desk.wishes.send_hz or self._fleet.link.send_hz))
        if now_ns < self._say_due_ns - fresh * say_ns // 2:
            return ()
        self._say_due_ns = next_due_ns(min(self._say_due_ns, now_ns), say_ns, now_ns)
        self._said += 1
        return tuple(
            target.say(neighbour, self._said, now_ns)
            for target in self.targets.values()
            for neighbour in self._robot.neighbours
        )

    def _faults(self, now_ns: int) -> tuple[str, ...]:
        """What is wrong by the kernel's own account."""
        ours = self.net.fault(now_ns)
        felt = () if self.swimmer is None else self.swimmer.faults(now_ns)
        return (*self.inbox.faults(now_ns), *felt, *(() if ours is None else (ours,)))

    def _note(self, level: Level, text: str, now_ns: int) -> None:
        """A line of the log about the target that the camera is at; its name is needless where it is the only one."""
        about = f"{self.scheduler.target}: " if len(self.targets) > 1 else ""
        self.status.log.note(level, about + text, now_ns)

    def _set_point(self, now_ns: int) -> SetPoint:
        centre_us = round(self._fleet.body.servo_centre_us)
        light, lamp_us = self.lights.command or (0.0, (centre_us, centre_us))
        servos_us = (*self.seek.pointing.servos_us(now_ns), *lamp_us)
        if self.swimmer is None:
            depth_m = self.desk.wishes.depth_m or self._robot.depth_m
            return SetPoint(depth_m=depth_m, servos_us=servos_us, light=light)
        ahead_n, left_n, moment_nm = self.swimmer.thrust(self.attitude.obeys(now_ns), self.current.believed_m, now_ns)
        return SetPoint(
            depth_m=self.swimmer.depth_m(now_ns),
            force_n=(ahead_n, left_n),
            yaw_moment_nm=moment_nm,
            servos_us=servos_us,
            light=light,
        )


# --- telemetry ---

STATE_NS = 200_000_000  # 5 Hz


class Showing(Revertible):
    """The states that a robot shows: one target after the other, so that each has the same rate, however many there
    are."""

    def __init__(
        self,
        targets: Mapping[str, TargetState],
        status: Status,
        inbox: Inbox,
        attitude: AttitudeLog,
        seek: Seek,
        swimmer: Swimmer | None,
        lights: Lights,
        net: Net,
    ) -> None:
        self._targets, self._status, self._inbox, self._attitude = tuple(targets.values()), status, inbox, attitude
        self._seek, self._swimmer, self._lights, self._net = seek, swimmer, lights, net
        self._period_ns = STATE_NS // len(targets)
        self._due_ns = self._shown = 0

    def state(self, signed: bool, ordered: tuple[str, ...] | UnsetType, now_ns: int) -> State | None:
        """What is known of the target whose turn it is; None: it is not time."""
        if now_ns < self._due_ns:
            return None
        self._due_ns = next_due_ns(self._due_ns, self._period_ns, now_ns)
        target = self._targets[self._shown % len(self._targets)]
        self._shown += 1
        state = self._status.state(target, self._inbox.refused, self._attitude, self._seek.gimbal_deg(), now_ns)
        mode: Mode = "running" if self._net.fault(now_ns) is None else "degraded"
        where = UNSET if self._swimmer is None else self._swimmer.localizer.shown(now_ns)
        does = UNSET if self._swimmer is None else self._swimmer.does
        lamp = self._lights.shown()
        target.last_state = replace(
            state, mode=mode, signed=signed, whereabouts=where, behaviour=does, lamp=lamp, ordered=ordered
        )
        return target.last_state

    def last(self, target: TargetState, now_ns: int) -> State | None:
        """What can be shown while no step succeeds: the newest state there was, and that it is no longer true."""
        if now_ns < self._due_ns or target.last_state is None:
            return None
        self._due_ns = next_due_ns(self._due_ns, self._period_ns, now_ns)
        last, why = target.last_state, self._net.fault(now_ns) or ""
        target.last_state = replace(last, seq=last.seq + 1, sent_ns=now_ns, mode="degraded", faults=(why,))
        return target.last_state
