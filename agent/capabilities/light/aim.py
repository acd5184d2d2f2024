"""Where lamps are and how their gimbals turn. A lamp sits beside the camera's pivot, to its left on the body."""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec.structs import replace

from agent.capabilities.swim.swimmer import Swimmer
from agent.core.attitude import Attitude
from agent.core.config import Body, Fleet, Lighting, Pose
from agent.core.control.pointing import HIGHEST_US, LOWEST_US
from agent.core.control.target_search import Seek
from agent.core.messages import Presence, Vector
from agent.core.ranging.camera_model import Eye, camera_pose, look_at

AHEAD_M = 1.0  # along the camera's axis: where a lamp aims while nobody knows where anything is
BEYOND_DEG = 3.0  # past the end of a gimbal's way, and the target is still in the flat middle of its beam


class Aim(NamedTuple):
    """The geometry of a lamp of the fleet."""

    body: Body  # with the lamp in the place of the camera
    surface_m: float

    def place_m(self, pose: Pose, level: Attitude) -> Vector:
        """Where the lamp is, world frame."""
        return camera_pose(pose, self.body, *level, 0.0, 0.0, self.surface_m).position_m

    def at(self, point_m: Vector, pose: Pose, level: Attitude) -> tuple[tuple[int, int], bool]:
        """Pulses, us, that aim it at a point of the world, or as near as its gimbal gets; and whether that is there."""
        pan, tilt = look_at(point_m, pose, self.body, *level, self.surface_m)
        limits = self.body.pan_limit_deg, self.body.tilt_limit_deg
        turned = [min(max(deg, low), high) for deg, (low, high) in zip((pan, tilt), limits, strict=True)]
        there = all(abs(to - deg) <= BEYOND_DEG for to, deg in zip(turned, (pan, tilt), strict=True))
        pan_us, tilt_us = (self.us(deg) for deg in turned)
        return (pan_us, tilt_us), there

    def deg(self, us: tuple[int, int]) -> tuple[float, float]:
        """Pan and tilt at these pulses."""
        pan, tilt = ((pulse - self.body.servo_centre_us) / self.body.servo_us_per_deg for pulse in us)
        return pan, tilt

    def us(self, deg: float) -> int:
        """The pulse of a servo of its gimbal that is turned so far, us."""
        pulse = round(self.body.servo_centre_us + self.body.servo_us_per_deg * deg)
        return min(max(pulse, LOWEST_US), HIGHEST_US)


def aim_of(fleet: Fleet, lighting: Lighting) -> Aim:
    x, y, z = fleet.body.camera_m
    return Aim(replace(fleet.body, camera_m=(x, y + lighting.beam.beside_m, z)), fleet.tank.surface_m)


def axis_of(eye: Eye) -> Vector:
    """Unit vector of the optical axis, world frame."""
    (_, _, x), (_, _, y), (_, _, z) = eye.rotation
    return x, y, z


def looked_at(seek: Seek, level: Attitude, believed_m: Vector | None) -> Vector:
    """What the camera looks at: as far ahead of it as the target is believed to be."""
    eye = seek.eye(level)
    ahead_m = AHEAD_M if believed_m is None else max(math.dist(believed_m, eye.position_m), 0.2)
    x, y, z = (at + ahead_m * way for at, way in zip(eye.position_m, axis_of(eye), strict=True))
    return x, y, z


def others(fleet: Fleet, me: str, swimmer: Swimmer | None) -> dict[str, tuple[Pose, Attitude]]:
    """Where the neighbours with lamps are: as they say, or where they are moored; level, for nobody hears otherwise."""
    found = {}
    for name in fleet.robot[me].neighbours:
        robot = fleet.robot[name]
        if not robot.lamp:
            continue
        if swimmer is None:
            found[name] = robot.pose, Attitude(robot.depth_m, 0.0, 0.0)
        elif (letter := swimmer.company.neighbours.letters.senders[name].newest) is not None:
            found[name] = place_of(letter.message)
    return found


def place_of(said: Presence) -> tuple[Pose, Attitude]:
    """Where a robot is that says so."""
    pose = Pose(x_m=said.x_m, y_m=said.y_m, yaw_deg=math.degrees(said.yaw_rad))
    return pose, Attitude(said.depth_m, 0.0, 0.0)
