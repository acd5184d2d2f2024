"""Points of the world as slopes in a camera that a robot carries, and how these change with the robot's pose.

theta = (x, y, psi, depth, roll, pitch, pan, tilt), m and rad; frames and angles as in core/ranging/camera_model.py. A
slope is (X, Y) / (Z - ahead_m) in the camera frame. An angle turns the camera about an axis through a centre, the
body's or the gimbal's pivot: a point p of the camera frame, as seen from that centre, moves by p x axis.

Behind the projection stands what makes a tag be seen elsewhere than it should be: errors of the lens's calibration,
blur, and the noise of its corners.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

from agent.capabilities.swim.landmarks import Marker, survey_jacobian
from agent.core.config import Body, Landmarks
from agent.core.linear_algebra import cholesky, cross
from agent.core.messages import Vector
from agent.core.ranging.camera_model import CameraFit, FocusFit, at_lens_position
from agent.core.ranging.focus import lens_position
from agent.core.step_io import SeenTag, Slope

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


class CameraAxes(NamedTuple):
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


def camera_axes(of: View, theta: Theta) -> CameraAxes:
    x, y, psi, depth, roll, pitch, pan, tilt = theta
    world_level = _times(_rz(psi), _ry(pitch))
    world_body = _times(world_level, _rx(roll))
    world_panned = _times(world_body, _rz(pan))
    (a, b, c), (d, e, f), (g, h, i) = _times(world_panned, _ry(-tilt))
    to_camera = (-b, -e, -h), (-c, -f, -i), (a, d, g)  # its axes are right, down and forward
    arm = _apply(world_body, of.arm_m)
    pivot = x + arm[0], y + arm[1], of.surface_m - depth + arm[2]
    return CameraAxes(
        pivot,
        to_camera,
        _apply(to_camera, arm),
        _apply(to_camera, (0.0, 0.0, 1.0)),
        _apply(to_camera, _column(world_level, 0)),
        _apply(to_camera, (-math.sin(psi), math.cos(psi), 0.0)),
        _apply(to_camera, _column(world_body, 2)),
        (1.0, 0.0, 0.0),  # positive tilt is up, and the axis to its right is the camera's own
    )


def slope(of: View, at: CameraAxes, point_m: Vector) -> Slope | None:
    """Where a point of the world is seen; None where it is not before the camera."""
    x, y, z = _in_camera(at, point_m)
    z -= of.ahead_m
    return (x / z, y / z) if z > NEAREST_M else None


def seen(of: View, at: CameraAxes, point_m: Vector) -> Seen | None:
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
    """How the slope of a tag's corner moves with the six errors of its survey (landmarks.survey_jacobian), 2 x 6."""
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


def _in_camera(at: CameraAxes, point_m: Vector) -> Vector:
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


# --- errors of the calibration ---
# What a calibration has wrong of camera and gimbal moves all tags of all frames in one pattern: no filter averages
# it.
#
#     c + f (1 + b |s|^2) s = pixel
#     M ds = -((1 + b |s|^2) s dln f + |s|^2 s db + dc / f) ,  M = (1 + b |s|^2) I + 2 b s s'
#
# The covariance of the calibration's ten numbers is taken apart into ten errors that know nothing of each other, each
# of one sigma.

NUMBERS = 10  # CameraFit.covariance


class LensError(NamedTuple):
    """One of them: how wrong all numbers are together."""

    scale: float  # of ln f, at the frame's lens position
    bend: float
    cx: float  # px over f_px
    cy: float
    ahead_m: float
    pan: float  # zeros, rad
    tilt: float
    pan_gain: float
    tilt_gain: float


def lens_errors(camera: CameraFit, focus: float | None) -> tuple[LensError, ...]:
    """None where the calibration does not say how good it is. camera: as calibrated; focus: the frame's."""
    if camera.covariance is None or (L := _factor(camera.covariance)) is None:
        return ()
    travel = 0.0 if focus is None else focus - camera.lens
    errors = []
    for k in range(NUMBERS):
        f, bend, cx, cy, ahead_m, breathing, pan, tilt, pan_gain, tilt_gain = [0.0] * k + [row[k] for row in L[k:]]
        scale, zeros = f + breathing * travel, (math.radians(pan), math.radians(tilt))
        errors.append(LensError(scale, bend, cx / camera.f_px, cy / camera.f_px, ahead_m, *zeros, pan_gain, tilt_gain))
    return tuple(errors)


@lru_cache(maxsize=64)  # of each camera that this process knows: one in an agent, all of a fleet in an experiment
def _factor(covariance: tuple[float, ...]) -> list[list[float]] | None:
    """L with L L' = covariance; None where it is none."""
    rows: list[list[float]] = []
    rest = list(covariance)
    for i in range(NUMBERS):
        rows.append([rows[k][i] for k in range(i)] + rest[: NUMBERS - i])
        del rest[: NUMBERS - i]
    return cholesky(rows)


def slope_error(error: LensError, bend: float, slope: Slope, per_m: float) -> Slope:
    """How far a point is seen from where it should be. per_m: 1 over its distance ahead of where rays meet."""
    x, y = slope
    s2 = x * x + y * y
    straight = 1.0 + bend * s2
    grown = straight * error.scale + s2 * error.bend
    u, v = grown * x + error.cx, grown * y + error.cy
    along = 2.0 * bend * (x * u + y * v) / (straight + 2.0 * bend * s2)  # M^-1, by Sherman and Morrison
    longer = error.ahead_m * per_m
    return -(u - along * x) / straight - longer * x, -(v - along * y) / straight - longer * y


# --- defocus ---
# Which tags of a frame the lens, by calibration, shows sharply enough.
#
# From a blur as wide as a module on, the edge of a tag's border and those of its code are one. Then they look narrower
# than they are, and corners move inwards: by 0.1 % up to 0.9 of a module, by 1.3 % beyond 1.2 (rms, twin, 2900 tags),
# which is 25 mm of distance at 2 m. So the lens position tells how blurred a tag is, not the picture.

MODULES = 8  # along a tag's side
WIDTH_PX = 2.5  # diameter of the blur's disc a half width of the clarity peak off focus: 2.3 to 2.6 px (five lenses)
MIXED = 1.0  # of a module


def readable(tags: Iterable[SeenTag], size_m: float, fit: FocusFit | None, focus: float | None) -> list[SeenTag]:
    """The tags whose blur is narrower than a module. size_m: of a tag; focus: the frame's lens position. All count
    where that is not known, or the lens cannot be moved (no fit)."""
    if fit is None or focus is None:
        return list(tags)
    return [tag for tag in tags if _blur_px(tag, size_m, fit, focus) <= MIXED * tag.size_px / MODULES]


def _blur_px(tag: SeenTag, size_m: float, fit: FocusFit, focus: float) -> float:
    """Diameter; infinite for a tag that is before the lens's nearest range."""
    a, b, c, d = tag.corners
    sides, diagonals = (math.dist(a, b), math.dist(b, c)), (math.dist(a, c), math.dist(b, d))
    away_m = size_m / max(*sides, *(diagonal / math.sqrt(2.0) for diagonal in diagonals), 1e-9)  # aslant or not
    if away_m <= fit.u_inf_m:
        return float("inf")
    return WIDTH_PX * abs(focus - lens_position(fit, away_m)) / fit.width


# --- noise of a tag's corners ---
# How wrong the four corners of one tag are seen together, px: V_t, 8x8, and the part of it that a survey made.
#
#     V_t = s_c^2 I8 + s_o^2 (1 1') x I2 + s_s^2 c c' + f^2 G S G'
#
# c: the corners less their mean, px; S: of the survey's six errors; G: how these move the slopes. Corners of one tag
# share errors: independent ones of 0.2 px made fixes overconfident, NEES/3 of 5.9 and 9.2. The eight numbers are u, v
# of each corner.

# Measured on rendered frames, blurred by 0 to 7 px, of 640x480.
EDGE_PX = 0.08  # s_c of corners where fitted edges meet
FOUND_PX = 0.8  # s_c of corners as a corner finder puts them
OFFSET_PX = 0.04  # s_o in the middle of the picture
BENT_PX = 0.15  # and what the lens's bending leaves of it at the edge, growing with the cube of the distance
EDGE_AT = 0.55  # of the picture's width, that edge
STRETCH = 0.0012  # s_s: blur and threshold make all of a tag larger or smaller
# What a corner finder adds to it: it draws all four inwards alike, so that a small tag seems far away. In what was
# rendered a tag without edges, seen from beyond 0.8 m, was 24 mm wrong (90 %) where it said 8.
INWARDS_PX = 0.8


class TagNoise(NamedTuple):
    """Of one tag, px."""

    L: list[list[float]]  # lower 8 x 8, V_t = L L'
    survey: list[list[float]]  # f G S^(1/2), 8 x 6: the part of V_t that is the same whenever this tag is seen


def tag_noise(of: View, tag: SeenTag, marker: Marker, at: tuple[Seen, ...], landmarks: Landmarks) -> TagNoise | None:
    """V_t of a tag as it should be seen; None where numbers are too large to be of this world."""
    corner_px2 = (EDGE_PX if tag.edges else FOUND_PX) ** 2
    bent = tag.rho_px / (EDGE_AT * of.width_px)
    offset_px2 = (OFFSET_PX + BENT_PX * bent * bent * bent) ** 2
    flat = [of.f_px * s for corner in tag.corners for s in corner]
    means = 0.25 * (flat[0] + flat[2] + flat[4] + flat[6]), 0.25 * (flat[1] + flat[3] + flat[5] + flat[7])
    drawn = 0.0 if tag.edges else INWARDS_PX / (math.sqrt(0.5) * max(tag.size_px, 1.0))  # of half a diagonal
    grown = math.hypot(STRETCH, drawn)
    stretch = [grown * (value - means[i % 2]) for i, value in enumerate(flat)]
    shift, turn = of.f_px * landmarks.sigma_m, of.f_px * math.radians(landmarks.sigma_deg)
    scales = (shift, shift, shift, turn, turn, turn)
    survey = [
        [scale * g for scale, g in zip(scales, row, strict=True)]
        for seen, corner in zip(at, marker.corners_m, strict=True)
        for row in by_survey(seen, marker.middle_m, corner)
    ]
    V: list[list[float]] = []
    for i in range(8):
        row = []
        for j in range(i + 1):
            value = stretch[i] * stretch[j]
            for p, q in zip(survey[i], survey[j], strict=True):
                value += p * q
            if i == j:
                value += corner_px2
            if (i - j) % 2 == 0:
                value += offset_px2
            row.append(value)
        V.append(row)
    L = cholesky(V)
    return None if L is None else TagNoise(L, survey)
