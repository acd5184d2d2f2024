"""What one lamp, aimed at the target, adds to the picture: light on the target and veil in front of it. And what light
from aside does to the outline of a ball.

Radiance per colour (blue, green, red) as it arrives at the camera, W/m2/sr, lamp at full power. Linear in the power,
so that any set of lamps is a sum of such pairs. Direct light after Jaffe, IEEE J. Oceanic Eng. 15 (1990), 101-111.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.capabilities.light.veil_table import ANGLE_DEG, LOG_TIMES, RATIO, SCATTERING_SHARE, TAU
from agent.core.config import Beam, Cues, Lighting, Target, WaterOptics
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, Eye, at_lens_position, ray, to_camera
from agent.core.ranging.fix import Outline, focus_range

# --- phase function ---
# Into which directions particles scatter light: Fournier and Forand, Proc. SPIE 2258 (1994), 194-201.
#
# With the index and the slope of sizes below 0.018 of it goes backwards, the mean of Petzold's measurements.

INDEX, SLOPE = 1.10, 3.5835  # of the particles, relative to water; of the power law of their sizes
NU = (3.0 - SLOPE) / 2.0
AT_180 = 4.0 / (3.0 * (INDEX - 1.0) ** 2)  # d of the paper at 180 degrees
FORWARD_RAD = 1e-6  # nearer to straight on is as good as straight on, where the formula has no limit
NEAR_ONE = 1e-5  # of d, where the formula is 0/0; its neighbours stand for it


def phase(angle_rad: float) -> float:
    """Share of scattered light per steradian at `angle_rad` from its way; 1 in the integral over the sphere."""
    half = math.sin(0.5 * max(angle_rad, FORWARD_RAD))
    square = half * half
    d = AT_180 * square
    if abs(d - 1.0) < NEAR_ONE:
        d = 1.0 + NEAR_ONE
    power = math.pow(d, NU)
    front = NU * (1.0 - d) - (1.0 - power) + (d * (1.0 - power) - NU * (1.0 - d)) / square
    far = math.pow(AT_180, NU)
    cosine = 1.0 - 2.0 * square
    back = (1.0 - far) / (16.0 * math.pi * (AT_180 - 1.0) * far) * (3.0 * cosine * cosine - 1.0)
    return front / (4.0 * math.pi * (1.0 - d) ** 2 * power) + back


# --- multiple scattering ---
# Veil of all orders of scattering over that of a single one, by a table of Monte Carlo.
#
# Lengths count in scattering lengths, so that a table in (b times distance, share of scattering in attenuation,
# angle, ratio of distances) holds for every water. veil_table.py says how it was made.


def all_orders(depth_m: float, ahead_m: float, aside_m: float, water: WaterOptics) -> tuple[float, float, float]:
    """Factor on model.single_veil for each colour. depth_m: camera to target; the lamp, aimed at the target, is so far
    ahead of the camera and beside its axis. Beyond the table's ends its last values hold."""
    range_m = math.hypot(depth_m - ahead_m, aside_m)
    angle_deg = math.degrees(math.atan2(aside_m, depth_m - ahead_m))
    at_angle = _between(ANGLE_DEG, angle_deg)
    at_ratio = _between(RATIO, range_m / depth_m)
    blue, green, red = (
        _times(b * depth_m, b / (a + b), at_angle, at_ratio)
        for a, b in zip(water.absorption_per_m, water.scattering_per_m, strict=True)
    )
    return blue, green, red


def _times(tau: float, share: float, at_angle: tuple[int, float], at_ratio: tuple[int, float]) -> float:
    thin = min(tau / TAU[0], 1.0)  # in water so clear there is but one order
    corners = (_between(TAU, tau), _between(SCATTERING_SHARE, share), at_angle, at_ratio)
    total = 0.0
    for corner in range(16):
        weight, index = 1.0, 0
        for axis, ((i, part), size) in enumerate(zip(corners, SIZES, strict=True)):
            up = corner >> axis & 1
            weight *= part if up else 1.0 - part
            index = index * size + i + up
        total += weight * LOG_TIMES[index]
    return math.exp(total * thin)


def _between(nodes: tuple[float, ...], x: float) -> tuple[int, float]:
    """Index of the node below, and how far x is towards the next, 0 to 1."""
    for i in range(len(nodes) - 2):
        if x < nodes[i + 1]:
            break
    else:
        i = len(nodes) - 2
    return i, min(max((x - nodes[i]) / (nodes[i + 1] - nodes[i]), 0.0), 1.0)


SIZES = (len(TAU), len(SCATTERING_SHARE), len(ANGLE_DEG), len(RATIO))

# --- light and veil of one lamp ---

Colours = tuple[float, float, float]

STEPS = 160  # along the axis, even in the angle at which the lamp sees them
FORWARD = 0.4  # share of scattering that is lost to a lamp's light on a surface: most of it still arrives there
ALBEDO = 0.3  # of the target; the same in all sets of lamps, so that it matters to exposure and read noise alone
RINGS = (0.0, 0.5, 0.87)  # of the inner disc's radius, where its light is sampled
SPOKES = 12
INNER = 0.5  # of the target's radius: the part of its disc that clarity is taken over
LEAST_M = 1e-3  # off the axis: a lamp exactly on it is taken as beside it


class Pair(NamedTuple):
    """One lamp's share of a picture."""

    direct: tuple[Colours, ...]  # at each of the points of the inner disc
    veil: Colours  # on the axis


def beam_share(angle_rad: float, half_rad: float) -> float:
    """Intensity at an angle off the lamp's axis, of that on it: flat to 0.8 of the half angle, nothing beyond 1.2."""
    t = min(max((1.2 - angle_rad / half_rad) / 0.4, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


def pair(camera_m: Vector, target_m: Vector, radius_m: float, lamp_m: Vector, lighting: Lighting) -> Pair:
    """The lamp at lamp_m, looked at by a camera that aims at the target as the lamp does; all in the world frame."""
    direct = direct_light(camera_m, target_m, radius_m, lamp_m, lighting)
    depth_m = math.dist(camera_m, target_m)
    along = tuple((t - c) / depth_m for t, c in zip(target_m, camera_m, strict=True))
    offset = tuple(p - c for p, c in zip(lamp_m, camera_m, strict=True))
    ahead_m = sum(a * o for a, o in zip(along, offset, strict=True))
    aside_m = math.sqrt(max(sum(o * o for o in offset) - ahead_m * ahead_m, 0.0))
    single = single_veil(depth_m, radius_m, ahead_m, aside_m, lighting.water, lighting.beam)
    times = all_orders(depth_m, ahead_m, aside_m, lighting.water)
    blue, green, red = (s * f for s, f in zip(single, times, strict=True))
    return Pair(direct, (blue, green, red))


def single_veil(
    depth_m: float,
    radius_m: float,
    ahead_m: float,
    aside_m: float,
    water: WaterOptics,
    beam: Beam,
    lost: float = FORWARD,
    steps: int = STEPS,
) -> Colours:
    """Veil of one order of scattering on the camera's axis, from the camera to the target's surface.

    depth_m: camera to the target's centre. The lamp is so far ahead of the camera and beside its axis.
    The integral of  b p I exp(-k r - c s) / r^2  with k = a + 0.4 b, by midpoints of equal angles seen from the lamp,
    where 1/r^2 is even. lost: share of scattering that the lamp's light does not survive; 1 for a single order alone.
    """
    aside_m = max(aside_m, LEAST_M)
    end_m = max(depth_m - radius_m, 0.0)
    low, high = math.atan2(-ahead_m, aside_m), math.atan2(end_m - ahead_m, aside_m)
    step = (high - low) / steps
    half_rad = math.radians(beam.half_deg)
    lamp_range_m = math.hypot(depth_m - ahead_m, aside_m)
    aim_z, aim_x = (depth_m - ahead_m) / lamp_range_m, -aside_m / lamp_range_m
    a, b = water.absorption_per_m, water.scattering_per_m
    blue = green = red = 0.0
    for i in range(steps):
        turn = low + (i + 0.5) * step
        cos, sin = math.cos(turn), math.sin(turn)
        off = math.acos(min(max(aim_z * sin - aim_x * cos, -1.0), 1.0))
        shining = beam_share(off, half_rad)
        if shining == 0.0:
            continue
        r = aside_m / cos
        s = ahead_m + r * sin
        # ds / r^2 is step / aside_m; light that goes along (sin, cos) is scattered towards the camera
        weight = phase(0.5 * math.pi + turn) * shining
        blue += weight * math.exp(-(a[0] + lost * b[0]) * r - (a[0] + b[0]) * s)
        green += weight * math.exp(-(a[1] + lost * b[1]) * r - (a[1] + b[1]) * s)
        red += weight * math.exp(-(a[2] + lost * b[2]) * r - (a[2] + b[2]) * s)
    scale = beam.intensity_w_sr * step / aside_m
    return blue * b[0] * scale, green * b[1] * scale, red * b[2] * scale


def direct_light(
    camera_m: Vector, target_m: Vector, radius_m: float, lamp_m: Vector, lighting: Lighting
) -> tuple[Colours, ...]:
    """Light of a ball at the points of its inner disc, 0 where it lies in its own shade."""
    water, beam = lighting.water, lighting.beam
    k = [a + FORWARD * b for a, b in zip(water.absorption_per_m, water.scattering_per_m, strict=True)]
    c = [a + b for a, b in zip(water.absorption_per_m, water.scattering_per_m, strict=True)]
    half_rad = math.radians(beam.half_deg)
    to_target = [t - p for t, p in zip(target_m, lamp_m, strict=True)]
    lamp_range_m = math.sqrt(sum(x * x for x in to_target))
    found: list[Colours] = []
    for normal in disc_normals(camera_m, target_m):
        point = [t + radius_m * n for t, n in zip(target_m, normal, strict=True)]
        way = [p - q for p, q in zip(point, lamp_m, strict=True)]
        r = math.sqrt(sum(x * x for x in way))
        facing = -sum(w * n for w, n in zip(way, normal, strict=True)) / r
        if facing <= 0.0:
            found.append((0.0, 0.0, 0.0))
            continue
        aligned = sum(w * t for w, t in zip(way, to_target, strict=True)) / (r * lamp_range_m)
        off = math.acos(min(max(aligned, -1.0), 1.0))
        z = math.dist(point, camera_m)
        lit = ALBEDO / math.pi * beam.intensity_w_sr * beam_share(off, half_rad) * facing / (r * r)
        blue, green, red = (lit * math.exp(-kl * r - cc * z) for kl, cc in zip(k, c, strict=True))
        found.append((blue, green, red))
    return tuple(found)


def disc_normals(camera_m: Vector, target_m: Vector) -> list[Vector]:
    """Outward normals of a ball at the points of its inner disc as the camera sees it, 25 of them, world frame."""
    depth_m = math.dist(camera_m, target_m)
    nx, ny, nz = ((c - t) / depth_m for c, t in zip(camera_m, target_m, strict=True))
    level = math.hypot(nx, ny)
    ux, uy, uz = (-ny / level, nx / level, 0.0) if level > 1e-6 else (1.0, 0.0, 0.0)
    vx, vy, vz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
    normals: list[Vector] = []
    for ring in RINGS:
        rho = INNER * ring
        rise = math.sqrt(1.0 - rho * rho)
        for spoke in range(SPOKES if ring else 1):
            turn = 2.0 * math.pi * spoke / SPOKES
            u, v = rho * math.cos(turn), rho * math.sin(turn)
            normals.append((rise * nx + u * ux + v * vx, rise * ny + u * uy + v * vy, rise * nz + u * uz + v * vz))
    return normals


# --- a ball lit from aside ---
# A ball that is lit from aside: which of its cues hold, and where its middle is when only its lit part was outlined.
#
# The edge towards the lamp is the ball's own, the one opposite is where its shadow begins. With the radius r of the
# outline, the radius R that the ball must have in the picture at the range of its focus, and u the way to the lamp:
#
#     middle = outline's middle - (R - r) u
#
# Its size says nothing of its range then, so that the focus alone counts.

LEAST_PX = 3.0  # of R - r: twice what the range by focus leaves open of R at 1.5 m
MOST = 0.4  # of R: an outline that lacks more is of something else
ONE_SIDE = 0.5  # cosine between ways to lamps, above which they light the same side

# By pictures of nights with seeds 3, 11 and 15, 1.3 m from the ball: peaks scatter by so much more than their curves
# and the size of the outline say, for part of it is dark, and the rest dim; and its middle wanders by so many pixels.
SCATTERS = 1.75
WANDERS_PX = 2.0


def cues_by(cues: Cues) -> Cues:
    """What of the wanted cues a lamp from aside leaves."""
    return "focus" if cues == "both" else cues


def whole(
    calibration: Calibration,
    eye: Eye,
    outline: Outline,
    rho: float,
    sigma: float,
    ball: Target,
    lamps_m: Sequence[Vector],
) -> Outline:
    """The outline of the ball, where that was one of its lit part. lamps_m: places of the lamps that burned."""
    ways = []
    camera = at_lens_position(calibration.camera, outline.lens_position)
    if ball.radius_m is None or outline.radius_px is None or not lamps_m:
        return outline
    far = focus_range(calibration.swept, camera, outline.centre_px, rho, sigma, ball, eye.tilt_rad)
    if far is None or far.distance_m <= ball.radius_m:
        return outline
    whole_px = camera.f_px * math.asin(ball.radius_m / far.distance_m)
    lacks_px = whole_px - outline.radius_px
    if not LEAST_PX <= lacks_px <= MOST * whole_px:
        return outline
    at = tuple(far.distance_m * part for part in ray(camera, outline.centre_px))
    for place_m in lamps_m:
        x, y, _ = (lamp - ball_at for lamp, ball_at in zip(to_camera(eye, place_m), at, strict=True))
        length = math.hypot(x, y)
        if length > 0.0:
            ways.append((x / length, y / length))
    x, y = sum(way[0] for way in ways), sum(way[1] for way in ways)
    length = math.hypot(x, y)
    if not ways or length < 1e-6 or any(way[0] * x + way[1] * y < ONE_SIDE * length for way in ways):
        return outline  # from both sides: there is no telling which edge is whose
    u, v = outline.centre_px
    centre_px = u - lacks_px * x / length, v - lacks_px * y / length
    return outline._replace(centre_px=centre_px, radius_px=whole_px)
