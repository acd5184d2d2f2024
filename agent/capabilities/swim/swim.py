"""Swimming as a capability: where the robot is and what it looks at for that, where it goes, a fish that it follows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar

from msgspec.structs import replace

from agent.capabilities.swim.deconfliction import Neighbours
from agent.capabilities.swim.pose_filter import Belief
from agent.capabilities.swim.pursuit import Pursuit
from agent.capabilities.swim.swimmer import Swimmer, calm, pose_of
from agent.core.attitude import AttitudeLog
from agent.core.capability import (
    BodyAct,
    Capability,
    Context,
    Motion,
    NeighbourView,
    Outgoing,
    OwnView,
    PoseSource,
    Proposal,
    Sample,
    Situation,
)
from agent.core.codec import decode
from agent.core.config import Goto, Hold, Pose
from agent.core.estimation.interface import Bearing, Posterior, Prior
from agent.core.messages import Presence
from agent.core.ranging.fix import Fix
from agent.core.step_io import Heard, Inputs
from agent.core.step_transaction import SURFACE_M
from agent.core.topics import NEAR, Topic
from agent.core.verbs import BEHAVIOURS, Args, HoldHere, Resume, Set, within


class Swim(Capability, PoseSource):
    """Of one robot of a fleet with [navigation], between steps."""

    name: ClassVar[str] = "swim"
    table: ClassVar[str] = "navigation"
    does: ClassVar[str] = "swims"
    lacks: ClassVar[str] = "it is moored: its fleet file has no [navigation]"
    commands: ClassVar[tuple[type, ...]] = (*BEHAVIOURS, Set)
    topics: ClassVar[tuple[Topic, ...]] = (NEAR,)

    def __init__(self, context: Context) -> None:
        self._fleet, self._robot, self._log = context.fleet, context.fleet.robot[context.name], context.log
        self._attitude: AttitudeLog = context.attitude
        made_of = context.fleet, context.name, context.calibration
        self.swimmer = Swimmer(*made_of, context.incarnation, context.attitude)
        self.pursuit = Pursuit(*made_of, self.swimmer, context.attitude)

    # --- what comes in ----------------------------------------------------------------------------------------

    def receive(self, heard: Heard, accepted: frozenset[int]) -> None:
        presence = decode(heard.payload, Presence, NEAR.limit, accepted)
        self.swimmer.deconfliction.neighbours.hear(heard.src, presence, heard.arrived_ns)

    def update(self, inputs: Inputs, situation: Situation) -> Situation:
        now_ns = situation.now_ns
        self.pursuit.see(inputs.sightings)
        self.swimmer.feel(inputs.telemetry)
        seen = inputs.landmarks or (), inputs.flow or ()
        self.swimmer.see(*seen, self._attitude, situation.camera, now_ns)
        neighbours = neighbour_views(self.swimmer.deconfliction.neighbours, now_ns)
        return replace(situation, own=self._own(now_ns), neighbours=neighbours)

    def decide(self, situation: Situation) -> Situation:
        swimmer, now_ns, did = self.swimmer, situation.now_ns, self.swimmer.does
        here = swimmer.localizer.at(now_ns)
        pose = situation.pose if here is None else pose_of(here)
        search = swimmer.heed(replace(situation, pose=pose))
        if swimmer.does != did:
            self._log.note("info", f"{did} is over, now {swimmer.does}", now_ns)
        assert situation.own is not None
        return replace(situation, pose=pose, search=search, own=situation.own._replace(does=swimmer.does))

    def _own(self, now_ns: int) -> OwnView:
        swimmer, here = self.swimmer, self.swimmer.localizer.at(now_ns)
        return OwnView(
            phase=swimmer.phase,
            own=motion(here),
            at_landmarks=swimmer.at_landmarks,
            calm=calm(here),
            does=swimmer.does,
            about=swimmer.about,
            pursues=swimmer.pursues,
            sighted=self.pursuit.sighted,
        )

    def settle(self, situation: Situation) -> Situation:
        """A look for landmarks is over as soon as something else has the camera."""
        if situation.camera_holder != "landmarks":
            self.swimmer.look_back()
        assert situation.own is not None
        return replace(situation, own=situation.own._replace(at_landmarks=self.swimmer.at_landmarks))

    def bearing(self, target: str, believed: Callable[[], Posterior | None], now_ns: int) -> Bearing | None:
        return self.pursuit.bearing(target, believed, now_ns)

    # --- what it wants ----------------------------------------------------------------------------------------

    def propose(self, situation: Situation) -> Iterable[Proposal[Any]]:
        return (
            Proposal("camera", "landmarks", lambda at: self.swimmer.look_for_landmarks(self.pursuit.goes_with(at), at)),
            Proposal("camera", "pursuit", self.pursuit.look),
            Proposal("body", "off", self.swimmer.off),
            Proposal("body", "behaviour", self.swimmer.behave),
            Proposal("body", "stay", self.swimmer.stay),
            Proposal("body", "brake", self.swimmer.brake),
            Proposal("body", "drift", self.swimmer.drift),
        )

    def carry_out(self, command: Args) -> bool:
        match command:
            case HoldHere():
                if command.depth_m is not None:
                    self.swimmer.dive(command.depth_m)
                self.swimmer.active.begin(Hold())
            case Set() if command.name == "speed_m_s":
                assert self._fleet.navigation is not None
                within("value", command.value, 0.01, self._fleet.navigation.limits.speed_m_s)
                self.swimmer.limit_speed(command.value)
            case Resume():
                assert self._fleet.navigation is not None
                self.swimmer.active.resume()
                self.swimmer.dive(self._robot.depth_m)
                self.swimmer.limit_speed(self._fleet.navigation.limits.speed_m_s)
            case _ if isinstance(command, BEHAVIOURS):
                if isinstance(command, Goto) and command.depth_m is not None:
                    within("depth_m", command.depth_m, SURFACE_M, self._fleet.tank.surface_m)
                self.swimmer.active.begin(command)
            case _:
                return False
        return True

    # --- what goes out ----------------------------------------------------------------------------------------

    def outgoing(self, situation: Situation) -> Iterable[Outgoing]:
        return (Outgoing(NEAR, said.dst, said) for said in self.swimmer.say(self._attitude, situation.now_ns))

    def telemetry(self, now_ns: int) -> Mapping[str, Any]:
        return {"whereabouts": self.swimmer.localizer.shown(now_ns), "behaviour": self.swimmer.does}

    def faults(self, now_ns: int) -> tuple[str, ...]:
        return self.swimmer.faults(now_ns)

    # --- where it was -----------------------------------------------------------------------------------------

    @property
    def moves(self) -> bool:
        return True

    @property
    def settling(self) -> bool:
        return self.swimmer.localizer.settling

    def at_sample(self, t_ns: int, now_ns: int) -> Sample | None:
        known = self.swimmer.localizer.of_sample(t_ns, now_ns)
        return None if known is None else Sample(pose_of(known[0]), known[1], known[0])

    def keep(self, target: str, seen: Fix, known: Sample, prior: Prior, now_ns: int) -> None:
        self.swimmer.localizer.sight(target, seen, (known.belief, known.own), prior, now_ns)

    def settled(self, now_ns: int) -> tuple[str, Prior] | None:
        return self.swimmer.localizer.settled(now_ns)

    def thrusts(self, body: BodyAct, now_ns: int) -> None:
        self.swimmer.localizer.sent((*body.force_n, body.moment_nm), now_ns)


def motion(belief: Belief | None) -> Motion | None:
    """Place and velocity by a belief."""
    if belief is None:
        return None
    return Motion((belief.x[0], belief.x[1], belief.x[2]), (belief.x[3], belief.x[4], belief.x[5]))


def neighbour_views(neighbours: Neighbours, now_ns: int) -> tuple[NeighbourView, ...]:
    """Where all neighbours are that ever said so, in the order of their names."""
    looking = neighbours.at_landmarks(now_ns)
    return tuple(
        NeighbourView(
            name=said.src,
            pose=Pose(x_m=said.x_m, y_m=said.y_m, yaw_deg=math.degrees(said.yaw_rad)),
            depth_m=said.depth_m,
            at_landmarks=said.src in looking,
        )
        for said in neighbours.newest()
    )


def swimmer_of(capabilities: Mapping[str, Capability]) -> Swimmer | None:
    """Of one robot; None: it is moored."""
    one = capabilities.get(Swim.name)
    return one.swimmer if isinstance(one, Swim) else None
