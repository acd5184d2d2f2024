"""Pixels, servo pulses and ranges to places in the world, and back; and the calibration file that these rest on.

Pure geometry in scalars, no BLAS.

Frames. World: z up. Body: x forward, y left, z up, R_world_body = Rz(yaw) Ry(pitch) Rx(roll). Gimbal: pan about body
z, positive to the left, then tilt, positive up: R_body_gimbal = Rz(pan) Ry(-tilt). Camera: x right, y down, z forward,
optical centre at the gimbal's pivot. Angles in degrees, lengths in metres. The u of h(rho) is z-depth, along the
optical axis, not the length of the ray.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, NamedTuple

from msgspec import Meta
from msgspec.structs import replace

from agent.core.config import Body, ConfigError, Pose, Positive, Struct, convert, read_toml
from agent.core.linear_algebra import difference
from agent.core.messages import Symmetric, Vector

# --- calibration file of one robot ---
# What `aucamp calibrate` measured and the agent relies on.

NO_FOCUS = (
    "has no table [focus], as if the camera's focus were fixed, and this sweeps the lens; add it by "
    "`aucamp calibrate focus`, or measure all of it by `aucamp calibrate run`"
)


class FieldFit(Struct, frozen=True, kw_only=True):
    """How peaks aside differ from those on the optical axis, lens positions: a sensor that is not square to the axis
    tilts the plane that is sharp, and a lens curves it. See `focus.in_direction`."""

    right: float  # at f_px to the right of the axis
    down: float  # and as far below it
    curved: float  # and as far in any direction; grows with the square of the distance
    covariance: Symmetric  # of these three


class FocusFit(Struct, frozen=True, kw_only=True):
    """h(rho) = u_inf + b / (rho - rho0): z-depth from the gimbal pivot, in water, against the lens position.

    The three parameters that a table of (rho, u) can identify (paper, section 3: k, f, c in its own gauge).
    """

    u_inf_m: Annotated[float, Meta(ge=-10, lt=0.5)]  # beyond, no target in a tank would ever be sharp
    b_m: float  # metre times lens position; negative where larger positions focus farther
    rho0: float  # lens position at which the range is infinite
    covariance: Symmetric  # of (u_inf_m, b_m, rho0)
    noise: Positive  # standard deviation of one peak, lens positions
    width: Positive  # half width of the clarity peak, lens positions
    lowest: int  # lens positions at which the farthest and nearest calibrated ranges lie
    highest: int
    r2: float
    rmse_m: float
    held_out_rmse_m: float
    sag: float = 0.0  # lens positions by which peaks shift when the camera looks straight up: see `focus.at_tilt`
    sag_sigma: float | None = None  # standard deviation of that; None: not measured
    field: FieldFit | None = None  # None: not measured, and taken for flat

    def __post_init__(self) -> None:
        if self.b_m == 0.0:
            raise ValueError("`b_m` is 0, as if all lens positions were sharp at one range")


class CameraFit(Struct, frozen=True, kw_only=True):
    """The picture in water, and what the servos really do: angle = zero + gain * nominal angle of the pulse.

    A point at (x, y, z) in the camera frame has the slopes s = (x, y) / (z - ahead_m) and is seen at
    c + f_px (1 + bend |s|^2) s. The flat port alone bends by (n^2 - 1) / 2 = 0.39 and lets the rays meet (n - 1) times
    its distance behind the optical centre. The picture grows with the lens position: see `at_lens_position`.
    """

    width_px: Annotated[int, Meta(ge=1)]
    height_px: Annotated[int, Meta(ge=1)]
    f_px: Annotated[float, Meta(ge=1)]  # at the lens position `lens`
    cx_px: float
    cy_px: float
    bend: float = 0.0
    ahead_m: float = 0.0  # where rays meet, ahead of the gimbal's pivot
    lens: float = 0.0  # lens position
    breathing: float = 0.0  # share by which f_px grows with each lens position
    scale_covariance: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of ln f_px and ahead_m: 11, 12, 22
    pan_zero_deg: float = 0.0
    tilt_zero_deg: float = 0.0
    pan_gain: Positive = 1.0
    tilt_gain: Positive = 1.0
    gamma: Positive = 2.2  # a byte is 255 light ** (1 / gamma), light linear and 1 at the sensor's limit
    noise_px: Positive = 0.5  # residual of the fit
    noise_deg: Positive = 0.1  # repeatability of the gimbal
    # Of ln f_px, bend, cx_px, cy_px, ahead_m, breathing, pan_zero_deg, tilt_zero_deg, pan_gain and tilt_gain: the upper
    # triangle, row by row; None: unknown.
    covariance: Annotated[tuple[float, ...], Meta(min_length=55, max_length=55)] | None = None


class TimingFit(Struct, frozen=True, kw_only=True):
    """How late frames are stamped and how slowly the lens follows its commands, as its pictures tell: told to move at
    t, it has gone 1 - exp(-s / lens_lag_s) of its way in the frame that is stamped t + stamp_late_s + s."""

    stamp_late_s: Annotated[float, Meta(ge=-0.1, le=1)] = 0.0  # after the middle of the exposure
    stamp_late_sigma_s: Annotated[float, Meta(ge=0, le=1)] = 0.0
    lens_lag_s: Annotated[float, Meta(ge=0, le=1)] = 0.0
    lens_lag_sigma_s: Annotated[float, Meta(ge=0, le=1)] = 0.0


RESTS = 2.0  # lags of the lens that a frame of a sweep waits for: the seventh part of a step that is left is known


def sweep_waits_ns(timing: TimingFit, steps: int) -> int:
    """How much longer a sweep may take for late stamps and a slow lens."""
    return round(1e9 * steps * (max(timing.stamp_late_s, 0.0) + RESTS * timing.lens_lag_s))


class BodyFit(Struct, frozen=True, kw_only=True):
    """How a robot moves in the plane for each newton that it asks of its thrusters, whatever these then really give."""

    mass_kg: Positive  # with the water that moves along
    drag: Positive  # N s/m
    drag2: Positive  # N s^2/m^2
    inertia_kgm2: Positive  # likewise
    turn_drag: Positive  # N m s
    turn_drag2: Positive  # N m s^2
    lag_s: Positive  # of the thrusters
    sigma: tuple[float, float, float, float, float, float, float]  # relative standard deviations, in this order
    misfit: Positive  # rms of the whitened residuals; 1 where the filter's noise is as large as it believes
    fixes: int  # poses that it was fitted to


class Calibration(Struct, frozen=True, kw_only=True):
    """The whole file."""

    robot: str
    made: str  # date, UTC
    source: str  # what was in front of which camera
    focus: FocusFit | None = None  # none: its focus is fixed, and ranges come from sizes
    camera: CameraFit
    timing: TimingFit = TimingFit()  # nothing: not measured, and taken for none
    body: BodyFit | None = None  # none: the default fit; only a robot that swims needs it

    @property
    def swept(self) -> FocusFit:
        """[focus], for what sweeps the lens. Raises ConfigError where there is none."""
        if self.focus is None:
            raise ConfigError(f"calibration of {self.robot}: {NO_FOCUS}")
        return self.focus


def at_lens_position(camera: CameraFit, lens_position: float | None) -> CameraFit:
    """The camera with its lens at that position; None: unknown, as it was calibrated."""
    if lens_position is None or camera.breathing == 0.0:
        return camera
    growth = 1.0 + camera.breathing * (lens_position - camera.lens)
    return replace(camera, f_px=camera.f_px * growth, lens=lens_position, breathing=camera.breathing / growth)


def load_calibration(path: Path) -> Calibration:
    """Read a calibration file. Raises ConfigError with one line."""
    data = read_toml(path)
    if "camera" not in data:
        raise ConfigError(
            f"{path}: has no table [camera]; add it by `aucamp calibrate camera`, "
            "or measure all of it by `aucamp calibrate run`"
        )
    return convert(data, Calibration, path)


def load_focus(path: Path) -> tuple[FocusFit, CameraFit | None]:
    """The lens of a calibration file, and its camera, which may be missing: ranges of a whole view are then those of
    its axis. Raises ConfigError with one line."""
    data = read_toml(path)
    if "focus" not in data:
        raise ConfigError(f"{path}: {NO_FOCUS}")
    if "camera" not in data:
        return convert(data, _Lens, path).focus, None
    calibration = load_calibration(path)
    return calibration.swept, calibration.camera


class _Lens(Struct, frozen=True, kw_only=True):
    """A calibration file to which [camera] is still to be added."""

    robot: str
    made: str
    source: str
    focus: FocusFit


# --- geometry ---

Rotation = tuple[Vector, Vector, Vector]  # rows

INNER_DISC = 0.5  # share of the ball's apparent radius inside which clarity is taken: texture, no silhouette
UNBEND = 8  # passes that take the bend out of a slope; each contracts by more than five inside the picture
RINGS = 8  # of equal area, to average the depth of that disc; 4 already agree to 0.01 mm


class Eye(NamedTuple):
    """Where a camera is: optical centre in the world, rotation camera -> world, and the centre of the body."""

    position_m: Vector
    rotation: Rotation
    body_m: Vector

    @property
    def tilt_rad(self) -> float:
        """How far the camera looks up; rounding may leave its sine a little beyond 1."""
        return math.asin(max(-1.0, min(1.0, self.rotation[2][2])))


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
    point_m: Vector, pose: Pose, body: Body, depth_m: float, roll_deg: float, pitch_deg: float, surface_m: float
) -> tuple[float, float]:
    """(pan, tilt) that bring a point of the world onto the optical axis."""
    pivot, world_body = _pivot(pose, body, depth_m, roll_deg, pitch_deg, surface_m)
    x, y, z = apply(_transpose(world_body), difference(point_m, pivot))
    return math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))


def offset(camera: CameraFit, px: tuple[float, float]) -> tuple[float, float]:
    """(right, down) of a pixel, from the optical axis in f_px."""
    return (px[0] - camera.cx_px) / camera.f_px, (px[1] - camera.cy_px) / camera.f_px


def on_sensor(camera: CameraFit, px: tuple[float, float], lens_position: float) -> tuple[float, float]:
    """(right, down) from the optical axis of the place on the sensor where what is seen at a pixel falls with the lens
    at another position, in f_px of position 0: the picture grows about the axis."""
    x, y = offset(camera, px)
    grown = 1.0 + camera.breathing * (lens_position - camera.lens)
    scale = grown / (1.0 - camera.breathing * camera.lens)
    return scale * x, scale * y


def ray(camera: CameraFit, px: tuple[float, float]) -> Vector:
    """Unit vector in the camera frame along which a pixel looks, from `ahead_m` before the pivot on."""
    seen_x, seen_y = offset(camera, px)
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
