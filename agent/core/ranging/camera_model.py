"""Pixels, servo pulses and ranges to places in the world, and back. Pure geometry in scalars, no BLAS.

Frames. World: z up. Body: x forward, y left, z up, R_world_body = Rz(yaw) Ry(pitch) Rx(roll). Gimbal: pan about body
z, positive to the left, then tilt, positive up: R_body_gimbal = Rz(pan) Ry(-tilt). Camera: x right, y down, z forward,
optical centre at the gimbal's pivot. Angles in degrees, lengths in metres. The u of h(rho) is z-depth, along the
optical axis, not the length of the ray.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.core.config import Body, Pose
from agent.core.matrix import difference
from agent.core.messages import Vector
from agent.core.ranging.calibration import CameraFit

Rotation = tuple[Vector, Vector, Vector]  # rows

INNER_DISC = 0.5  # share of the ball's apparent radius inside which clarity is taken: texture, no silhouette
UNBEND = 8  # passes that take the bend out of a slope; each contracts by more than five inside the picture
RINGS = 8  # of equal area, to average the depth of that disc; 4 already agree to 0.01 mm


class Eye(NamedTuple):
    """Where a camera is: optical centre in the world, rotation camera -> world, and the centre of what carries it."""

    position_m: Vector
    rotation: Rotation
    body_m: Vector


def gimbal_deg(camera: CameraFit, body: Body, servos_us: tuple[float, float]) -> tuple[float, float]:
    """What the servos really do at these pulses: (pan, tilt), zero + gain * nominal angle."""
    pan, tilt = ((us - body.servo_centre_us) / body.servo_us_per_deg for us in servos_us)
    return camera.pan_zero_deg + camera.pan_gain * pan, camera.tilt_zero_deg + camera.tilt_gain * tilt


def servos_us(camera: CameraFit, body: Body, pan_deg: float, tilt_deg: float) -> tuple[int, int]:
    """The pulses that turn the gimbal there, to 1 us; beyond a limit, that limit's pulse."""
    pan = _clamp((pan_deg - camera.pan_zero_deg) / camera.pan_gain, body.pan_limit_deg)
    tilt = _clamp((tilt_deg - camera.tilt_zero_deg) / camera.tilt_gain, body.tilt_limit_deg)
    return (
        round(body.servo_centre_us + body.servo_us_per_deg * pan),
        round(body.servo_centre_us + body.servo_us_per_deg * tilt),
    )


def camera_pose(
    pose: Pose,
    body: Body,
    depth_m: float,
    roll_deg: float,
    pitch_deg: float,
    pan_deg: float,
    tilt_deg: float,
    surface_m: float,
) -> Eye:
    """Where the camera is and how it is turned, from the surveyed pose, the pressure sensors and the gimbal."""
    position, world_body = _pivot(pose, body, depth_m, roll_deg, pitch_deg, surface_m)
    body_camera = _times(_times(_rz(pan_deg), _ry(-tilt_deg)), ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)))
    return Eye(position, _times(world_body, body_camera), (pose.x_m, pose.y_m, surface_m - depth_m))


def look_at(
    point_m: Vector,
    pose: Pose,
    body: Body,
    depth_m: float,
    roll_deg: float,
    pitch_deg: float,
    surface_m: float,
) -> tuple[float, float]:
    """(pan, tilt) that bring a point of the world onto the optical axis."""
    pivot, world_body = _pivot(pose, body, depth_m, roll_deg, pitch_deg, surface_m)
    x, y, z = apply(_transpose(world_body), difference(point_m, pivot))
    return math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))


def ray(camera: CameraFit, px: tuple[float, float]) -> Vector:
    """Unit vector in the camera frame along which a pixel looks, from `ahead_m` before the pivot on."""
    seen_x, seen_y = (px[0] - camera.cx_px) / camera.f_px, (px[1] - camera.cy_px) / camera.f_px
    x, y = seen_x, seen_y
    for _ in range(UNBEND):
        bend = 1.0 + camera.bend * (x * x + y * y)
        x, y = seen_x / bend, seen_y / bend
    length = math.sqrt(x * x + y * y + 1.0)
    return x / length, y / length, 1.0 / length


def pixel(camera: CameraFit, point_m: Vector) -> tuple[float, float] | None:
    """Where a point of the camera frame meets the image; None behind the camera."""
    x, y, z = point_m[0], point_m[1], point_m[2] - camera.ahead_m
    if z <= 0.0:
        return None
    scale = camera.f_px / z * (1.0 + camera.bend * (x * x + y * y) / (z * z))
    return camera.cx_px + scale * x, camera.cy_px + scale * y


def slopes_per_px(camera: CameraFit, m: Vector) -> tuple[tuple[float, float], tuple[float, float]]:
    """How far the slope (x, y) of a ray m moves with one pixel to the right, and with one pixel down."""
    x, y = m[0] / m[2], m[1] / m[2]
    # The inverse of f [(1 + bend s^2) I + 2 bend s s^T], s = (x, y).
    straight = 1.0 + camera.bend * (x * x + y * y)
    k = 2.0 * camera.bend / (straight + 2.0 * camera.bend * (x * x + y * y))
    scale = 1.0 / (camera.f_px * straight)
    return (scale * (1.0 - k * x * x), -scale * k * x * y), (-scale * k * x * y, scale * (1.0 - k * y * y))


def to_camera(eye: Eye, point_m: Vector) -> Vector:
    """A point of the world in the camera frame."""
    return apply(_transpose(eye.rotation), difference(point_m, eye.position_m))


def to_world(eye: Eye, point_m: Vector) -> Vector:
    """A point of the camera frame in the world."""
    x, y, z = (p + c for p, c in zip(eye.position_m, apply(eye.rotation, point_m), strict=True))
    return x, y, z


def centre_behind_skin_m(skin_m: float, radius_m: float, share: float = INNER_DISC) -> float:
    """How far the ball's centre lies behind the skin at which its inner disc is sharpest, along the ray to the centre.

    Seen at an angle phi off that ray, the skin lies at depth t cos phi with t = d cos phi - sqrt(R^2 - d^2 sin^2 phi).
    The disc reaches to tan phi = share * tan(asin(R/d)). Each part of it is sharpest at its own vergence 1/depth, and
    the clarity of the whole is sharpest at their mean, so the disc focuses as a plane at the harmonic mean depth.
    That depth is about d - R + 0.05 R; here it is inverted for d.
    """
    d = skin_m + radius_m
    for _ in range(4):  # contracts by more than ten at each pass
        d += skin_m - _disc_depth_m(d, radius_m, share)
    return d - skin_m


def _disc_depth_m(d: float, radius_m: float, share: float) -> float:
    edge = share * radius_m / math.sqrt(d * d - radius_m * radius_m)
    vergence = 0.0
    for ring in range(RINGS):
        tan2 = edge * edge * (ring + 0.5) / RINGS
        cos2 = 1.0 / (1.0 + tan2)
        # t cos phi, with sin^2 = tan^2 cos^2
        depth = d * cos2 - math.sqrt((radius_m * radius_m - d * d * tan2 * cos2) * cos2)
        vergence += 1.0 / depth
    return RINGS / vergence


def _pivot(
    pose: Pose, body: Body, depth_m: float, roll_deg: float, pitch_deg: float, surface_m: float
) -> tuple[Vector, Rotation]:
    """The gimbal's pivot in the world, and R_world_body."""
    world_body = _times(_times(_rz(pose.yaw_deg), _ry(pitch_deg)), _rx(roll_deg))
    arm = apply(world_body, body.camera_m)
    return (pose.x_m + arm[0], pose.y_m + arm[1], surface_m - depth_m + arm[2]), world_body


def _rx(deg: float) -> Rotation:
    c, s = math.cos(math.radians(deg)), math.sin(math.radians(deg))
    return (1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)


def _ry(deg: float) -> Rotation:
    c, s = math.cos(math.radians(deg)), math.sin(math.radians(deg))
    return (c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)


def _rz(deg: float) -> Rotation:
    c, s = math.cos(math.radians(deg)), math.sin(math.radians(deg))
    return (c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)


def _transpose(a: Rotation) -> Rotation:
    (a00, a01, a02), (a10, a11, a12), (a20, a21, a22) = a
    return (a00, a10, a20), (a01, a11, a21), (a02, a12, a22)


def apply(a: Rotation, v: Vector) -> Vector:
    """Rotation times vector."""
    x, y, z = (row[0] * v[0] + row[1] * v[1] + row[2] * v[2] for row in a)
    return x, y, z


def _times(a: Rotation, b: Rotation) -> Rotation:
    columns = _transpose(b)
    return _transpose((apply(a, columns[0]), apply(a, columns[1]), apply(a, columns[2])))


def _clamp(value: float, limits: tuple[float, float]) -> float:
    return min(max(value, limits[0]), limits[1])
