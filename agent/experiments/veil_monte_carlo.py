"""The veil of a lamp to all orders of scattering, by Monte Carlo: the kernel's and the twin's tables are made from it
and tested against it.

Paths are drawn backward from the camera: light goes the same way to and fro. On each straight piece the lamp is looked
at from one point within its beam, drawn so that its distance to the lamp does not show in the weight (equiangular:
Kulla and Fajardo, Importance Sampling Techniques for Path Tracing in Participating Media, EGSR 2012). Looked at from
collisions alone, the few that lie beside the lamp make outliers that no number of paths averages away. For the same
reason every other new direction is drawn about the lamp's.

`python -m agent.experiments.veil_monte_carlo [kernel] [twin]` makes both tables, in minutes of one core. The same seeds
make the same tables on one machine.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.light.model import single_veil
from agent.core.config import Beam, WaterOptics
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
    log_aim: (
        Array  # (ANGLES,) as log_phase, of directions that are drawn about the lamp's: the same without a peak or hole
    )
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

LAMP_M = 0.015  # its radius; no water is nearer to its middle
ALONG, POINT, SURFACE = range(3)  # what is asked for: a camera's ray, one point of it, a surface that faces the lamp
STRAIGHT_RAD = math.radians(5.0)  # scattered by less, light of all orders is taken as going straight on
PER_LOG = (ANGLES - 1) / math.log(math.pi / SMALLEST_RAD)

kernel = compiled(fastmath=True, error_model="numpy")
inlined = compiled(fastmath=True, error_model="numpy", inline="always")


class Medium(NamedTuple):
    absorption_per_m: float
    scattering_per_m: float


class Setting(NamedTuple):
    """One lamp and what it is seen by; metres. A ball of radius 0 is none; it is black, and throws a shadow."""

    lamp_m: tuple[float, float, float]
    aim: tuple[float, float, float]  # unit vector
    half_rad: float
    start_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    way: tuple[float, float, float] = (0.0, 0.0, 1.0)  # unit vector: where the camera looks, or the surface does
    length_m: float = math.inf  # of the camera's ray
    ball_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ball_radius_m: float = 0.0


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
def _hit(ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, radius: float) -> float:
    """Way to a ball whose centre is the origin, from outside; inf: it is missed."""
    along = -(ox * dx + oy * dy + oz * dz)
    root = radius * radius - (ox * ox + oy * oy + oz * oz - along * along)
    return along - math.sqrt(root) if along > 0.0 and root > 0.0 else math.inf


@inlined
def _beam(cosine: float, half: float) -> float:
    t = min(max((1.2 - math.acos(min(max(cosine, -1.0), 1.0)) / half) / 0.4, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@inlined
def _in_cone(
    qx: float,
    qy: float,
    qz: float,
    dx: float,
    dy: float,
    dz: float,
    ax: float,
    ay: float,
    az: float,
    edge2: float,
    limit: float,
) -> tuple[float, float]:
    """Where on a ray, from q off the lamp on, it is within the lamp's beam: (v A)^2 >= cos^2 v^2 and v A > 0."""
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
def _turned(dx: float, dy: float, dz: float, cosine: float, phi: float) -> tuple[float, float, float]:
    """A direction so far off (dx, dy, dz), turned about it by phi."""
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
def _towards(x: float, y: float, z: float, lx: float, ly: float, lz: float) -> tuple[float, float, float]:
    tx, ty, tz = lx - x, ly - y, lz - z
    r = max(math.sqrt(tx * tx + ty * ty + tz * tz), 1e-9)
    return tx / r, ty / r, tz / r


@inlined
def _scattered(
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    lx: float,
    ly: float,
    lz: float,
    rng: np.random.Generator,
    tables: Particles,
) -> tuple[float, float, float, float]:
    """A new direction and its weight. Every other one is drawn about the direction of the lamp: most light comes from
    near there, and large angles, which alone lead there from most places, would hardly ever be drawn."""
    tx, ty, tz = _towards(x, y, z, lx, ly, lz)
    k, spin = int(rng.random() * DRAWS), 2.0 * math.pi * rng.random()
    if rng.random() < 0.5:
        ux, uy, uz = _turned(dx, dy, dz, tables.drawn_cos[k], spin)
    else:
        ux, uy, uz = _turned(tx, ty, tz, tables.aimed_cos[k], spin)
    here = _phase(ux * dx + uy * dy + uz * dz, tables.log_phase)
    there = _phase(ux * tx + uy * ty + uz * tz, tables.log_aim)
    return ux, uy, uz, here / (0.5 * here + 0.5 * there + 1e-20)


@kernel
def _batch(
    setting: Setting,
    medium: Medium,
    what: int,
    orders: int,
    paths: int,
    rng: np.random.Generator,
    tables: Particles,
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
                dx, dy, dz, share = _scattered(x, y, z, dx, dy, dz, lx, ly, lz, rng, tables)
                weight *= share
            else:
                nx, ny, nz = dx, dy, dz
                if rng.random() < 0.5:
                    dx, dy, dz = _turned(nx, ny, nz, math.sqrt(rng.random()), spin)
                else:
                    dx, dy, dz = _towards(x, y, z, lx, ly, lz)
                    dx, dy, dz = _turned(dx, dy, dz, tables.aimed_cos[int(rng.random() * DRAWS)], spin)
                cosine = dx * nx + dy * ny + dz * nz
                if cosine <= 0.0:
                    continue
                tx, ty, tz = _towards(x, y, z, lx, ly, lz)
                other = _phase(dx * tx + dy * ty + dz * tz, tables.log_aim)
                weight = cosine / (0.5 * cosine / math.pi + 0.5 * other)
        for order in range(first, orders):
            if radius > 0.0 and order > 0:
                limit = _hit(x - bx, y - by, z - bz, dx, dy, dz, radius)
            # --- the lamp, seen from one point of this piece
            s0 = (lx - x) * dx + (ly - y) * dy + (lz - z) * dz
            hx, hy, hz = x + s0 * dx - lx, y + s0 * dy - ly, z + s0 * dz - lz
            h = max(math.sqrt(hx * hx + hy * hy + hz * hz), 1e-6)
            start, end = _in_cone(x - lx, y - ly, z - lz, dx, dy, dz, ax, ay, az, edge2, limit)
            if end > start:
                low = math.atan((start - s0) / h)
                high = 0.5 * math.pi if end == math.inf else math.atan((end - s0) / h)
                turn = low + (high - low) * rng.random()
                beyond = h * math.tan(turn)
                r = math.sqrt(h * h + beyond * beyond)
                px, py, pz = (hx + beyond * dx) / r, (hy + beyond * dy) / r, (hz + beyond * dz) / r  # lamp to point
                dark = radius > 0.0 and _hit(lx - bx, ly - by, lz - bz, px, py, pz, radius) < r
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
            dx, dy, dz, share = _scattered(x, y, z, dx, dy, dz, lx, ly, lz, rng, tables)
            weight *= share
    return found / paths


# --- nodes of both tables: the kernel's along a camera's axis, the twin's at a point of the water ---

Report = Callable[[int, int], None]

HALF_RAD = math.radians(25.0)

# Of the kernel's table:
TAU = (0.1, 0.3, 0.6, 1.2, 2.0, 3.0, 4.5, 6.5)  # scattering lengths from camera to target
SHARE = (0.35, 0.55, 0.70, 0.80, 0.90)  # b / (a + b)
ANGLE_DEG = (3.0, 6.0, 12.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0)  # at the target, from camera to lamp
RATIO = (0.25, 0.5, 1.0, 1.5)  # lamp to target over camera to target
DEPTH_M, RADIUS_M = 1.25, 0.07

# Of the twin's table:
POINT_TAU = (0.03, 0.1, 0.25, 0.5, 1.0, 1.75, 2.75, 4.0, 6.0)  # scattering lengths from the lamp
OFF_DEG = (0.0, 15.0, 25.0, 35.0, 50.0, 80.0, 120.0, 180.0)  # off the lamp's axis
WAY_DEG = (0.0, 20.0, 45.0, 75.0, 105.0, 140.0, 180.0)  # of the light that is asked for, off the ray from the lamp
SPIN_DEG = (0.0, 90.0, 180.0)  # of it about that ray; 0: away from the lamp's axis
POINT_SHARE = (0.40, 0.60, 0.75, 0.85)
FADE = 0.35  # of the scattering coefficient: with absorption, about how the scattered light falls off beside 1/r^2


def all_over_single(report: Report) -> tuple[Array, Array]:
    """(8, 5, 9, 4) logarithm of all orders over the kernel's single one, and its standard error."""
    shape = (len(TAU), len(SHARE), len(ANGLE_DEG), len(RATIO))
    found, error = np.zeros(shape), np.zeros(shape)
    nodes = list(product(*map(enumerate, (TAU, SHARE, ANGLE_DEG, RATIO))))
    for n, ((i, tau), (j, share), (k, angle_deg), (m, ratio)) in enumerate(nodes):
        found[i, j, k, m], error[i, j, k, m] = one_node(tau, share, math.radians(angle_deg), ratio, n)
        report(n + 1, len(nodes))
    return found, error


def one_node(
    tau: float, share: float, angle_rad: float, ratio: float, seed: int, most: int = 60
) -> tuple[float, float]:
    """Logarithm of the factor, and its standard error."""
    b = tau / DEPTH_M
    a = b * (1.0 / share - 1.0)
    range_m = ratio * DEPTH_M
    ahead_m, aside_m = DEPTH_M - range_m * math.cos(angle_rad), range_m * math.sin(angle_rad)
    water = WaterOptics(absorption_per_m=(a,) * 3, scattering_per_m=(b,) * 3)
    single = single_veil(DEPTH_M, RADIUS_M, ahead_m, aside_m, water, Beam(intensity_w_sr=1.0))[0]
    drawn = scattered(
        beside(DEPTH_M, RADIUS_M, ahead_m, aside_m), Medium(a, b), orders=12, paths=500, most=most, seed=seed
    )
    return math.log(drawn.total / single), drawn.error / drawn.total


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


def of_points(report: Report, paths: int = 300, most: int = 20) -> tuple[Array, Array, Array, Array]:
    """(4, 9, 8, 7, 3) logarithm of the light of two and more orders that a point of the water sends somewhere, times
    tau^2 and what brings it near to even, for b = 1; and (4, 9, 8) of what arrives scattered at a surface there.
    Then the standard errors of both."""
    volume = np.zeros((len(POINT_SHARE), len(POINT_TAU), len(OFF_DEG), len(WAY_DEG), len(SPIN_DEG)))
    surface = np.zeros(volume.shape[:3])
    volume_error, surface_error = np.zeros(volume.shape), np.zeros(surface.shape)
    nodes = list(product(*map(enumerate, (POINT_SHARE, POINT_TAU, OFF_DEG))))
    for n, ((i, share), (j, tau), (k, off_deg)) in enumerate(nodes):
        medium = Medium(1.0 / share - 1.0, 1.0)
        scale = tau**2 * math.exp((medium.absorption_per_m + FADE) * tau)
        seen = Setting((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), HALF_RAD)
        for what, setting in _asked(seen, tau, math.radians(off_deg)):
            drawn = scattered(
                setting,
                medium,
                SURFACE if what is None else POINT,
                orders=12,
                paths=paths,
                error=0.04,
                most=most,
                seed=n,
            )
            value = math.log(max(drawn.total * scale, 1e-12))
            if what is None:
                surface[i, j, k], surface_error[i, j, k] = value, drawn.error / drawn.total
            else:
                volume[i, j, k, what[0], what[1]] = value
                volume_error[i, j, k, what[0], what[1]] = drawn.error / drawn.total
        report(n + 1, len(nodes))
    return volume, surface, volume_error, surface_error


def _asked(seen: Setting, tau: float, off_rad: float) -> Iterator[tuple[tuple[int, int] | None, Setting]]:
    """A camera's rays through one point, by their nodes; None: the surface that faces the lamp there."""
    sin, cos = math.sin(off_rad), math.cos(off_rad)
    start_m = (tau * sin, 0.0, tau * cos)
    out, away = (sin, 0.0, cos), (cos, 0.0, -sin)  # from the lamp, and from its axis
    yield None, seen._replace(start_m=start_m, way=(-out[0], -out[1], -out[2]))
    for (k, way_deg), (m, spin_deg) in product(enumerate(WAY_DEG), enumerate(SPIN_DEG)):
        way, spin = math.radians(way_deg), math.radians(spin_deg)
        side = (away[0] * math.cos(spin), math.sin(spin), away[2] * math.cos(spin))
        light = tuple(o * math.cos(way) + s * math.sin(way) for o, s in zip(out, side, strict=True))
        yield (k, m), seen._replace(start_m=start_m, way=(-light[0], -light[1], -light[2]))


# --- smoothing: as near to drawn values as their errors ask, and bent as little as that allows ---

BEND = 0.15  # standard deviation of a second difference between neighbours, in the logarithm: what real ones have
ROUNDS = 4000
WORST = 3.0  # errors: what lies further off, counts as that far (Huber), so that an outlier pulls no neighbour along


def smoothed(values: Array, error: Array) -> Array:
    """Least squares of (value - drawn) / error and second differences / BEND along each axis, by conjugate gradients;
    three passes with new weights for outliers."""
    fitted = values.copy()
    weight = 1.0 / np.maximum(error, 0.01) ** 2
    for _ in range(3):
        off = np.abs(values - fitted) * np.sqrt(1.0 / np.maximum(error, 0.01) ** 2)
        trust = weight * np.minimum(1.0, WORST / np.maximum(off, 1e-9))
        fitted = _solved(values, trust)
    return fitted


def _solved(values: Array, trust: Array) -> Array:
    def apply(x: Array) -> Array:
        return trust * x + _bending(x) / BEND**2

    x = values.copy()
    rest = trust * values - apply(x)
    way = rest.copy()
    norm = float((rest * rest).sum())
    start = norm
    for _ in range(ROUNDS):
        if norm <= 1e-16 * max(start, 1e-300):
            break
        pushed = apply(way)
        step = norm / float((way * pushed).sum())
        x += step * way
        rest -= step * pushed
        after = float((rest * rest).sum())
        way = rest + after / norm * way
        norm = after
    return x


def _bending(x: Array) -> Array:
    """The second differences' transpose times themselves, along each axis of three nodes or more."""
    total = np.zeros_like(x)
    for axis in range(x.ndim):
        if x.shape[axis] < 3:
            continue
        second = np.diff(x, 2, axis=axis)
        pad = [(0, 0)] * x.ndim
        for shift, factor in ((0, 1.0), (1, -2.0), (2, 1.0)):
            pad[axis] = (shift, 2 - shift)
            total += factor * np.pad(second, pad)
    return total


# --- the tables as files ---

ROOT = Path(__file__).parents[2]
KERNEL = ROOT / "agent/capabilities/light/veil_table.py"
TWIN = ROOT / "hw/twin/optics/scattered.txt"

KERNEL_HEAD = '''"""Veil of all orders of scattering over that of one, as logarithms.

Made by `python -m agent.experiments.veil_monte_carlo kernel`.

Beam of 25 degrees, a black ball of 70 mm at 1.25 m. Monte Carlo to a standard error of 5 %, then smoothed.
Order of the axes: TAU, SCATTERING_SHARE, ANGLE_DEG, RATIO; a line holds the ratios of three angles.
"""

'''
TWIN_HEAD = """# Light that the water around a lamp scatters.
# Made by `python -m agent.experiments.veil_monte_carlo twin`.
# Five axes: b / (a + b), scattering lengths from the lamp, degrees off its axis, degrees of the light's way off the ray
# from it, degrees of that about the ray. Then logarithms: (5 axes) of light of two and more orders in all directions;
# (first 3 axes) of scattered light on a surface that faces the lamp.
"""


def write_kernel(found: Array, error: Array, path: Path = KERNEL) -> None:
    numbers = smoothed(found, error).reshape(-1)
    names = ("TAU", "SCATTERING_SHARE", "ANGLE_DEG", "RATIO")
    axes = (TAU, SHARE, ANGLE_DEG, RATIO)
    lines = [f"{name} = {axis}" for name, axis in zip(names, axes, strict=True)]
    rows = [", ".join(f"{x:.3f}" for x in numbers[i : i + 12]) for i in range(0, len(numbers), 12)]
    lines += ["# fmt: off", "LOG_TIMES = (", *(f"    {row}," for row in rows), ")", "# fmt: on"]
    path.write_text(KERNEL_HEAD + "\n".join(lines) + "\n", "ascii")


def write_twin(volume: Array, surface: Array, errors: tuple[Array, Array], path: Path = TWIN) -> None:
    names = ("share", "tau", "off_deg", "way_deg", "spin_deg")
    axes = (
        POINT_SHARE,
        POINT_TAU,
        OFF_DEG,
        WAY_DEG,
        SPIN_DEG,
    )
    lines = [" ".join([name, *(f"{x:g}" for x in axis)]) for name, axis in zip(names, axes, strict=True)]
    for values, error in zip((volume, surface), errors, strict=True):
        numbers = smoothed(values, error).reshape(-1)
        lines += [" ".join(f"{x:.3f}" for x in numbers[i : i + 21]) for i in range(0, len(numbers), 21)]
    path.write_text(TWIN_HEAD + "\n".join(lines) + "\n", "ascii")


def main(which: Sequence[str]) -> None:
    def report(done: int, of: int) -> None:
        if done % 50 == 0 or done == of:
            sys.stderr.write(f"\r{done}/{of}")

    if not which or "kernel" in which:
        write_kernel(*all_over_single(report))
    if not which or "twin" in which:
        volume, surface, *errors = of_points(report)
        write_twin(volume, surface, (errors[0], errors[1]))


if __name__ == "__main__":
    main(sys.argv[1:])
