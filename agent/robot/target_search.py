"""Find a target, keep it in the middle of the image, and measure it with the lens again and again; and, of several
targets, which one the camera looks at.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

from msgspec.structs import replace

from agent.core.attitude import Attitude
from agent.core.capability import CameraAct, CameraView, LightView, SearchView, Situation
from agent.core.config import Fleet, Pose, Robot
from agent.core.messages import Vector
from agent.core.ranging.camera_model import (
    Calibration,
    Eye,
    camera_pose,
    gimbal_deg,
    look_at,
    ray,
    servos_us,
    sweep_waits_ns,
    to_world,
)
from agent.core.ranging.pointing import Pointing, Search, SearchPattern, SearchPlan, off_centre_px, reachable
from agent.core.ranging.sweep import SLACK_NS, ByLight, Measurement, Rejected, Sweep, SweepPhase, outline_of
from agent.core.ranging.sweep import next_phase as next_sweep_phase
from agent.core.step_io import Sighting, SweepPlan, Telemetry
from agent.core.step_transaction import Revertible

CENTRED = 0.09  # share of the image width: nearer to the middle than this, the gimbal stays still
IN_VIEW_NS = 600_000_000  # two frames between sweeps
LOST_NS = 1_200_000_000  # not found for this long, with the gimbal at rest


class FixedFocus(Revertible):
    """In place of a `Sweep` where the focus is fixed: the next frame, for the target's size in it has the range.

    Nothing moves the lens, and there is no plan: it takes a frame of those between sweeps.
    """

    most_ns = SLACK_NS  # as of a sweep

    def __init__(self) -> None:
        self._number = 0
        self.phase: SweepPhase = "ready"
        self._from_ns = 0  # frames exposed later count
        self._seen: Sighting | None = None  # the first of them

    @property
    def running(self) -> bool:
        return self.phase == "running"

    def ready(self, now_ns: int) -> bool:
        return not self.running

    def start(self, now_ns: int, by_light: ByLight | None = None) -> None:
        self.phase = next_sweep_phase(self.phase, "start")
        self._number, self._from_ns, self._seen = self._number + 1, now_ns, None

    def frame(self, sighting: Sighting) -> None:
        if self.running and self._seen is None and sighting.t_ns >= self._from_ns:
            self._seen = sighting

    def telemetry(self, telemetry: Telemetry) -> None:
        """One frame needs no robot that stays still."""

    def finish(self, now_ns: int) -> Measurement | Rejected | None:
        seen = self._seen
        if not self.running or (seen is None and now_ns < self._from_ns + SLACK_NS):
            return None
        self.phase = next_sweep_phase(self.phase, "end")
        if seen is None or seen.centre_px is None:
            return Rejected(self._number, "no frame in time" if seen is None else "target not seen in the frame")
        return Measurement(self._number, seen.t_ns, None, 0.0, 0.0, None, outline_of(seen), seen.score)

    def take_back(self) -> None:
        """No measurement goes by another."""

    def remark(self) -> str | None:
        return None

    def forget(self) -> None:
        self.phase = next_sweep_phase(self.phase, "lose")


class TargetMemory(Revertible):
    """What is remembered of one target, also while the camera looks at another."""

    def __init__(self, fleet: Fleet, calibration: Calibration) -> None:
        fit, steps = calibration.focus, fleet.camera.sweep_steps
        waits_ns = sweep_waits_ns(calibration.timing, steps)
        self.sweep = FixedFocus() if fit is None else Sweep(fit, steps, waits_ns)
        self.search = Search()
        self.seen: Sighting | None = None  # newest frame with the target in it, gimbal at rest where it is now

    def saw(self, sighting: Sighting | None) -> None:
        """A frame shows it; None: the gimbal looks elsewhere now."""
        self.seen = sighting

    def in_view(self, now_ns: int) -> bool:
        return self.seen is not None and now_ns - self.seen.t_ns < IN_VIEW_NS


CameraPhase = Literal["there", "away"]  # the gimbal's goal is the target's, or another holder's of the camera
CameraEvent = Literal["granted", "turned"]


def next_phase(phase: CameraPhase, event: CameraEvent) -> CameraPhase:
    """The camera was granted to the target, or another holder of it has turned the gimbal."""
    return "there" if event == "granted" else "away"


class TargetSearch(Revertible):
    """Gimbal and lens of one robot. They serve one target at a time; `act` is told which."""

    def __init__(self, fleet: Fleet, robot: Robot, calibration: Calibration) -> None:
        self._fleet, self._robot, self._camera = fleet, robot, calibration.camera
        self.pointing = Pointing()
        self._pattern: SearchPattern | None = None  # of a robot that searches
        self._memory = {target: TargetMemory(fleet, calibration) for target in fleet.target}
        self._target = next(iter(fleet.target))  # the one that gimbal and lens serve
        self._phase: CameraPhase = "there"
        self._lit_seen_m: Vector | None = None  # the lit place that the gimbal was turned to
        self._view_sweep = False  # a sweep over whole frames is under way, of no target
        self._look_us = self._pulses_us(robot.look.pan_deg, robot.look.tilt_deg)
        self._at_deg = self._look_us, gimbal_deg(self._camera, fleet.body, self._look_us)  # goal, and where that is

    @property
    def measuring(self) -> bool:
        """A sweep is under way."""
        return self._view_sweep or self._memory[self._target].sweep.running

    def search(self, plan: SearchPlan | None) -> None:
        """Look by that plan from now on, or go on with it; None: there is no search."""
        if plan is None:
            self._pattern = None
        elif self._pattern is None or self._pattern.target != plan.target:
            self._pattern = SearchPattern(*plan)

    def view_sweep(self, runs: bool) -> None:
        """Whether a sweep over whole frames is under way, of no target."""
        self._view_sweep = runs

    def view(self, now_ns: int) -> CameraView:
        """Gimbal and lens, as others may know them."""
        at, memory, pattern = self.pointing, self._memory[self._target], self._pattern
        running, in_view = memory.sweep.running, memory.in_view(now_ns)
        return CameraView(
            goal_us=at.goal_us,
            gimbal_deg=self.gimbal_deg(),
            told_ns=at.told_ns,
            last_leg_ns=at.last_leg_ns,
            steady_from_ns=at.steady_from_ns,
            tracks=at.tracks,
            sweep="view" if self._view_sweep else "target" if running else "none",
            target=self._target,
            seen=memory.seen,
            in_view=in_view,
            ready=self._phase == "there" and not self.measuring and memory.sweep.ready(now_ns),
            most_sweep_ns=memory.sweep.most_ns,
            search=None if pattern is None else SearchView(pattern.target, pattern.found, pattern.spirals),
        )

    def see(self, told: Iterable[Telemetry], sightings: Iterable[Sighting], light: LightView) -> None:
        """Take in what came since the last step. light: by which the frames were seen."""
        for telemetry in told:
            self.add_telemetry(telemetry)
        for sighting in sightings:
            self.add_sighting(sighting, light)

    def add_sighting(self, sighting: Sighting, light: LightView) -> None:
        """Take note of one frame, seen by that light."""
        memory = self._memory.get(sighting.target)
        if memory is None:
            return
        memory.sweep.frame(sighting)
        if sighting.found and sighting.t_ns >= self.pointing.steady_from_ns:
            memory.saw(sighting)
        if (
            self._pattern is not None
            and sighting.target == self._pattern.target
            and sighting.t_ns >= self.pointing.nearly_from_ns
            and light.from_ns is not None
            and sighting.t_ns >= light.from_ns
        ):
            self._pattern.add_frame(sighting.found)

    def add_telemetry(self, telemetry: Telemetry) -> None:
        """Take note of how still the robot is."""
        self._memory[self._target].sweep.telemetry(telemetry)

    def finish(self, now_ns: int) -> Measurement | Rejected | None:
        """The result of the sweep that ended since the last call, if one did; it is about the target of `act`."""
        return self._memory[self._target].sweep.finish(now_ns)

    def take_back(self) -> None:
        """Forget the sweep that ended last: the next one goes by what was known before it."""
        self._memory[self._target].sweep.take_back()

    def remark(self) -> str | None:
        """What a full sweep showed about the lens, once."""
        return self._memory[self._target].sweep.remark()

    def act(self, situation: Situation, wanted: ByLight | bool) -> SweepPlan | None:
        """Move the gimbal if it must move, for the watched target; else, if a measurement is wanted and possible, start
        a sweep (of which there is no plan where the focus is fixed). A sweep that runs has to end before another target
        may be watched. wanted: by which light, or at all.
        """
        now_ns, target = situation.now_ns, situation.watched
        memory, another = self._memory[target], target != self._target or self._phase == "away"
        self._target, self._phase = target, next_phase(self._phase, "granted")
        if self.pointing.goal_us is None:
            self._aim(self._look_us, now_ns)
        if memory.sweep.running:
            return None
        if (
            self._pattern is not None
            and self._pattern.target == target
            and self._pattern.empty
            and not memory.in_view(now_ns)
        ):
            self._pattern.advance()
            another = True
        if self._goes_to_light(memory, situation) or not (another or self.pointing.steady(now_ns)):
            return None
        if memory.seen is not None and memory.seen.centre_px is not None and memory.in_view(now_ns):
            memory.search.reset()
            off_px = off_centre_px(memory.seen.centre_px, self._camera.width_px, self._camera.height_px)
            if off_px <= CENTRED * self._camera.width_px:
                if not wanted or situation.level is None or not memory.sweep.ready(now_ns):
                    return None
                plan = memory.sweep.start(now_ns, wanted if isinstance(wanted, ByLight) else None)
                return replace(plan, target=target) if plan is not None and len(self._memory) > 1 else plan
            self._turn_to_pixel(memory.seen.centre_px, situation)
        elif another:  # the camera was elsewhere: nothing to wait for, and the last peak still holds
            self._look_around(memory.search, situation)
        elif self._lost(memory, situation):
            memory.sweep.forget()
            self._look_around(memory.search, situation)
        return None

    def carry_out(self, act: CameraAct, now_ns: int) -> None:
        """What another holder of the camera wants of gimbal and lens. The next `act` turns the camera back, unless the
        target of that is tracked."""
        if act.aim_deg is not None:
            goal_us = self._pulses_us(*act.aim_deg)
            self._phase = next_phase(self._phase, "turned" if act.target is None else "granted")
            self._target = act.target or self._target
            if act.mode == "track":
                self.pointing.track(goal_us, now_ns)
            else:
                self._aim(goal_us, now_ns)
        of_view = act.plan is not None and not self._memory[self._target].sweep.running
        self._view_sweep = self._view_sweep or of_view

    def _goes_to_light(self, memory: TargetMemory, situation: Situation) -> bool:
        """Turn to what is lit, once, where nothing is seen and no neighbour has told anything; whether that was now."""
        before, self._lit_seen_m = self._lit_seen_m, situation.light.place_m
        lit_m, told_m = situation.light.place_m, situation.target.believed_m
        if lit_m is None or lit_m == before or told_m is not None or memory.in_view(situation.now_ns):
            return False
        self._turn_to_point(lit_m, situation, (0.0, 0.0))
        return True

    def _lost(self, memory: TargetMemory, situation: Situation) -> bool:
        if situation.light.from_ns is None:
            return False
        seen_ns = memory.seen.t_ns if memory.seen else 0
        return situation.now_ns - max(seen_ns, self.pointing.steady_from_ns, situation.light.from_ns) > LOST_NS

    def eye(self, level: Attitude, pose: Pose) -> Eye:
        """Where the camera is while the gimbal rests at its goal."""
        return camera_pose(pose, self._fleet.body, *level, *self.gimbal_deg(), self._fleet.tank.surface_m)

    def gimbal_deg(self) -> tuple[float, float]:
        """Pan and tilt at rest at the goal, by calibration."""
        goal_us = self.pointing.goal_us or self._look_us
        if self._at_deg[0] != goal_us:
            self._at_deg = goal_us, gimbal_deg(self._camera, self._fleet.body, goal_us)
        return self._at_deg[1]

    def _level(self, situation: Situation) -> Attitude:
        return situation.level or Attitude(self._robot.depth_m, 0.0, 0.0)

    def _turn_to_pixel(self, centre_px: tuple[float, float], situation: Situation) -> None:
        eye = self.eye(self._level(situation), situation.pose)
        self._turn_to_point(to_world(eye, ray(self._camera, centre_px)), situation, (0.0, 0.0))  # 1 m away

    def _look_around(self, search: Search, situation: Situation) -> None:
        told_m, now_ns = situation.target.believed_m, situation.now_ns
        if self._pattern is not None and self._pattern.target == self._target:
            self._look_on(self._pattern, situation)
        elif told_m is None:
            self._aim(self._look_us, now_ns)
        else:
            self._turn_to_point(told_m, situation, search.offset_deg(self.pointing.steady(now_ns), now_ns))

    def _look_on(self, pattern: SearchPattern, situation: Situation) -> None:
        offset, told_m = pattern.offset_deg, situation.target.believed_m
        if offset is not None and told_m is not None:
            self._turn_to_point(told_m, situation, offset)
        else:
            self._aim(self._pulses_us(*pattern.way_deg), situation.now_ns)

    def _turn_to_point(self, point: Vector, situation: Situation, offset_deg: tuple[float, float]) -> None:
        level, surface_m = self._level(situation), self._fleet.tank.surface_m
        pan, tilt = look_at(point, situation.pose, self._fleet.body, *level, surface_m)
        self._aim(self._pulses_us(pan + offset_deg[0], tilt + offset_deg[1]), situation.now_ns)

    def _pulses_us(self, pan_deg: float, tilt_deg: float) -> tuple[int, int]:
        return reachable(servos_us(self._camera, self._fleet.body, pan_deg, tilt_deg))

    def _aim(self, goal_us: tuple[int, int], now_ns: int) -> None:
        if goal_us != self.pointing.goal_us:
            for memory in self._memory.values():
                memory.saw(None)  # its pixel belongs to the old direction
            self.pointing.aim(goal_us, now_ns)


# --- target scheduler ---
# A camera looks at one target at a time, and only the target that is looked at iterates. The rule: a turn lasts until
# the target's iteration index passes a multiple of TURN; then the target with the lowest index is next, in the order of
# the fleet file where they are equal. The index is one that all robots of a swarm share (a robot that is behind adopts
# that of its neighbours), so all of them look at the same target at the same time, from their different sides, without
# having to ask: each target's valid set is as large as it can be.
#
# A target that no robot has seen yet has its turns like the others; the camera then rests where `look` in the fleet
# file points.
#
# No target starves. A turn ends after TURN iterations, whatever the camera sees. Indices that come from elsewhere may
# keep a target from ever being the lowest (a neighbour that knows one target only drives that one): a target that has
# been passed over for PATIENCE turns of each of the others is next.

TURN = 5  # iterations: one goes by while the gimbal turns, and a search looks in two directions
PATIENCE = 2


class TargetScheduler(Revertible):
    """Whose turn it is."""

    def __init__(self, targets: tuple[str, ...]) -> None:
        """There must be a target. The first has the first turn."""
        self.target = targets[0]
        self._waits = dict.fromkeys(targets, 0)  # turns of others since its own; keys in the order of the fleet file
        self._ends_at = TURN

    def next(self, t: Mapping[str, int], pursued: str | None = None) -> str:
        """Whose turn it is now; asked when no measurement is under way. `t`: the iteration index of each target.
        pursued: a target that the camera tracks; it takes no turns meanwhile."""
        if pursued is not None:
            self.target = pursued
        if pursued is not None or len(self._waits) == 1 or t[self.target] < self._ends_at:
            return self.target
        longest = max(self._waits, key=lambda name: self._waits[name])  # the first of equals
        overdue = self._waits[longest] > PATIENCE * (len(self._waits) - 1)
        self.target = longest if overdue else min(self._waits, key=lambda name: t[name])
        self._waits = {name: 0 if name == self.target else waited + 1 for name, waited in self._waits.items()}
        self._ends_at = (t[self.target] // TURN + 1) * TURN
        return self.target
