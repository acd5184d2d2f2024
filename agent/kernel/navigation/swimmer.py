"""A robot that swims: what it knows of where it is, when it looks for landmarks instead of the target, and its thrust."""

from __future__ import annotations

import math

from agent.kernel.config import Fleet, Robot
from agent.kernel.control.attitude import Attitude, AttitudeLog
from agent.kernel.control.seek import Seek
from agent.kernel.navigation.barrier import safe_velocity
from agent.kernel.navigation.body_model import Wrench
from agent.kernel.navigation.glance import Glance
from agent.kernel.navigation.layout import markers
from agent.kernel.navigation.localizer import LOST_DEG, LOST_M, STILL, SURE_DEG, SURE_M, Localizer, Whereabouts
from agent.kernel.navigation.pilot import Reference, wanted_velocity, wrench
from agent.kernel.navigation.pose_filter import Belief
from agent.kernel.ranging.calibration import Calibration
from agent.kernel.step_io import SeenTags

SURFACE_AFTER_NS = 30_000_000_000  # of looking for landmarks in vain
SURFACE_M = 0.08  # where that ends: a hull that is lifted out would plunge when somebody stops the motors


class Swimmer:
    """Between steps, of one robot of a fleet with `[navigation]`."""

    def __init__(self, fleet: Fleet, robot: Robot, calibration: Calibration) -> None:
        assert fleet.landmarks is not None and fleet.navigation is not None  # a rule of the fleet file
        self._robot, self._limits = robot, fleet.navigation.limits
        self._tank_m = fleet.tank.size_m
        self.own = Localizer(fleet, calibration.camera)
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
        belief = self.own.belief(now_ns)
        asked = STILL if belief is None or self.lost or not allowed else self._towards(belief)
        self.own.sent(asked, now_ns)
        return asked

    def _towards(self, belief: Belief) -> Wrench:
        there, limits = self._robot.pose, self._limits
        to = Reference(
            (there.x_m, there.y_m),
            math.radians(there.yaw_deg),
            speed_m_s=limits.speed_m_s,
            turn_rad_s=math.radians(limits.turn_deg_s),
        )
        xx, xy, _, yy, _, _ = belief.covariance
        velocity = safe_velocity(wanted_velocity(belief, to), belief.pose[:2], (xx, xy, yy), self._tank_m)
        return wrench(belief, self.own.hull, to, velocity)

    def depth_m(self, now_ns: int) -> float:
        """Where it hovers: at its depth, or at the surface when it has been lost for too long."""
        lost = self._lost_since_ns is not None and now_ns - self._lost_since_ns > SURFACE_AFTER_NS
        return SURFACE_M if lost else self._robot.depth_m

