"""Find a target, keep it in the middle of the image, and measure it with the lens again and again; and, of several
targets, which one the camera looks at.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from agent.core.attitude import Attitude
from agent.core.config import Fleet, Pose, Robot
from agent.core.control.pointing import Pointing, Search, off_centre_px, reachable
from agent.core.control.search_pattern import Roam
from agent.core.control.sweep import ByLight, Measurement, Rejected, Sweep
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, Eye, camera_pose, gimbal_deg, look_at, ray, servos_us, to_world
from agent.core.step_io import Sighting, SweepPlan, Telemetry
from agent.core.step_transaction import Revertible

CENTRED = 0.09  # share of the image width: nearer to the middle than this, the gimbal stays still
IN_VIEW_NS = 600_000_000  # two frames between sweeps
LOST_NS = 1_200_000_000  # not found for this long, with the gimbal at rest


class TargetMemory(Revertible):
    """What is remembered of one target, also while the camera looks at another."""

    def __init__(self, fleet: Fleet, calibration: Calibration) -> None:
        self.sweep = Sweep(calibration.focus, fleet.camera.sweep_steps)
        self.search = Search()
        self.seen: Sighting | None = None  # newest frame with the target in it, gimbal at rest where it is now

    def in_view(self, now_ns: int) -> bool:
        return self.seen is not None and now_ns - self.seen.t_ns < IN_VIEW_NS


class Seek(Revertible):
    """Gimbal and lens of one robot. They serve one target at a time; `act` is told which."""

    def __init__(self, fleet: Fleet, robot: Robot, calibration: Calibration) -> None:
        self._fleet, self._robot, self._camera = fleet, robot, calibration.camera
        self.pointing = Pointing()
        self.pose = robot.pose  # of a robot that swims the caller updates it
        self.roam: Roam | None = None  # of a robot that searches the caller sets it
        self._memory = {target: TargetMemory(fleet, calibration) for target in fleet.target}
        self._target = next(iter(fleet.target))  # the one that gimbal and lens serve
        self._elsewhere = False  # the gimbal was turned away from it, on purpose
        self.lit_from_ns: int | None = 0  # since when it is light where the camera looks; None: dark, nothing shows
        self.by_light: ByLight | None = None  # of a fleet that lights for each other: what lamps change of a sweep
        self.lit_m: Vector | None = None  # a place that is lit, for a robot that knows no other place; world frame
        self._lit_seen_m: Vector | None = None  # the lit place that the gimbal was turned to
        self.surveys = False  # a sweep over whole frames is under way, of no target
        self._look_us = self._pulses_us(robot.look.pan_deg, robot.look.tilt_deg)

    @property
    def measuring(self) -> bool:
        """A sweep is under way."""
        return self.surveys or self._memory[self._target].sweep.running

    def sees(self, target: str, now_ns: int) -> bool:
        """Whether it is in view where the gimbal looks, or was as the gimbal came to rest there."""
        found = self.roam is not None and self.roam.target == target and self.roam.found
        return found or (target == self._target and self._memory[target].in_view(now_ns))

    def glimpsed_m(self, target: str, level: Attitude, far_m: float | None, now_ns: int) -> Vector | None:
        """About where the target in view is, world frame: the range by the size of a ball, else far_m. None: it is not
        in view, or its range is not known."""
        seen, radius_m = self._memory[target].seen, self._fleet.target[target].radius_m
        if target != self._target or seen is None or seen.centre_px is None or not self.sees(target, now_ns):
            return None
        if radius_m is not None and seen.radius_px:
            far_m = radius_m * self._camera.f_px / seen.radius_px
        if far_m is None:
            return None
        x, y, z = ray(self._camera, seen.centre_px)
        at_m, tank = to_world(self.eye(level), (far_m * x, far_m * y, far_m * z)), self._fleet.tank
        x, y, z = (min(max(at, 0.0), most) for at, most in zip(at_m, (*tank.size_m[:2], tank.surface_m), strict=True))
        return x, y, z

    def add_sighting(self, sighting: Sighting) -> None:
        """Take note of one frame."""
        memory = self._memory.get(sighting.target)
        if memory is None:
            return
        memory.sweep.frame(sighting)
        if sighting.found and sighting.t_ns >= self.pointing.steady_from_ns:
            memory.seen = sighting
        if (
            self.roam is not None
            and sighting.target == self.roam.target
            and sighting.t_ns >= self.pointing.nearly_from_ns
            and self.lit_from_ns is not None
            and sighting.t_ns >= self.lit_from_ns
        ):
            self.roam.add_frame(sighting.found)

    def add_telemetry(self, telemetry: Telemetry) -> None:
        """Take note of how still the robot is."""
        self._memory[self._target].sweep.telemetry(telemetry)

    def finish(self, now_ns: int) -> Measurement | Rejected | None:
        """The result of the sweep that ended since the last call, if one did; it is about the target of `act`."""
        return self._memory[self._target].sweep.finish(now_ns)

    def take_back(self) -> None:
        """Forget the sweep that ended last: the next one goes by what was known before it."""
        self._memory[self._target].sweep.take_back()

    def ready(self, target: str, now_ns: int) -> bool:
        """Whether a sweep of that target could begin, were it in the middle of the picture."""
        here = target == self._target and not self._elsewhere
        return here and not self.measuring and self._memory[target].sweep.ready(now_ns)

    def most_ns(self) -> int:
        """How long a sweep of the target can take."""
        return self._memory[self._target].sweep.most_ns

    def remark(self) -> str | None:
        """What a full sweep showed about the lens, once."""
        return self._memory[self._target].sweep.remark()

    def act(
        self, now_ns: int, target: str, attitude: Attitude | None, told_m: Vector | None, wanted: bool
    ) -> SweepPlan | None:
        """Move the gimbal if it must move; else, if a measurement is wanted and possible, start a sweep.

        `target`: which one to look at; a sweep that runs has to end before another may be named.
        `told_m`: where it is believed to be, world frame.
        """
        memory, another = self._memory[target], target != self._target or self._elsewhere
        self._target, self._elsewhere = target, False
        if self.pointing.goal_us is None:
            self._aim(self._look_us, now_ns)
        if memory.sweep.running:
            return None
        if self.roam is not None and self.roam.target == target and self.roam.empty and not memory.in_view(now_ns):
            self.roam.advance()
            another = True
        if self._goes_to_light(memory, attitude, told_m, now_ns) or not (another or self.pointing.steady(now_ns)):
            return None
        if memory.seen is not None and memory.seen.centre_px is not None and memory.in_view(now_ns):
            memory.search.reset()
            off_px = off_centre_px(memory.seen.centre_px, self._camera.width_px, self._camera.height_px)
            if off_px <= CENTRED * self._camera.width_px:
                if not wanted or attitude is None or not memory.sweep.ready(now_ns):
                    return None
                plan = memory.sweep.start(now_ns, self.by_light)
                return replace(plan, target=target) if len(self._memory) > 1 else plan
            self._turn_to_pixel(memory.seen.centre_px, attitude, now_ns)
        elif another:  # the camera was elsewhere: nothing to wait for, and the last peak still holds
            self._look_around(memory.search, attitude, told_m, now_ns)
        elif self._lost(memory, now_ns):
            memory.sweep.forget()
            self._look_around(memory.search, attitude, told_m, now_ns)
        return None

    def _goes_to_light(
        self, memory: TargetMemory, attitude: Attitude | None, told_m: Vector | None, now_ns: int
    ) -> bool:
        """Turn to what is lit, once, where nothing is seen and no neighbour has told anything; whether that was now."""
        before, self._lit_seen_m = self._lit_seen_m, self.lit_m
        if self.lit_m is None or self.lit_m == before or told_m is not None or memory.in_view(now_ns):
            return False
        self._turn_to_point(self.lit_m, attitude or Attitude(self._robot.depth_m, 0.0, 0.0), (0.0, 0.0), now_ns)
        return True

    def _lost(self, memory: TargetMemory, now_ns: int) -> bool:
        if self.lit_from_ns is None:
            return False
        since_ns = max(memory.seen.t_ns if memory.seen else 0, self.pointing.steady_from_ns, self.lit_from_ns)
        return now_ns - since_ns > LOST_NS

    def look(self, pan_deg: float, tilt_deg: float, now_ns: int, swift: bool = False) -> None:
        """Turn the camera elsewhere, for another purpose than the target; not while a sweep is under way. The next
        `act` turns it back. swift: from a target that it tracks, without rest."""
        self._elsewhere, goal_us = True, self._pulses_us(pan_deg, tilt_deg)
        if swift:
            self.pointing.track(goal_us, now_ns)
        else:
            self._aim(goal_us, now_ns)

    def track(self, target: str, pan_deg: float, tilt_deg: float, now_ns: int) -> None:
        """Point there now, and elsewhere with the next step: the camera tracks that target. Not while a sweep is under
        way."""
        self._target, self._elsewhere = target, False
        self.pointing.track(self._pulses_us(pan_deg, tilt_deg), now_ns)

    def eye(self, level: Attitude, pose: Pose | None = None) -> Eye:
        """Where the camera is while the gimbal rests at its goal; `pose`: of another time than now."""
        return camera_pose(pose or self.pose, self._fleet.body, *level, *self.gimbal_deg(), self._fleet.tank.surface_m)

    def gimbal_deg(self) -> tuple[float, float]:
        """Pan and tilt at rest at the goal, by calibration."""
        return gimbal_deg(self._camera, self._fleet.body, self.pointing.goal_us or self._look_us)

    def _turn_to_pixel(self, centre_px: tuple[float, float], attitude: Attitude | None, now_ns: int) -> None:
        level = attitude or Attitude(self._robot.depth_m, 0.0, 0.0)
        point = to_world(self.eye(level), ray(self._camera, centre_px))  # 1 m away: only the direction counts
        self._turn_to_point(point, level, (0.0, 0.0), now_ns)

    def _look_around(self, search: Search, attitude: Attitude | None, told_m: Vector | None, now_ns: int) -> None:
        level = attitude or Attitude(self._robot.depth_m, 0.0, 0.0)
        if self.roam is not None and self.roam.target == self._target:
            self._look_on(self.roam, level, told_m, now_ns)
        elif told_m is None:
            self._aim(self._look_us, now_ns)
        else:
            offset = search.offset_deg(self.pointing.steady(now_ns), now_ns)
            self._turn_to_point(told_m, level, offset, now_ns)

    def _look_on(self, roam: Roam, level: Attitude, told_m: Vector | None, now_ns: int) -> None:
        offset = roam.offset_deg
        if offset is not None and told_m is not None:
            self._turn_to_point(told_m, level, offset, now_ns)
        else:
            self._aim(self._pulses_us(*roam.way_deg), now_ns)

    def _turn_to_point(self, point: Vector, level: Attitude, offset_deg: tuple[float, float], now_ns: int) -> None:
        pan, tilt = look_at(point, self.pose, self._fleet.body, *level, self._fleet.tank.surface_m)
        self._aim(self._pulses_us(pan + offset_deg[0], tilt + offset_deg[1]), now_ns)

    def _pulses_us(self, pan_deg: float, tilt_deg: float) -> tuple[int, int]:
        return reachable(servos_us(self._camera, self._fleet.body, pan_deg, tilt_deg))

    def _aim(self, goal_us: tuple[int, int], now_ns: int) -> None:
        if goal_us != self.pointing.goal_us:
            for memory in self._memory.values():
                memory.seen = None  # its pixel belongs to the old direction
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
