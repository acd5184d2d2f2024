"""Find the target, keep it in the middle of the image, and measure it with the lens again and again."""

from __future__ import annotations

from agent.config import Fleet, Robot
from agent.control.attitude import Attitude
from agent.control.pointing import Pointing, Search, off_centre_px
from agent.control.sweep import Measurement, Rejected, Sweep
from agent.messages import Sighting, SweepPlan, Vector
from agent.ranging.calibration import Calibration
from agent.ranging.camera_model import Eye, camera_pose, gimbal_deg, look_at, ray, servos_us, to_world

CENTRED = 0.09  # share of the image width: nearer to the middle than this, the gimbal stays still
IN_VIEW_NS = 600_000_000  # two frames between sweeps
LOST_NS = 1_200_000_000  # not found for this long, with the gimbal at rest


class Seek:
    """Gimbal and lens of one robot, for one target."""

    def __init__(self, fleet: Fleet, robot: Robot, calibration: Calibration) -> None:
        self._fleet, self._robot, self._camera = fleet, robot, calibration.camera
        self.pointing = Pointing()
        self.sweep = Sweep(calibration.focus, fleet.camera.sweep_steps)
        self._search = Search()
        self._look_us = servos_us(self._camera, fleet.body, robot.look.pan_deg, robot.look.tilt_deg)
        self._seen: Sighting | None = None  # newest frame with the target in it, gimbal at rest

    def watch(self, sighting: Sighting) -> None:
        """Take note of one frame."""
        self.sweep.frame(sighting)
        if sighting.found and sighting.t_ns >= self.pointing.steady_from_ns:
            self._seen = sighting

    def in_view(self, now_ns: int) -> bool:
        return self._seen is not None and now_ns - self._seen.t_ns < IN_VIEW_NS

    def finish(self, now_ns: int) -> Measurement | Rejected | None:
        """The result of the sweep that ended since the last call, if one did."""
        return self.sweep.finish(now_ns)

    def act(self, now_ns: int, attitude: Attitude | None, told_m: Vector | None, wanted: bool) -> SweepPlan | None:
        """Move the gimbal if it must move; else, if a measurement is wanted and possible, start a sweep.

        `told_m`: where the target is believed to be, world frame.
        """
        if self.pointing.goal_us is None:
            self.pointing.aim(self._look_us, now_ns)
        if self.sweep.running or not self.pointing.steady(now_ns):
            return None
        if self.in_view(now_ns) and self._seen is not None and self._seen.centre_px is not None:
            self._search.reset()
            off_px = off_centre_px(self._seen.centre_px, self._camera.width_px, self._camera.height_px)
            if off_px <= CENTRED * self._camera.width_px:
                return self.sweep.start(now_ns) if wanted and attitude is not None else None
            self._turn_to_pixel(self._seen.centre_px, attitude, now_ns)
        elif self._lost(now_ns):
            self.sweep.forget()
            self._look_around(attitude, told_m, now_ns)
        return None

    def _lost(self, now_ns: int) -> bool:
        since_ns = max(self._seen.t_ns if self._seen else 0, self.pointing.steady_from_ns)
        return now_ns - since_ns > LOST_NS

    def eye(self, level: Attitude) -> Eye:
        """Where the camera is while the gimbal rests at its goal."""
        return camera_pose(self._robot.pose, self._fleet.body, *level, *self.gimbal_deg(), self._fleet.tank.surface_m)

    def gimbal_deg(self) -> tuple[float, float]:
        """Pan and tilt at rest at the goal, by calibration."""
        return gimbal_deg(self._camera, self._fleet.body, self.pointing.goal_us or self._look_us)

    def _turn_to_pixel(self, centre_px: tuple[float, float], attitude: Attitude | None, now_ns: int) -> None:
        level = attitude or Attitude(self._robot.depth_m, 0.0, 0.0)
        point = to_world(self.eye(level), ray(self._camera, centre_px))  # 1 m away: only the direction counts
        self._turn_to_point(point, level, (0.0, 0.0), now_ns)

    def _look_around(self, attitude: Attitude | None, told_m: Vector | None, now_ns: int) -> None:
        if told_m is None:
            self.pointing.aim(self._look_us, now_ns)
        else:
            level = attitude or Attitude(self._robot.depth_m, 0.0, 0.0)
            offset = self._search.offset_deg(self.pointing.steady(now_ns), now_ns)
            self._turn_to_point(told_m, level, offset, now_ns)

    def _turn_to_point(self, point: Vector, level: Attitude, offset_deg: tuple[float, float], now_ns: int) -> None:
        pan, tilt = look_at(point, self._robot.pose, self._fleet.body, *level, self._fleet.tank.surface_m)
        goal = servos_us(self._camera, self._fleet.body, pan + offset_deg[0], tilt + offset_deg[1])
        if goal != self.pointing.goal_us:
            self._seen = None  # its pixel belongs to the old direction
            self.pointing.aim(goal, now_ns)
