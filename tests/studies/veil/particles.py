"""The veil of a lamp to all orders of scattering, by Monte Carlo: the kernel's and the twin's tables are made from it
(tables.py) and measured against it (claim.py).

Paths are drawn backward from the camera: light goes the same way to and fro. On each straight piece the lamp is looked
at from one point within its beam, drawn so that its distance to the lamp does not show in the weight (equiangular:
Kulla and Fajardo, Importance Sampling Techniques for Path Tracing in Participating Media, EGSR 2012). Looked at from
collisions alone, the few that lie beside the lamp make outliers that no number of paths averages away. For the same
reason every other new direction is drawn about the lamp's.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.compiled import compiled

# --- phase function ---
# Fournier-Forand (1994) from its closed cumulative (Fournier and Jonasz, Proc. SPIE 3761, 1999). It shares no code with
# the kernel's and the twin's, so that neither is tested against itself.

Array = NDArray[np.float64]

INDEX, SLOPE = 1.10, 3.5835
SMALLEST_RAD = 1e-6
AIM_RAD = 5e-3
NONE = -60.0  # stands for the logarithm of nothing
ANGLES = 4096  # of the tables, even in the logarithm of the angle
DRAWS = 1 << 18


class Particles(NamedTuple):
    """Tables for the kernels."""

    log_phase: Array  # (ANGLES,) of the phase function per steradian, from SMALLEST_RAD to pi
    drawn_cos: Array  # (DRAWS,) cosines of scattering angles, equally likely
    log_aim: Array  # (ANGLES,) as log_phase, of directions drawn about the lamp's: the same without a peak or hole
    aimed_cos: Array  # (DRAWS,)
    kept: float  # share of the scattering coefficient that is left


def phase(angle_rad: Array) -> Array:
    """Phase function (n,) per steradian."""
    nu, k = (3 - SLOPE) / 2, 4 / (3 * (INDEX - 1) ** 2)
    u = np.sin(angle_rad / 2) ** 2
    d = k * u
    d = np.where(np.abs(d - 1) < 1e-5, 1 + 1e-5, d)
    first = nu * (1 - d) - (1 - d**nu) + (d * (1 - d**nu) - nu * (1 - d)) / u
    rest = (1 - k**nu) / (16 * np.pi * (k - 1) * k**nu) * (3 * np.cos(angle_rad) ** 2 - 1)
    return np.asarray(first / (4 * np.pi * (1 - d) ** 2 * d**nu) + rest)


def within(angle_rad: Array) -> Array:
    """Share (n,) that is scattered by less than this angle."""
    nu, k = (3 - SLOPE) / 2, 4 / (3 * (INDEX - 1) ** 2)
    u = np.sin(angle_rad / 2) ** 2
    d = k * u
    d = np.where(np.abs(d - 1) < 1e-5, 1 + 1e-5, d)
    front = ((1 - d ** (nu + 1)) - (1 - d**nu) * u) / ((1 - d) * d**nu)
    back = (1 - k**nu) / (8 * (k - 1) * k**nu) * np.cos(angle_rad) * np.sin(angle_rad) ** 2
    return np.asarray(front + back)


@lru_cache
def particles(straight_rad: float = SMALLEST_RAD) -> Particles:
    """`straight_rad`: what is scattered by less goes on as if it were not. For light of all orders that changes nothing
    that shows, and the peak of the phase function, whence outliers come, is gone."""
    angle = np.geomspace(SMALLEST_RAD, np.pi, ANGLES)
    even = (np.arange(DRAWS) + 0.5) / DRAWS
    straight = float(within(np.array([straight_rad]))[0])
    drawn = np.interp(straight + (1 - straight) * even, within(angle), angle)
    log_phase = np.where(angle >= straight_rad, np.log(phase(angle) / (1 - straight)), NONE)
    filled = phase(np.maximum(angle, max(straight_rad, AIM_RAD)))
    ring = np.pi * np.diff(-np.cos(angle)) * (filled[1:] + filled[:-1])
    share = np.concatenate([[0.0], np.cumsum(ring)])
    aimed = np.interp(even * share[-1], share, angle)
    return Particles(log_phase, np.cos(drawn), np.log(filled / share[-1]), np.cos(aimed), 1 - straight)


# --- paths ---

HALF_RAD = math.radians(25.0)  # of a lamp's beam
LAMP_M = 0.015  # its radius; no water is nearer to its middle
ALONG, POINT, SURFACE = range(3)  # what is asked for: a camera's ray, one point of it, a surface that faces the lamp
STRAIGHT_RAD = math.radians(5.0)  # scattered by less, light of all orders is taken as going straight on
PER_LOG = (ANGLES - 1) / math.log(math.pi / SMALLEST_RAD)

Vec = tuple[float, float, float]

kernel = compiled(fastmath=True, error_model="numpy")
inlined = compiled(fastmath=True, error_model="numpy", inline="always")


class Medium(NamedTuple):
    absorption_per_m: float
    scattering_per_m: float


class Setting(NamedTuple):
    """One lamp and what it is seen by; metres. A ball of radius 0 is none; it is black, and throws a shadow."""

    lamp_m: Vec
    aim: Vec  # unit vector
    half_rad: float
    start_m: Vec = (0.0, 0.0, 0.0)
    way: Vec = (0.0, 0.0, 1.0)  # unit vector: where the camera looks, or the surface does
    length_m: float = math.inf  # of the camera's ray
    ball_m: Vec = (0.0, 0.0, 0.0)
    ball_radius_m: float = 0.0


def beside(depth_m: float, radius_m: float, ahead_m: float, aside_m: float) -> Setting:
    """A camera at the origin that looks along z at a ball, and a lamp that aims at it too."""
    range_m = math.hypot(depth_m - ahead_m, aside_m)
    return Setting(
        lamp_m=(aside_m, 0.0, ahead_m),
        aim=(-aside_m / range_m, 0.0, (depth_m - ahead_m) / range_m),
        half_rad=HALF_RAD,
        length_m=depth_m - radius_m,
        ball_m=(0.0, 0.0, depth_m),
        ball_radius_m=radius_m,
    )


class Orders(NamedTuple):
    """Radiance per W/sr of the lamp, 1/m2, by order of scattering; of a point per metre, of a surface irradiance."""

    mean: Array  # (orders,)
    total: float
    error: float  # standard error of the total, from the batches


def scattered(
    setting: Setting,
    medium: Medium,
    what: int = ALONG,
    orders: int = 14,
    paths: int = 20_000,
    error: float = 0.05,
    most: int = 40,
    seed: int = 0,
    straight_rad: float | None = None,
) -> Orders:
    """Batches of paths, at least 8 and `most` at most, until the total is known to the relative `error` (standard)."""
    tables = particles(STRAIGHT_RAD if straight_rad is None else straight_rad)
    medium = medium._replace(scattering_per_m=medium.scattering_per_m * tables.kept)
    rng = np.random.default_rng(seed)
    sums: list[Array] = []
    while len(sums) < most:
        sums.append(_batch(setting, medium, what, orders, paths, rng, tables))
        totals = np.array([row.sum() for row in sums])
        spread = float(totals.std(ddof=1)) / math.sqrt(len(sums)) if len(sums) > 1 else math.inf
        if len(sums) >= 8 and spread <= error * float(totals.mean()):
            break
    return Orders(np.mean(sums, axis=0), float(totals.mean()), spread)


@inlined
def _phase(cosine: float, log_phase: Array) -> float:
    angle = max(math.acos(min(max(cosine, -1.0), 1.0)), SMALLEST_RAD)
    x = math.log(angle / SMALLEST_RAD) * PER_LOG
    i = min(int(x), ANGLES - 2)
    return math.exp(log_phase[i] + (x - i) * (log_phase[i + 1] - log_phase[i]))


@inlined
def _hit(at: Vec, way: Vec, radius: float) -> float:
    """Way to a ball whose centre is the origin, from outside; inf: it is missed."""
    (ox, oy, oz), (dx, dy, dz) = at, way
    along = -(ox * dx + oy * dy + oz * dz)
    root = radius * radius - (ox * ox + oy * oy + oz * oz - along * along)
    return along - math.sqrt(root) if along > 0.0 and root > 0.0 else math.inf


@inlined
def _beam(cosine: float, half: float) -> float:
    t = min(max((1.2 - math.acos(min(max(cosine, -1.0), 1.0)) / half) / 0.4, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@inlined
def _in_cone(q: Vec, way: Vec, aim: Vec, edge2: float, limit: float) -> tuple[float, float]:
    """Where on a ray, from q off the lamp on, it is within the lamp's beam: (v A)^2 >= cos^2 v^2 and v A > 0."""
    (qx, qy, qz), (dx, dy, dz), (ax, ay, az) = q, way, aim
    m, n = qx * ax + qy * ay + qz * az, dx * ax + dy * ay + dz * az
    qq, qd = qx * qx + qy * qy + qz * qz, qx * dx + qy * dy + qz * dz
    a, b, c = n * n - edge2, m * n - edge2 * qd, m * m - edge2 * qq
    root = b * b - a * c
    if abs(a) < 1e-9:  # along the beam's edge
        cut = -0.5 * c / b if b != 0.0 else 0.0
        if n > 0.0:
            return max(cut, 0.0), limit
        return 0.0, min(cut, limit)
    if root <= 0.0:
        return 0.0, 0.0
    root = math.sqrt(root)
    one, two = (-b - root) / a, (-b + root) / a
    low, high = min(one, two), max(one, two)
    if a > 0.0:
        return (max(high, 0.0), limit) if n > 0.0 else (0.0, min(low, limit))
    if m + 0.5 * (low + high) * n <= 0.0:
        return 0.0, 0.0
    return max(low, 0.0), min(high, limit)


@inlined
def _turned(way: Vec, cosine: float, phi: float) -> Vec:
    """A direction so far off another, turned about it by phi."""
    dx, dy, dz = way
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    a, b = sine * math.cos(phi), sine * math.sin(phi)
    if abs(dz) > 0.99999:
        return a, b, cosine * dz
    side = math.sqrt(1.0 - dz * dz)
    ux, uy = -dy / side, dx / side  # level, across
    return (
        cosine * dx + a * ux - b * dz * uy,
        cosine * dy + a * uy + b * dz * ux,
        cosine * dz + b * (uy * dx - ux * dy),
    )


@inlined
def _towards(at: Vec, lamp: Vec) -> Vec:
    tx, ty, tz = lamp[0] - at[0], lamp[1] - at[1], lamp[2] - at[2]
    r = max(math.sqrt(tx * tx + ty * ty + tz * tz), 1e-9)
    return tx / r, ty / r, tz / r


@inlined
def _scattered(at: Vec, way: Vec, lamp: Vec, rng: np.random.Generator, tables: Particles) -> tuple[Vec, float]:
    """A new direction and its weight. Every other one is drawn about the direction of the lamp: most light comes from
    near there, and large angles, which alone lead there from most places, would hardly ever be drawn."""
    to = _towards(at, lamp)
    k, spin = int(rng.random() * DRAWS), 2.0 * math.pi * rng.random()
    about, cosine = (way, tables.drawn_cos[k]) if rng.random() < 0.5 else (to, tables.aimed_cos[k])
    u = _turned(about, cosine, spin)
    here = _phase(u[0] * way[0] + u[1] * way[1] + u[2] * way[2], tables.log_phase)
    there = _phase(u[0] * to[0] + u[1] * to[1] + u[2] * to[2], tables.log_aim)
    return u, here / (0.5 * here + 0.5 * there + 1e-20)


@kernel
def _batch(
    setting: Setting, medium: Medium, what: int, orders: int, paths: int, rng: np.random.Generator, tables: Particles
) -> Array:
    """(orders,) means over the paths."""
    found = np.zeros(orders)
    a, b = medium.absorption_per_m, medium.scattering_per_m
    c = a + b
    (lx, ly, lz), (ax, ay, az) = setting.lamp_m, setting.aim
    bx, by, bz = setting.ball_m
    radius = setting.ball_radius_m
    edge2 = math.cos(1.2 * setting.half_rad) ** 2
    for _ in range(paths):
        (x, y, z), (dx, dy, dz) = setting.start_m, setting.way
        weight, first = 1.0, 0
        limit = setting.length_m
        if what != ALONG:
            limit, spin = math.inf, 2.0 * math.pi * rng.random()
            if what == POINT:
                weight, first = b, 1
                (dx, dy, dz), share = _scattered((x, y, z), (dx, dy, dz), setting.lamp_m, rng, tables)
                weight *= share
            else:
                nx, ny, nz = setting.way
                if rng.random() < 0.5:
                    dx, dy, dz = _turned(setting.way, math.sqrt(rng.random()), spin)
                else:
                    to = _towards(setting.start_m, setting.lamp_m)
                    dx, dy, dz = _turned(to, tables.aimed_cos[int(rng.random() * DRAWS)], spin)
                cosine = dx * nx + dy * ny + dz * nz
                if cosine <= 0.0:
                    continue
                tx, ty, tz = _towards(setting.start_m, setting.lamp_m)
                other = _phase(dx * tx + dy * ty + dz * tz, tables.log_aim)
                weight = cosine / (0.5 * cosine / math.pi + 0.5 * other)
        for order in range(first, orders):
            if radius > 0.0 and order > 0:
                limit = _hit((x - bx, y - by, z - bz), (dx, dy, dz), radius)
            # --- the lamp, seen from one point of this piece
            s0 = (lx - x) * dx + (ly - y) * dy + (lz - z) * dz
            hx, hy, hz = x + s0 * dx - lx, y + s0 * dy - ly, z + s0 * dz - lz
            h = max(math.sqrt(hx * hx + hy * hy + hz * hz), 1e-6)
            start, end = _in_cone((x - lx, y - ly, z - lz), (dx, dy, dz), setting.aim, edge2, limit)
            if end > start:
                low = math.atan((start - s0) / h)
                high = 0.5 * math.pi if end == math.inf else math.atan((end - s0) / h)
                turn = low + (high - low) * rng.random()
                beyond = h * math.tan(turn)
                r = math.sqrt(h * h + beyond * beyond)
                px, py, pz = (hx + beyond * dx) / r, (hy + beyond * dy) / r, (hz + beyond * dz) / r  # lamp to point
                dark = radius > 0.0 and _hit((lx - bx, ly - by, lz - bz), (px, py, pz), radius) < r
                if r > LAMP_M and not dark:
                    beam = _beam(px * ax + py * ay + pz * az, setting.half_rad)
                    through = math.exp(-c * (s0 + beyond + r))
                    p = _phase(-beyond / r, tables.log_phase)
                    found[order] += weight * b * p * beam * through * (high - low) / h
            # --- on to the next collision
            if limit == math.inf:
                s = -math.log(1.0 - rng.random()) / c
                weight *= b / c
            elif order == 0:
                inside = 1.0 - math.exp(-c * limit)
                s = -math.log(1.0 - rng.random() * inside) / c
                weight *= b / c * inside
            else:
                s = -math.log(1.0 - rng.random()) / c
                weight *= b / c
                if s >= limit:
                    break
            x, y, z = x + s * dx, y + s * dy, z + s * dz
            (dx, dy, dz), share = _scattered((x, y, z), (dx, dy, dz), setting.lamp_m, rng, tables)
            weight *= share
    return found / paths
