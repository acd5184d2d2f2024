"""A survey as part of a robot's step: who swims where, where the camera looks, what is taken in and told.

Of a fleet without [coverage] it does nothing; of a robot with another behaviour than `survey` it keeps the map, and
passes on what others saw.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import UNSET, UnsetType

from agent.capabilities.light.proof import Spoiled
from agent.capabilities.light.view_light import ViewLight
from agent.capabilities.survey.exchange import Exchange
from agent.capabilities.survey.survey import Surveyor
from agent.capabilities.swim.swimmer import Swimmer, pose_of
from agent.core.attitude import Attitude, AttitudeLog
from agent.core.capability_messages import Claim, Keyframe
from agent.core.codec import Refusal, decode
from agent.core.config import Fleet
from agent.core.control.target_search import Seek
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, Eye
from agent.core.status import Status
from agent.core.step_io import BlockPeaks, Heard, SweepPlan
from agent.core.step_transaction import Revertible
from agent.core.topics import CLAIM, KEYFRAME

STILL_M_S, STILL_RAD_S = 0.03, math.radians(3.0)  # a sweep takes seconds, and its frames have to lie on each other
STEADY_NS = 300_000_000  # of a gimbal at rest, and of a body that a turn of it moved


class Swept(NamedTuple):
    """What a sweep showed, and from where."""

    peaks: BlockPeaks
    eye: Eye | None  # None: nobody knows well enough
    hulls_m: tuple[Vector, ...]  # of other robots, world frame


class Conduct(Revertible):
    """Of one robot, between steps."""

    def __init__(
        self,
        fleet: Fleet,
        name: str,
        calibration: Calibration,
        incarnation: int,
        swimmer: Swimmer | None,
        light: ViewLight,
    ) -> None:
        self._fleet, self._name, self._swimmer, self._light = fleet, name, swimmer, light
        self._swept: Swept | None = None  # a sweep that is over, and may not count
        self.surveyor = None if fleet.coverage is None else Surveyor(fleet, name, calibration, incarnation)
        self.exchange = None if self.surveyor is None else Exchange(fleet, name, incarnation, self.surveyor.known)

    def hear(self, heard: Heard, accepted: frozenset[int]) -> None:
        """A payload on a key of a survey's. Raises Refusal where it is not believed."""
        if self.exchange is None:
            raise Refusal("fleet file", "it surveys, and our file has no [coverage]; give all robots the same file")
        if heard.topic == CLAIM.name:
            claim = decode(heard.payload, Claim, CLAIM.limit, accepted)
            self.exchange.hear_claim(heard.src, claim, heard.arrived_ns)
        else:
            said = decode(heard.payload, Keyframe, KEYFRAME.limit, accepted)
            self.exchange.hear_keyframe(heard.src, said, heard.arrived_ns)

    def see(
        self, blocks: tuple[BlockPeaks, ...], attitude: AttitudeLog, seek: Seek, status: Status, now_ns: int
    ) -> None:
        """What sweeps showed that ended since the last step."""
        if (surveyor := self.surveyor) is None:
            return
        for peaks in blocks:
            if surveyor.awaits(peaks) and self._swept is None:
                self._swept = Swept(peaks, self._eye(peaks.t_ns, attitude, seek), self._hulls())
                self._light.ended(now_ns)
        if self._swept is not None and (found := self._light.verdict(now_ns)) is not None:
            swept, self._swept = self._swept, None
            if isinstance(found, Spoiled):
                surveyor.give_up(now_ns)
                status.log.note("info", f"view {swept.peaks.sweep} was spoiled: {found.reason}", now_ns)
            elif (made := surveyor.see(swept.peaks, swept.eye, swept.hulls_m, now_ns)) is None:
                status.log.note("info", f"view {swept.peaks.sweep} gave no keyframe", now_ns)
            else:
                share = round(100 * surveyor.known.share())
                status.log.note("info", f"keyframe {made.number}, {share} % of the tank is known", now_ns)
        if self._swept is None and surveyor.missed(now_ns):
            self._light.missed(now_ns)
            status.log.note("warning", "a view's sweep did not end in time", now_ns)
        seek.surveys = surveyor.phase == "sweep"

    def act(self, seek: Seek, level: Attitude | None, status: Status, now_ns: int) -> tuple[bool, SweepPlan | None]:
        """Whether the camera is a survey's now, and the plan of a sweep that shall begin."""
        surveyor, exchange = self.surveyor, self.exchange
        if surveyor is None or exchange is None or surveyor.done or seek.pointing.goal_us is None:
            return False, None
        if seek.measuring and not seek.surveys:  # of a target, from before it knew how it swims
            return False, None
        pose, rests = seek.pose, True
        if self._swimmer is not None:
            here = self._swimmer.here
            if here is None or not self._swimmer.under_way:
                return False, None
            rests = math.hypot(here.x[3], here.x[4]) < STILL_M_S and abs(here.x[5]) < STILL_RAD_S
        claims = tuple(view for _, view in exchange.claims(now_ns))
        surveyor.choose(pose, claims, self._others(exchange, now_ns), now_ns)
        surveyor.swim(pose, rests, now_ns)
        if surveyor.done:
            status.log.note("info", "the survey is over: all that was asked for is known", now_ns)
            return False, None
        if surveyor.phase != "look" or level is None:
            return True, None
        seek.look(*surveyor.gimbal_deg(pose), now_ns)
        rests = rests and seek.pointing.steady(now_ns - STEADY_NS)
        if rests and not self._light.lets(surveyor, seek, level, now_ns):
            return True, None
        plan = surveyor.sweep(rests, now_ns)
        seek.surveys = plan is not None
        if plan is not None:
            self._light.began(now_ns)
        return True, plan

    def goal(self) -> tuple[tuple[float, float], float] | None:
        """Where a robot that swims shall be, and how turned; None: where it is."""
        station = None if self.surveyor is None else self.surveyor.station
        return None if station is None else (station.place_m, station.yaw)

    def say(self, now_ns: int) -> tuple[tuple[Claim, ...] | UnsetType, tuple[Keyframe, ...] | UnsetType]:
        """What is told to neighbours in this step."""
        if self.surveyor is None or self.exchange is None:
            return UNSET, UNSET
        self.exchange.end_step()
        claims = self.exchange.say(self.surveyor.view, self.surveyor.until_ns(now_ns), now_ns)
        return claims or UNSET, self.exchange.send(now_ns) or UNSET

    def _others(self, exchange: Exchange, now_ns: int) -> tuple[tuple[float, float], ...]:
        """Places of robots that swim and claim no view."""
        if self._swimmer is None:
            return ()
        claiming = {name for name, _ in exchange.claims(now_ns)}
        return tuple(place[:2] for place in self._swimmer.company.neighbours.places(claiming))

    def _hulls(self) -> tuple[Vector, ...]:
        """Where other robots are, world frame: as they say, or where they are moored."""
        surface_m = self._fleet.tank.surface_m
        if self._swimmer is not None:
            return tuple((x, y, surface_m - depth) for x, y, depth in self._swimmer.company.neighbours.places())
        others = (robot for name, robot in self._fleet.robot.items() if name != self._name)
        return tuple((robot.pose.x_m, robot.pose.y_m, surface_m - robot.depth_m) for robot in others)

    def _eye(self, t_ns: int, attitude: AttitudeLog, seek: Seek) -> Eye | None:
        """Where the camera was; None: nobody knows well enough."""
        level = attitude.at(t_ns)
        if level is None:
            return None
        if self._swimmer is None:
            return seek.eye(level)
        known = self._swimmer.localizer.of_sample(t_ns, t_ns)
        return None if known is None else seek.eye(level, pose_of(known[0]))
