"""Points of the world as slopes in a camera that a robot carries, and how these change with the robot's pose.

theta = (x, y, psi, depth, roll, pitch, pan, tilt), m and rad; frames and angles as in ranging/camera_model.py. A slope
is (X, Y) / (Z - ahead_m) in the camera frame. An angle turns the camera about an axis through a centre, the body's or
the gimbal's pivot: a point p of the camera frame, as seen from that centre, moves by p x axis.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.capabilities.swim.layout import survey_jacobian
from agent.capabilities.swim.lens_errors import LensError, lens_errors
from agent.core.config import Body
from agent.core.linear_algebra import cross
from agent.core.messages import Vector
from agent.core.ranging.camera_model import CameraFit, at_lens_position
from agent.core.step_io import Slope

Theta = tuple[float, float, float, float, float, float, float, float]
NEAREST_M = 0.02  # before the point where rays meet; what is nearer is in the port, or behind


class View(NamedTuple):
    """What of a robot's build counts for one frame."""

    f_px: float  # at the lens position of the frame
    width_px: int
    ahead_m: float
    arm_m: Vector  # of the gimbal's pivot, body frame
    surface_m: float  # height of the water
    bend: float = 0.0
    errors: tuple[LensError, ...] = ()  # of the calibration, where it says


class Gaze(NamedTuple):
    """A camera at one theta; all vectors but the first in the camera frame."""

    pivot_m: Vector  # world
    world: tuple[Vector, Vector, Vector]  # rows: world -> camera
    arm_m: Vector  # body's centre to pivot
    yaw: Vector  # axes of the five angles
    roll: Vector
    pitch: Vector
    pan: Vector
    tilt: Vector


class Seen(NamedTuple):
    """A point as it should be seen, and derivatives of that."""

    slope: Slope
    by_theta: tuple[tuple[float, ...], tuple[float, ...]]  # 2 x 8
    by_point: tuple[Vector, Vector]  # 2 x 3, world frame
    per_m: float  # 1 over its distance along the optical axis from where rays meet


def view(camera: CameraFit, body: Body, surface_m: float, focus: float | None) -> View:
    """The view of a calibrated camera with its lens at that position; None: unknown."""
    errors = lens_errors(camera, focus)
    camera = at_lens_position(camera, focus)
    return View(camera.f_px, camera.width_px, camera.ahead_m, body.camera_m, surface_m, camera.bend, errors)


def gaze(of: View, theta: Theta) -> Gaze:
    x, y, psi, depth, roll, pitch, pan, tilt = theta
    world_level = _times(_rz(psi), _ry(pitch))
    world_body = _times(world_level, _rx(roll))
    world_panned = _times(world_body, _rz(pan))
    (a, b, c), (d, e, f), (g, h, i) = _times(world_panned, _ry(-tilt))
    to_camera = (-b, -e, -h), (-c, -f, -i), (a, d, g)  # its axes are right, down and forward
    arm = _apply(world_body, of.arm_m)
    pivot = x + arm[0], y + arm[1], of.surface_m - depth + arm[2]
    return Gaze(
        pivot,
        to_camera,
        _apply(to_camera, arm),
        _apply(to_camera, (0.0, 0.0, 1.0)),
        _apply(to_camera, _column(world_level, 0)),
        _apply(to_camera, (-math.sin(psi), math.cos(psi), 0.0)),
        _apply(to_camera, _column(world_body, 2)),
        (1.0, 0.0, 0.0),  # positive tilt is up, and the axis to its right is the camera's own
    )


def slope(of: View, at: Gaze, point_m: Vector) -> Slope | None:
    """Where a point of the world is seen; None where it is not before the camera."""
    x, y, z = _in_camera(at, point_m)
    z -= of.ahead_m
    return (x / z, y / z) if z > NEAREST_M else None


def seen(of: View, at: Gaze, point_m: Vector) -> Seen | None:
    """The same with its derivatives."""
    p = _in_camera(at, point_m)
    z = p[2] - of.ahead_m
    if not z > NEAREST_M:
        return None
    sx, sy, per_m = p[0] / z, p[1] / z, 1.0 / z
    from_body = p[0] + at.arm_m[0], p[1] + at.arm_m[1], p[2] + at.arm_m[2]
    (r0, r1, r2), (d0, d1, d2), (f0, f1, f2) = at.world
    by_point = (
        (per_m * (r0 - sx * f0), per_m * (r1 - sx * f1), per_m * (r2 - sx * f2)),
        (per_m * (d0 - sy * f0), per_m * (d1 - sy * f1), per_m * (d2 - sy * f2)),
    )
    (x_u, y_u, z_u), (x_v, y_v, z_v) = by_point
    turns = (
        cross(from_body, at.yaw),
        cross(from_body, at.roll),
        cross(from_body, at.pitch),
        cross(p, at.pan),
        cross(p, at.tilt),
    )
    yaw_u, roll_u, pitch_u, pan_u, tilt_u = [per_m * (x - sx * ahead) for x, _, ahead in turns]
    yaw_v, roll_v, pitch_v, pan_v, tilt_v = [per_m * (y - sy * ahead) for _, y, ahead in turns]
    by_theta = (  # a robot that moves one way sees the point move the other; depth counts down
        (-x_u, -y_u, yaw_u, z_u, roll_u, pitch_u, pan_u, tilt_u),
        (-x_v, -y_v, yaw_v, z_v, roll_v, pitch_v, pan_v, tilt_v),
    )
    return Seen((sx, sy), by_theta, by_point, per_m)


def by_survey(of: Seen, middle_m: Vector, corner_m: Vector) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """How the slope of a tag's corner moves with the six errors of its survey (layout.survey_jacobian), 2 x 6."""
    columns = tuple(zip(*survey_jacobian(middle_m, corner_m), strict=True))
    u, v = (tuple(a * i + b * j + c * k for i, j, k in columns) for a, b, c in of.by_point)
    return u, v


class Upright(NamedTuple):
    """A camera in the frame of its body made upright, with yaw and place as they are: depth, level and gimbal count."""

    origin_m: Vector  # where rays meet
    height_m: float  # of that above the floor
    rotation: tuple[Vector, Vector, Vector]  # rows: gimbal -> that frame


def upright(of: View, theta: Theta) -> Upright:
    """x, y and psi of theta do not count."""
    _, _, _, depth, roll, pitch, pan, tilt = theta
    level_body = _times(_ry(pitch), _rx(roll))
    level_gimbal = _times(_times(level_body, _rz(pan)), _ry(-tilt))
    forward, arm = _column(level_gimbal, 0), _apply(level_body, of.arm_m)
    origin = arm[0] + of.ahead_m * forward[0], arm[1] + of.ahead_m * forward[1], arm[2] + of.ahead_m * forward[2]
    return Upright(origin, of.surface_m - depth + origin[2], level_gimbal)


def direction(at: Upright, slope: Slope) -> Vector:
    """Along which a slope is seen; as long as makes it 1 along the optical axis."""
    return _apply(at.rotation, (1.0, -slope[0], -slope[1]))


def _in_camera(at: Gaze, point_m: Vector) -> Vector:
    x, y, z = point_m[0] - at.pivot_m[0], point_m[1] - at.pivot_m[1], point_m[2] - at.pivot_m[2]
    (a, b, c), (d, e, f), (g, h, i) = at.world
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def _apply(a: tuple[Vector, Vector, Vector], v: Vector) -> Vector:
    x, y, z = (row[0] * v[0] + row[1] * v[1] + row[2] * v[2] for row in a)
    return x, y, z


def _column(a: tuple[Vector, Vector, Vector], k: int) -> Vector:
    return a[0][k], a[1][k], a[2][k]


def _times(a: tuple[Vector, Vector, Vector], b: tuple[Vector, Vector, Vector]) -> tuple[Vector, Vector, Vector]:
    (i0, i1, i2), (j0, j1, j2), (k0, k1, k2) = b
    p, q, r = ((x * i0 + y * j0 + z * k0, x * i1 + y * j1 + z * k1, x * i2 + y * j2 + z * k2) for x, y, z in a)
    return p, q, r


def _rx(a: float) -> tuple[Vector, Vector, Vector]:
    c, s = math.cos(a), math.sin(a)
    return (1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)


def _ry(a: float) -> tuple[Vector, Vector, Vector]:
    c, s = math.cos(a), math.sin(a)
    return (c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)


def _rz(a: float) -> tuple[Vector, Vector, Vector]:
    c, s = math.cos(a), math.sin(a)
    return (c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)
