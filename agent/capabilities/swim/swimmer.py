"""A robot that swims: where it is, when it looks for landmarks instead of the target, and where it thrusts."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Literal, NamedTuple

from msgspec.structs import replace

from agent.capabilities.swim.barrier import SIGMAS, TARGET_M, Disc, Planar, Reference
from agent.capabilities.swim.barrier import STILL as AT_REST
from agent.capabilities.swim.behaviour import Progress, effective, reference, slowed, start, wanted_velocity, wrench
from agent.capabilities.swim.deconfliction import Deconfliction, Neighbours, direly_unsure, pace
from agent.capabilities.swim.landmark_look import LandmarkLook, Sure, half_picture_deg
from agent.capabilities.swim.landmarks import markers
from agent.capabilities.swim.localizer import (
    AWAY_S,
    LOST_DEG,
    LOST_M,
    STILL,
    SURE_DEG,
    SURE_M,
    SWIFTLY_S,
    UNSURE_DEG,
    UNSURE_M,
    Carriage,
    GimbalHistory,
    Gyro,
    Localizer,
    adrift,
    foresees,
    sigmas,
    within,
)
from agent.capabilities.swim.pose_filter import Belief, Wrench
from agent.capabilities.swim.search import Hunt, Surroundings, velocity_m_s
from agent.core.attitude import Attitude, AttitudeLog, zeros
from agent.core.capability import BodyAct, CameraAct, CameraView, Situation, SwimPhase
from agent.core.config import Behaviour, Fleet, Follow, Goto, Hold, Pose, Robot, Search, Survey
from agent.core.estimation.protocols import dynamics, pursued
from agent.core.linear_algebra import wrap
from agent.core.messages import Presence, Vector
from agent.core.ranging.camera_model import Calibration
from agent.core.ranging.pointing import SearchPlan, all_around, spiral
from agent.core.step_io import Flow, SeenTags, Telemetry
from agent.core.step_transaction import SURFACE_M, Revertible
from agent.core.target_state import TargetEstimate

# --- behaviour in force ---

IN_THE_WAY = "a robot, a target or a wall is in the way, or a pull is too strong; clear the way, or order another place"


class ActiveBehaviour(Revertible):
    """What a robot that swims is told to do, by its fleet file or by order, and how far it is with that."""

    def __init__(self, robot: Robot) -> None:
        self._told = robot.behaviour or Hold()
        pose = robot.pose.x_m, robot.pose.y_m, math.radians(robot.pose.yaw_deg)
        self._home = pose if robot.behaviour is None else None  # what it holds; None: where it finds itself
        self.behaviour, self._to = self._told, self._home
        self.progress: Progress | None = None  # None: it has not begun
        self._before: Progress | None = None  # of what was done until then: the tether's turns go on

    def begin(self, behaviour: Behaviour, to: Vector | None = None) -> None:
        """Do that, from when and where it knows how it swims; to: what Hold holds, if not that place."""
        self.behaviour, self._to = behaviour, to
        self._before, self.progress = self.progress or self._before, None

    def resume(self) -> None:
        """Do what the fleet file says."""
        self.begin(self._told, self._home)

    def reference(self, pose: Vector, now_ns: int, around: Surroundings, watched_m: Planar | None) -> Reference:
        """Where the robot shall be now."""
        before = self.progress or start(pose, self._turned(pose), now_ns, self._to)
        to, self.progress = reference(self.behaviour, before, pose, now_ns, around, watched_m)
        return to

    def fault(self) -> str | None:
        """That it does not get where it is told to, for people."""
        what, progress = self.behaviour, self.progress
        if not isinstance(what, Goto) or progress is None or not progress.approach.fails:
            return None
        return f"goto: no nearer to ({what.x_m:.2f}, {what.y_m:.2f}) for 15 s: {IN_THE_WAY}"

    def _turned(self, pose: Vector) -> float:
        """By how much the body is turned since it was put into the water, rad."""
        return 0.0 if self._before is None else self._before.turned + wrap(pose[2] - self._before.heading)


# --- target context of a behaviour ---

# As long as the target rests, what hides it is remembered for so long that the robot can swim half way round, or it
# would come back to where it saw nothing. Where the target has gone on by so much, something else hides it, or nothing.
SCREEN_NS, SCREENED_M = 20_000_000_000, 0.25
SCREENS_APART_M, MOST_SCREENS = 0.1, 8


class Screen(NamedTuple):
    """Something that hid the target, about there."""

    at_m: Planar
    target_m: Planar
    since_ns: int


class TargetContext(Revertible):
    """What a robot needs to know for a behaviour about a target by name, and where its camera looks meanwhile.

    Of a behaviour that is about no target it knows nothing.
    """

    def __init__(self, fleet: Fleet, calibration: Calibration) -> None:
        assert fleet.navigation is not None
        self._fleet, self._camera, self._swims = fleet, calibration.camera, pursued(fleet)
        self.around = Surroundings(fleet.tank.size_m[:2])
        self.search: SearchPlan | None = None  # by which the camera looks, of a robot that searches
        self._screens: deque[Screen] = deque(maxlen=MOST_SCREENS)
        self.does: Behaviour | None = None  # what is in effect now: Follow may be searching, or waiting

    def heed(
        self, what: Behaviour, progress: Progress | None, neighbours: Neighbours, depth_m: float, situation: Situation
    ) -> None:
        """Once a step, before the camera is granted; depth_m: where the robot hovers."""
        now_ns, size_m = situation.now_ns, self._fleet.tank.size_m[:2]
        self.does = what
        if not isinstance(what, Follow | Search):
            station = situation.station if isinstance(what, Survey) else None
            self.around, self.search = Surroundings(size_m, station=station), None
            return
        target = situation.about(what.target).estimate
        around = Surroundings(
            size_m,
            target=target,
            swims=what.target in self._swims,
            sees=situation.camera.sees(what.target),
            robots_m=tuple(disc.at_m for disc in neighbours.discs(now_ns)),
            screens_m=() if target is None else self.screens_m(target.x_m[:2], now_ns),
        )
        does = self.does = effective(what, Hunt() if progress is None else progress.hunt, around, now_ns)
        spirals = situation.camera.search is not None and situation.camera.search.spirals
        if not isinstance(does, Search):
            self.search = None
        elif self.search is None or self.search.target != does.target:
            self.search = self._plan(does, target, situation.pose, depth_m, now_ns)
            spirals = bool(self.search.spiral)
        self.around = around._replace(
            looks=self.search is not None and target is not None and spirals,
            fellows_m=neighbours.doing(kind(does), what.target, now_ns),
        )

    def _plan(self, what: Search, target: TargetEstimate | None, pose: Pose, depth_m: float, now_ns: int) -> SearchPlan:
        surface_m = self._fleet.tank.surface_m
        around = all_around(self._camera, self._fleet.body, depth_m, surface_m)
        if target is None or what.target in self._swims:  # its gimbal goes all around at once (pursuit.Scan)
            return SearchPlan(what.target, (), around)
        speed_m_s = dynamics(self._fleet.target[what.target]).first_speed_m_s
        reach_deg = _reach_deg(target, speed_m_s, pose, now_ns)
        return SearchPlan(what.target, spiral(self._camera, reach_deg), around)

    def hidden(self, from_m: Planar, at_m: Planar, now_ns: int) -> None:
        """Nothing of the target at at_m is to be seen from there: something unknown is half way, or about."""
        x, y = 0.5 * (from_m[0] + at_m[0]), 0.5 * (from_m[1] + at_m[1])
        if all(math.dist((x, y), other_m) > SCREENS_APART_M for other_m in self.screens_m(at_m, now_ns)):
            self._screens.append(Screen((x, y), at_m, now_ns))

    def screens_m(self, target_m: Planar, now_ns: int) -> tuple[Planar, ...]:
        """What is in the way of the target where it is now."""
        lately = (screen for screen in self._screens if now_ns - screen.since_ns < SCREEN_NS)
        return tuple(screen.at_m for screen in lately if math.dist(screen.target_m, target_m) < SCREENED_M)

    def disc(self, now_ns: int) -> Disc | None:
        """The target, to keep clear of. The robot does not flee from where it only may be."""
        if (target := self.around.target) is None:
            return None
        at_m, velocity = target.x_m[:2], velocity_m_s(target, now_ns)
        return Disc(at_m, TARGET_M, velocity, strays_m=SIGMAS * target.sigma_m, flees=self.around.swims)


def about(what: Behaviour) -> str | None:
    """The name of the target that it is about."""
    return what.target if isinstance(what, Follow | Search) else None


def kind(what: Behaviour) -> str:
    """As the fleet file calls it."""
    return str(what.__struct_config__.tag)


def _reach_deg(target: TargetEstimate, speed_m_s: float, pose: Pose, now_ns: int) -> float:
    """How far beside its last place a target may be seen by now: two sigma, and what it may have gone meanwhile."""
    gone_m = speed_m_s * (now_ns - target.seen_ns) * 1e-9
    distance_m = math.hypot(target.x_m[0] - pose.x_m, target.x_m[1] - pose.y_m)
    return math.degrees(math.atan2(2.0 * target.sigma_m + gone_m, distance_m))


# --- phases of a robot that swims ---
#
#     lost       it does not know where it is
#     afloat     it knows that, and stays there
#     ready      it knows how it moves as well; its camera still turns
#     under_way  it does what it is told
#     halted     it was under way when the module stopped to obey, and may go on at once


DISOBEYED: dict[SwimPhase, SwimPhase] = {"under_way": "halted", "ready": "afloat"}


class Found(NamedTuple):
    """What a step has found out of its own place."""

    located: bool  # it knows where it is
    foresees: bool  # and how it moves, for long enough, with its camera at rest
    rests: bool  # its camera is where it is to be


def after(phase: SwimPhase, what: Found | Literal["disobeyed"]) -> SwimPhase:
    """Once a step, after estimation; and once more where the module does not do what it is told: it is silent, disarmed
    or surfacing."""
    if what == "disobeyed":
        return DISOBEYED.get(phase, phase)
    assert isinstance(what, Found)
    if not what.located:
        return "lost"
    if phase in ("lost", "afloat", "halted") and not what.foresees:
        return "afloat"
    return "under_way" if what.rests or phase in ("under_way", "halted") else "ready"


def knows_its_way(phase: SwimPhase) -> bool:
    """It knows how it moves."""
    return phase in ("ready", "under_way")


# --- swimmer ---

SURFACE_AFTER_NS = 30_000_000_000  # of looking for landmarks in vain
CALM_M_S = 0.15  # an orbit's pace is less, the way to a goal is swum faster
BRAKES_NS = 1_000_000_000  # of one that is lost: five times as long as the pilot's damping takes
# Of a camera that rests where it is to stay: then there is a key frame, and flow. A robot that begins to swim as the
# camera turns back from landmarks has no odometry, and is lost again. (A camera that goes with a target never rests,
# and waits for nothing.)
KEY_NS = 250_000_000
# Shares of what is else too unsure: one that pursues looks later, for less, and what it sees meanwhile counts for less.
PURSUES, BRIEF = 2.2, 0.75
NOTHING = Sure(math.inf, 180.0)
ARRIVED_NS = 500_000_000  # gimbal and lens at rest: a few frames, which may show landmarks where it looks now


class Swimmer(Revertible):
    """Between steps, of one robot of a fleet with `[navigation]`."""

    def __init__(
        self, fleet: Fleet, name: str, calibration: Calibration, incarnation: int, attitude: AttitudeLog
    ) -> None:
        assert fleet.landmarks is not None and fleet.navigation is not None  # a rule of the fleet file
        robot, self.deconfliction, self._attitude = fleet.robot[name], Deconfliction(fleet, name, incarnation), attitude
        self._limits, self.active = fleet.navigation.limits, ActiveBehaviour(robot)
        self._swims, self._budget = pursued(fleet), fleet.budget
        self._depth_m = robot.depth_m
        self._target_context = TargetContext(fleet, calibration)
        self.localizer = Localizer(fleet, calibration)
        self._gyro = Gyro() if fleet.navigation.gyro else None
        half_deg = half_picture_deg(calibration.camera)
        self._landmark_look = LandmarkLook(
            markers(fleet.landmarks).values(), fleet.body, fleet.tank.surface_m, half_deg
        )
        self._at_landmarks = False
        self._swept_ns = 0  # when a sweep was last seen under way
        self.gimbal = GimbalHistory(calibration.camera, fleet.body)
        self._lost_since_ns: int | None = None
        self.phase: SwimPhase = "lost"
        self._still: Reference | None = None  # where it stays, whatever it is told to do

    def feel(self, told: Sequence[Telemetry]) -> None:
        """The gyro's reading, where there is one: of the telemetry since the last step the newest that can be used."""
        if self._gyro is None:
            return
        readings = [reading for telemetry in told if (reading := self._gyro.read(telemetry)) is not None]
        if readings:
            self.localizer.turning(readings[-1])

    def faults(self, now_ns: int) -> tuple[str, ...]:
        """What is wrong with its sensors, its landmarks, its way and its neighbours, for people."""
        gyro = None if self._gyro is None else self._gyro.fault(now_ns)
        found = gyro, self.localizer.fault(), self.active.fault()
        return (*(fault for fault in found if fault is not None), *self.deconfliction.neighbours.faults(now_ns))

    def dive(self, depth_m: float) -> None:
        """Hover there from now on."""
        self._depth_m = depth_m

    def limit_speed(self, most_m_s: float) -> None:
        self._limits = replace(self._limits, speed_m_s=most_m_s)

    @property
    def about(self) -> str | None:
        """The name of the target that its behaviour is about."""
        return about(self.active.behaviour)

    @property
    def does(self) -> str:
        """Its behaviour in effect, as the fleet file calls it."""
        return kind(self._target_context.does or self.active.behaviour)

    def heed(self, situation: Situation) -> SearchPlan | None:
        """What its behaviour goes by in this step; returns how the camera looks for a target that it searches."""
        active, neighbours = self.active, self.deconfliction.neighbours
        self._target_context.heed(active.behaviour, active.progress, neighbours, self._depth_m, situation)
        return self._target_context.search

    def see(
        self, tags: Sequence[SeenTags], flows: Sequence[Flow], attitude: AttitudeLog, camera: CameraView, now_ns: int
    ) -> None:
        """Landmarks and flow of frames; those that were exposed while the gimbal turned say nothing."""
        self.gimbal.add(camera)
        if camera.measuring:
            self._swept_ns = now_ns
        lens = {frame.t_ns: frame.focus for frame in tags}
        for frame in tags:
            if self._at_landmarks and frame.t_ns >= camera.nearly_from_ns:
                self._landmark_look.add_frame(bool(frame.tags))
            carriage = self._carriage_at(frame.t_ns, attitude)
            if carriage is not None:
                self.localizer.see(frame, carriage)
        for flow in flows:
            then, now = self._carriage_at(flow.since_ns, attitude), self._carriage_at(flow.t_ns, attitude)
            if then is not None and now is not None:
                others_m = self.deconfliction.neighbours.places()
                self.localizer.follow(flow, then, now, lens.get(flow.t_ns), others_m)
        self.localizer.advance(now_ns)
        here = self.localizer.at(now_ns)
        located = here is not None and within(here, LOST_M, LOST_DEG)
        ahead_s = SWIFTLY_S if self.pursues is not None else AWAY_S
        knows = here is not None and foresees(here, ahead_s) and camera.steady(now_ns)
        goes = camera.search is not None or self.pursues is not None  # a gimbal that never rests
        rests = (goes or camera.steady(now_ns - KEY_NS)) and not self._at_landmarks
        self.phase = after(self.phase, Found(located, knows, rests))
        self._lost_since_ns = None if located else self._lost_since_ns or now_ns

    def _carriage_at(self, t_ns: int, attitude: AttitudeLog) -> Carriage | None:
        """Level and gimbal at that time; None: one of them is not known."""
        level, gimbal = attitude.at(t_ns), self.gimbal.at(t_ns)
        if level is None or gimbal is None:
            return None
        return Carriage(level, gimbal, zeros(self._budget, attitude.on_s(t_ns)))

    @property
    def under_way(self) -> bool:
        """It does what it is told: it knows where it is and how it moves, and its camera is where it is to be."""
        return self.phase == "under_way"

    @property
    def pursues(self) -> str | None:
        """The target of its behaviour, where that swims."""
        return self.about if self.about in self._swims else None

    @property
    def search(self) -> SearchPlan | None:
        """How its camera looks for a target that it searches."""
        return self._target_context.search

    @property
    def at_landmarks(self) -> bool:
        """Its camera is turned to landmarks."""
        return self._at_landmarks

    @property
    def fellows_m(self) -> tuple[Planar, ...]:
        """Where those are that do the same about the same target."""
        return self._target_context.around.fellows_m

    def hidden(self, at_m: Vector, now_ns: int) -> None:
        """The target that is there is not in sight from here."""
        if (here := self.localizer.at(now_ns)) is not None:
            self._target_context.hidden(here.pose[:2], (at_m[0], at_m[1]), now_ns)

    @property
    def lost(self) -> bool:
        """It does not know where it is."""
        return self.phase == "lost"

    def look_for_landmarks(self, pursues: bool, situation: Situation) -> CameraAct | None:
        """Turn the camera to landmarks where that is due; None: it is not. Not while a sweep is under way; after it the
        lens is sharp again first, and may show enough where it is. pursues: else the camera goes with a target that
        swims."""
        now_ns, camera, level = situation.now_ns, situation.camera, situation.level
        here, steady, knows_way = self.localizer.at(now_ns), camera.steady(now_ns), knows_its_way(self.phase)
        swift = knows_way and pursues  # what swims does not wait, and landmarks pass behind it
        brief = self._at_landmarks and swift
        enough = (SURE_M, SURE_DEG) if self._at_landmarks else (UNSURE_M, UNSURE_DEG)
        if swift:
            share = BRIEF if brief else PURSUES
            enough = share * UNSURE_M, share * UNSURE_DEG
        moves = knows_way and (not self._at_landmarks or brief or (here is not None and foresees(here)))
        sure = here is not None and within(here, *enough) and moves
        # A robot that searches watches nothing, and one that does not know how it swims cannot search.
        searches = self._target_context.search is not None and not knows_way
        waits = self.deconfliction.waits(here, self._at_landmarks, now_ns) and not searches
        blind = now_ns - max(self.localizer.fixed_ns, self._swept_ns) > ARRIVED_NS
        dire = blind and here is not None and direly_unsure(here)
        if level is None or sure or waits or not (steady or dire or self._at_landmarks or searches):
            self._at_landmarks = False
            return None
        if not self._at_landmarks:
            if not dire and now_ns <= max(camera.steady_from_ns, self._swept_ns) + ARRIVED_NS:
                return CameraAct()
            self._at_landmarks = True
            self._landmark_look.reset()
        pose, known = (None, NOTHING) if here is None or adrift(here) else (situation.pose, Sure(*sigmas(here)))
        from_deg = camera.gimbal_deg if swift else None
        aim_deg = self._landmark_look.direction_deg(pose, known, level, steady, now_ns, from_deg)
        return CameraAct(aim_deg, "track" if swift else "rest")

    def look_back(self) -> None:
        """The camera is not at landmarks any more."""
        self._at_landmarks = False

    def beside_deg(
        self, way_deg: tuple[float, float], most_deg: float, before_deg: float, level: Attitude, now_ns: int
    ) -> float:
        """How far above a target to look, see LandmarkLook.tilt_aside_deg; straight at it where the robot is lost."""
        here = self.localizer.at(now_ns)
        if here is None or adrift(here):
            return 0.0
        return self._landmark_look.tilt_aside_deg(way_deg, most_deg, before_deg, pose_of(here), level)

    # --- body, row by row of the table of priorities ---

    def off(self, situation: Situation) -> BodyAct | None:
        """No thrust where the module does not obey, or it is not known where the robot is."""
        here, allowed = self.localizer.at(situation.now_ns), self._attitude.obeys(situation.now_ns)
        if not allowed:
            self.phase = after(self.phase, "disobeyed")  # one that lies still has to know its motion anew to begin
        if not situation.light.still or here is None:
            self._still = None
        elif self._still is None:
            self._still = Reference(here.pose[:2], here.pose[2])
        lies = here is None or not allowed or adrift(here)
        return self._asked(STILL, situation.now_ns) if lies else None

    def behave(self, situation: Situation) -> BodyAct | None:
        """Do what it is told; not while light is lent: that stays where it is."""
        here = self.localizer.at(situation.now_ns)
        if here is None or not self.under_way or self._still is not None:
            return None
        return self._asked(self._towards(here, situation), situation.now_ns)

    def stay(self, situation: Situation) -> BodyAct | None:
        """Stay where it is, but out of the way of others."""
        here = self.localizer.at(situation.now_ns)
        if here is None or self.lost:
            return None
        to = self._still or Reference(here.pose[:2], here.pose[2])
        return self._asked(self._stays(here, to, situation.now_ns), situation.now_ns)

    def brake(self, situation: Situation) -> BodyAct | None:
        """Come to rest, as soon as it is lost."""
        here, since_ns, now_ns = self.localizer.at(situation.now_ns), self._lost_since_ns, situation.now_ns
        if here is None or since_ns is None or now_ns - since_ns >= BRAKES_NS:
            return None
        return self._asked(wrench(here, self.localizer.hull, Reference(here.pose[:2], here.pose[2]), AT_REST), now_ns)

    def drift(self, situation: Situation) -> BodyAct:
        """No thrust: what it leans against may be drag that it believed wrong, and gone with its speed."""
        return self._asked(STILL, situation.now_ns)

    def _asked(self, asked: Wrench, now_ns: int) -> BodyAct:
        ahead_n, left_n, moment_nm = asked
        return BodyAct((ahead_n, left_n), moment_nm, self.depth_m(now_ns))

    def _stays(self, here: Belief, to: Reference, now_ns: int) -> Wrench:
        """There, but out of the way of others: a robot that drifts is pulled into them."""
        velocity = self.deconfliction.velocity(wanted_velocity(here, to), here, to, (), now_ns)
        return wrench(here, self.localizer.hull, to, velocity)

    def _towards(self, here: Belief, situation: Situation) -> Wrench:
        """Where its behaviour in effect wants it, and out of the way of others."""
        now_ns, limits, share, context = situation.now_ns, self._limits, pace(here), self._target_context
        most_m_s, most_rad_s = share * limits.speed_m_s, share * math.radians(limits.turn_deg_s)
        around = context.around._replace(velocity_m_s=(here.x[3], here.x[4]), speed_m_s=most_m_s)
        watched_m = situation.target.believed_m
        to = self.active.reference(here.pose, now_ns, around, None if watched_m is None else watched_m[:2])
        if to.coast:
            return STILL
        rate_rad_s = min(max(to.rate_rad_s, -most_rad_s), most_rad_s)
        turns = 0.0 if self._at_landmarks else 1.0  # the gimbal would look past the landmarks
        turn_rad_s = turns * min(most_rad_s - abs(rate_rad_s), to.most_rad_s)
        to = to._replace(speed_m_s=min(most_m_s, to.most_m_s), rate_rad_s=rate_rad_s, turn_rad_s=turn_rad_s)
        if to.depth_m is not None:
            self._depth_m = to.depth_m
        wanted = slowed(wanted_velocity(here, to), most_m_s)
        velocity = self.deconfliction.velocity(wanted, here, to, self._targets(situation), now_ns)
        return wrench(here, self.localizer.hull, to, velocity)

    def _targets(self, situation: Situation) -> tuple[Disc, ...]:
        """All targets whose places are known, to keep clear of."""
        followed, name = self._target_context.disc(situation.now_ns), self.about
        known = ((each.name, each.believed_m) for each in situation.targets)
        others = (Disc(at_m[:2], TARGET_M) for each, at_m in known if at_m is not None and each != name)
        return (*others,) if followed is None else (followed, *others)

    def say(self, attitude: AttitudeLog, now_ns: int) -> tuple[Presence, ...]:
        """Where it is or may be, and where it goes, to each neighbour; nothing before it has found itself."""
        here = self.localizer.at(now_ns)
        if (newest := attitude.newest) is None or not self.deconfliction.due(now_ns) or here is None:
            return ()
        return self.deconfliction.say(here, self.does, self.about, self._at_landmarks, newest.depth_m, now_ns)

    def depth_m(self, now_ns: int) -> float:
        """Where it hovers: at its depth, or at the surface when it has been lost for too long."""
        lost = self._lost_since_ns is not None and now_ns - self._lost_since_ns > SURFACE_AFTER_NS
        return SURFACE_M if lost else self._depth_m


def calm(here: Belief | None) -> bool:
    """Whether a sweep may begin: it takes seconds, some of them too blurred for tags, in which a robot on its way would
    get lost."""
    return here is not None and math.hypot(here.x[3], here.x[4]) < CALM_M_S


def pose_of(belief: Belief) -> Pose:
    x, y, psi = belief.pose
    return Pose(x_m=x, y_m=y, yaw_deg=math.degrees(psi))
