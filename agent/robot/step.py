"""Agent.step: the order of work and nothing else. No clock, no random numbers, no thread, no I/O.

The same inputs at the same times give the same bytes, which is what replay relies on. A step is a transaction
(step_transaction.StepTransaction): one that raises is undone, and done again without what broke it.
"""

from __future__ import annotations

import msgspec
from msgspec import UNSET
from msgspec.structs import replace

from agent.core.attitude import KEEP_NS, AttitudeLog
from agent.core.capability import DAYLIGHT, MOORED, BodyAct, CameraAct, Context, LampAct, Situation
from agent.core.config import Fleet
from agent.core.messages import SCHEMA
from agent.core.ranging.camera_model import Calibration, sweep_waits_ns
from agent.core.status import Status
from agent.core.step_io import Inputs, Outputs, SetPoint
from agent.core.step_transaction import Revertible, StepTransaction
from agent.core.trust import common
from agent.robot.arbiter import Arbiter, Equipment
from agent.robot.inbox import Inbox
from agent.robot.operator import Operator
from agent.robot.target_search import TargetSearch
from agent.robot.targets import Targets, Telemetry


class Agent(Revertible):
    """One robot's mind: what it knows between steps."""

    def __init__(
        self, fleet: Fleet, name: str, calibration: Calibration, incarnation: int, schema: int = SCHEMA
    ) -> None:
        """schema: of the messages that are taken in; an older one is for replay alone."""
        self._fleet, self._robot = fleet, fleet.robot[name]
        self.attitude, self.status, self.transaction = (
            AttitudeLog(KEEP_NS + sweep_waits_ns(calibration.timing, fleet.camera.sweep_steps)),
            Status(fleet.fleet, name, incarnation),
            StepTransaction(),
        )
        context = Context(fleet, name, calibration, incarnation, self.attitude, self.status.log, DAYLIGHT, MOORED)
        self.equipment = Equipment(context)
        self.capabilities, self._light = self.equipment.by_name, self.equipment.light
        self.target_search = TargetSearch(fleet, self._robot, calibration)
        self.measuring = Targets(context._replace(light=self._light, source=self.equipment.source), self.target_search)
        self.targets = self.measuring.all
        self.inbox = Inbox(self.targets, fleet.tank, common(fleet), schema, self.equipment)
        self.telemetry = Telemetry(self.targets, self.status, self.attitude, self.equipment, self.transaction)
        self.operator = Operator(fleet, name, incarnation, self.equipment, self.status.log)
        self.arbiter = Arbiter()
        targets = self.measuring.views(None, (), 0)
        self._situation = Situation(
            0, None, self._robot.pose, self.target_search.view(0), self.measuring.watched, targets
        )

    def step(self, inputs: Inputs, now_ns: int) -> Outputs:
        """Take in all that arrived since the last step, decide, and say what to do and to send.

        `now_ns` never decreases and is later than every time stamp in `inputs`.
        """
        outputs = self.transaction.step(self, self._step, inputs, now_ns)
        if self.transaction.holds:
            self.status.log.note_seldom("error", "degraded", self.transaction.fault(now_ns) or "", now_ns)
            state = self.telemetry.last(self.measuring.current, self._situation.camera.gimbal_deg, now_ns)
            outputs = msgspec.structs.replace(outputs, state=state, log=self.status.log.fetch(now_ns))
        return self.operator.complete(outputs, inputs.orders, now_ns)

    def _step(self, inputs: Inputs, now_ns: int) -> Outputs:
        situation = self._take_in(inputs, now_ns)
        outcome = self.measuring.measure(now_ns)
        self.measuring.iterate(situation.own, self.equipment, now_ns)
        situation = self._decide(situation)
        askers = self.operator, self.equipment, self.measuring
        proposals = tuple(each for one in askers for each in one.propose(situation))
        camera: CameraAct = self.arbiter.grant("camera", proposals, situation)
        self.target_search.carry_out(camera, now_ns)
        if camera.target is not None:  # that is tracked: by frames, which need no light
            self._light.released(now_ns)
        holder = self.arbiter.held["camera"]
        situation = replace(situation, camera=self.target_search.view(now_ns), camera_holder=holder)
        lamp: LampAct | None = self.arbiter.grant("lamp", proposals, situation)
        situation = self.equipment.settle(situation)
        says = self.measuring.say(situation.orders.send_hz, situation.own and situation.own.pursues, now_ns)
        shown = self.inbox.refused, situation.camera.gimbal_deg, self.measuring.signed, self.operator.ordered, now_ns
        state, log = self.telemetry.state(*shown), self.status.log.fetch(now_ns)
        body: BodyAct = self.arbiter.grant("body", proposals, situation) or BodyAct()
        self.equipment.source.thrusts(body, now_ns)
        self._situation = situation
        return Outputs(
            sweep=camera.plan,
            says=says,
            state=state,
            log=log,
            set_point=self._set_point(body, lamp, situation),
            outgoing=self.equipment.said(situation) or UNSET,
            grants=self.arbiter.changes() or UNSET,
            lens=self.equipment.lens(),
            outcome=outcome,
        )

    def _take_in(self, inputs: Inputs, now_ns: int) -> Situation:
        """All that arrived, and what it says of the robot itself."""
        if not self._situation.now_ns:
            self.measuring.begin(now_ns)
            self.status.start(now_ns)
        self.measuring.trust(inputs.keys)
        self.inbox.receive(inputs.heard, inputs.refused, self.status, now_ns)
        self.attitude.extend(inputs.telemetry)
        self.operator.take(inputs.orders, self.attitude.heard(now_ns), now_ns)
        self.target_search.see(inputs.telemetry, inputs.sightings, self._situation.light)
        level, camera, orders = self.attitude.now(now_ns), self.target_search.view(now_ns), self.operator.overrides
        situation = replace(self._situation, now_ns=now_ns, level=level, camera=camera, orders=orders)
        situation = self.equipment.update(inputs, situation)
        self.target_search.view_sweep(situation.view_sweep)
        if situation.light.from_ns is not None:
            self.measuring.look(inputs.sightings, situation.pose, situation.own)
        self.status.devices(inputs, self._faults(now_ns), self.attitude, now_ns)
        return situation

    def _decide(self, situation: Situation) -> Situation:
        """What is believed before anything is granted."""
        now_ns = situation.now_ns
        camera, own = self.target_search.view(now_ns), situation.own
        if self.capabilities:
            situation = replace(situation, camera=camera, targets=self.measuring.views(own, (), now_ns))
            situation = self.equipment.decide(situation)
            self.target_search.search(situation.search)
            camera = self.target_search.view(now_ns)
        self.measuring.take_turns(own and own.pursues)
        watched = self.measuring.watched
        return replace(situation, watched=watched, camera=camera, targets=self.measuring.views(own, (watched,), now_ns))

    def _faults(self, now_ns: int) -> tuple[str, ...]:
        """What is wrong by the kernel's own account."""
        ours = self.transaction.fault(now_ns)
        found = *self.inbox.faults(now_ns), *self.measuring.faults(now_ns), *self.equipment.faults(now_ns)
        return (*found, *(() if ours is None else (ours,)))

    def _set_point(self, body: BodyAct, lamp: LampAct | None, situation: Situation) -> SetPoint:
        centre_us = round(self._fleet.body.servo_centre_us)
        light, lamp_us = lamp or (0.0, (centre_us, centre_us))
        return SetPoint(
            depth_m=body.depth_m or situation.orders.depth_m or self._robot.depth_m,
            force_n=body.force_n,
            yaw_moment_nm=body.moment_nm,
            servos_us=(*self.target_search.pointing.servos_us(situation.now_ns), *lamp_us),
            light=light,
        )
