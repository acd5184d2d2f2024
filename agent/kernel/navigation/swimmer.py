"""A robot that swims: what it knows of where it is, when it looks for landmarks instead of the target, and its thrust."""

from __future__ import annotations

import math

from agent.kernel.config import Fleet, Pose, Robot
from agent.kernel.control.attitude import Attitude, AttitudeLog
from agent.kernel.control.seek import Seek
from agent.kernel.navigation.angle import wrap
from agent.kernel.navigation.body_model import Wrench
from agent.kernel.navigation.glance import Glance
from agent.kernel.navigation.layout import markers
from agent.kernel.navigation.own_pose import LOST_DEG, LOST_M, STILL, SURE_DEG, SURE_M, OwnPose, Whereabouts
from agent.kernel.ranging.calibration import Calibration
from agent.kernel.step_io import SeenTags

SURFACE_AFTER_NS = 30_000_000_000  # of looking for landmarks in vain
SURFACE_M = 0.08  # where that ends: a hull that is lifted out would plunge when somebody stops the motors


class Swimmer:
    """Between steps, of one robot of a fleet with `[navigation]`."""

    def __init__(self, fleet: Fleet, robot: Robot, calibration: Calibration) -> None:
        assert fleet.landmarks is not None and fleet.navigation is not None  # a rule of the fleet file
        self._robot, self._limits = robot, fleet.navigation.limits
        self.own = OwnPose(fleet, calibration.camera)
        self._glance = Glance(markers(fleet.landmarks).values(), fleet.body, fleet.tank.surface_m)
        self._lost_since_ns: int | None = None

    def see(self, frames: tuple[SeenTags, ...], attitude: AttitudeLog, seek: Seek, now_ns: int) -> None:
        """Landmarks of the frames that were exposed while the gimbal was at rest; the others say little."""
        for frame in frames:
            level = attitude.at(frame.t_ns)
            if level is not None and frame.t_ns >= seek.pointing.steady_from_ns:
                self.own.see(frame, level, seek.gimbal_deg())
        self.own.advance(now_ns)
        here = self.own.at(now_ns)
        if here is not None:
            seek.pose = here.pose
        if here is not None and here.within(LOST_M, LOST_DEG):
            self._lost_since_ns = None
        elif self._lost_since_ns is None:
            self._lost_since_ns = now_ns

    @property
    def lost(self) -> bool:
        """It does not know where it is."""
        return self._lost_since_ns is not None

    def measured_at(self, t_ns: int) -> Whereabouts | None:
        """Its pose when a frame was exposed, if it is good enough to tell others where something is."""
        there = self.own.at(t_ns)
        return there if there is not None and there.within(LOST_M, LOST_DEG) else None

    def glance(self, seek: Seek, level: Attitude | None, now_ns: int) -> bool:
        """Turn the camera to landmarks where that is due; returns whether it was. Not while a sweep is under way."""
        here = self.own.at(now_ns)
        if level is None or (here is not None and here.within(SURE_M, SURE_DEG)):
            self._glance.reset()
            return False
        steady = seek.pointing.steady(now_ns)
        pan, tilt = self._glance.direction_deg(here.pose if here else None, level, steady, now_ns)
        seek.look(pan, tilt, now_ns)
        return True

    def thrust(self, allowed: bool, now_ns: int) -> Wrench:
        """Force ahead and to the left, N, and yaw moment, N m."""
        here = self.own.at(now_ns)
        wrench = STILL if here is None or self.lost or not allowed else _hold(here, self._robot.pose)
        self.own.sent(wrench, now_ns)
        return wrench

    def depth_m(self, now_ns: int) -> float:
        """Where it hovers: at its depth, or at the surface when it has been lost for too long."""
        lost = self._lost_since_ns is not None and now_ns - self._lost_since_ns > SURFACE_AFTER_NS
        return SURFACE_M if lost else self._robot.depth_m


def _hold(here: Whereabouts, at: Pose) -> Wrench:
    """Temporary."""
    w, z, m = 3.0, 0.9, 6.0
    kp, kv = w / (2 * z), 2 * z * w
    ex, ey = at.x_m - here.pose.x_m, at.y_m - here.pose.y_m
    vd = [kp * ex, kp * ey]
    size = math.hypot(*vd)
    if size > 0.25:
        vd = [v * 0.25 / size for v in vd]
    dx, dy, dpsi = here.push
    v = here.velocity
    k = (2.0 + 20.0 * math.hypot(v[0], v[1])) / m
    fx = m * (kv * (vd[0] - v[0]) + k * v[0] - dx)
    fy = m * (kv * (vd[1] - v[1]) + k * v[1] - dy)
    psi = math.radians(here.pose.yaw_deg) + v[2] * 0.115
    c, s = math.cos(psi), math.sin(psi)
    f, g = c * fx + s * fy, -s * fx + c * fy
    size = math.hypot(f, g)
    if size > 6.0:
        f, g = f * 6 / size, g * 6 / size
    e = wrap(math.radians(at.yaw_deg - here.pose.yaw_deg))
    wp = 1.3 * w
    rd = max(-1.0, min(1.0, wp / (2 * z) * e))
    n = 0.09 * (2 * z * wp * (rd - v[2]) + (0.03 + 0.1 * abs(v[2])) / 0.09 * v[2] - dpsi)
    return f, g, max(-0.8, min(0.8, n))
