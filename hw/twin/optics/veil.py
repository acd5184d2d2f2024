"""The veil of all lamps in cells of the camera's view: froxels, after Wronski, Volumetric Fog, SIGGRAPH 2014.

Along the rays of a coarse grid of pixels, light is added up from the camera on; a pixel takes the veil in front of its
own surface from the eight corners around it. Light scattered once is cast into shadow by hulls and solids; that of more
orders comes from everywhere, and is taken as in open water.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw.twin.optics.raycast import ONE, ZERO, F, Floats, LampBeam, Optics, inlined, kernel, ray

# --- scattering: once, by the phase function, and more often, by a table from Monte Carlo ---
#
# What goes less than 5 degrees aside is taken as going straight on: for the veil it makes no difference, and what is
# left is smooth. The table (scattered.txt) is of one lamp in open water, for b = 1 and by the share of
# scattering in the attenuation; any water's lengths are counted in its scattering lengths.

Array = NDArray[np.float64]

INDEX, SLOPE = 1.10, 3.5835  # Fournier-Forand: 0.018 of it goes back, Petzold's mean
STRAIGHT_RAD = math.radians(5.0)
SINES = 2048  # of the phase table, by the sine of half the angle

RANGE_STEP_M, RANGES = 0.02, 200  # of the table of points
SURFACE_STEP_M, SURFACES = 0.004, 1000  # of that of surfaces, which is so fine that a pixel takes the nearest range
# Off the axis and of the light's way, even in the sine of half the angle; cosine of the spin.
OFFS, WAYS, SPINS = 17, 13, 3
FADE = 0.35  # as tests.studies.veil.tables has it, which makes the table


class Nodes(NamedTuple):
    """scattered.txt: logarithms, times tau^2 exp((a/b + FADE) tau)."""

    share: Array  # (s,) b / (a + b)
    tau: Array  # (t,)
    off_deg: Array
    way_deg: Array
    spin_deg: Array
    volume: Array  # (s, t, off, way, spin)
    surface: Array  # (s, t, off)


class Scattering(NamedTuple):
    """One water, three colours, float32."""

    phase: Floats  # (SINES,) per steradian, of what does not go straight on
    scatter: Floats  # (3,) 1/m, of the same
    extinct: Floats  # (3,) 1/m, its attenuation
    volume: Floats  # (RANGES, OFFS, WAYS, SPINS, 3) r^2 times light of two and more orders, per m and W/sr
    surface: Floats  # (SURFACES, OFFS, 3) r^2 times scattered light on a surface that faces the lamp, per W/sr


def phase(angle_rad: Array) -> Array:
    """(n,) share of scattered light per steradian."""
    nu, k = (3 - SLOPE) / 2, 4 / (3 * (INDEX - 1) ** 2)
    sine2 = np.sin(angle_rad / 2) ** 2
    d = k * sine2
    d = np.where(np.abs(d - 1) < 1e-5, 1 + 1e-5, d)
    v = d**nu
    near = (nu * (1 - d) - (1 - v) + (d * (1 - v) - nu * (1 - d)) / sine2) / (4 * np.pi * (1 - d) ** 2 * v)
    v180 = k**nu
    return np.asarray(near + (1 - v180) / (16 * np.pi * (k - 1) * v180) * (3 * np.cos(angle_rad) ** 2 - 1))


@lru_cache(maxsize=1)
def deflected() -> float:
    """Share of scattering that goes more than STRAIGHT_RAD aside."""
    edge = np.linspace(STRAIGHT_RAD, np.pi, 20_001)
    middle = (edge[1:] + edge[:-1]) / 2
    return float((2 * np.pi * np.sin(middle) * phase(middle)).sum() * (edge[1] - edge[0]))


@lru_cache(maxsize=1)
def read_nodes() -> Nodes:
    lines = (resources.files("hw.twin.optics") / "scattered.txt").read_text("ascii").splitlines()
    rows = [line.split() for line in lines if line and not line.startswith("#")]
    axes = [np.array(row[1:], float) for row in rows[:5]]
    sizes = [len(axis) for axis in axes]
    numbers = np.array([number for row in rows[5:] for number in row], float)
    split = int(np.prod(sizes))
    share, tau, off_deg, way_deg, spin_deg = axes
    return Nodes(
        share, tau, off_deg, way_deg, spin_deg, numbers[:split].reshape(sizes), numbers[split:].reshape(sizes[:3])
    )


def scattering(
    absorption_per_m: tuple[float, ...], scattering_per_m: tuple[float, ...], orders: bool = True
) -> Scattering:
    """The tables of one water. orders=False: once scattered light alone, attenuated in full, for comparisons."""
    a, b = np.array(absorption_per_m, float), np.array(scattering_per_m, float)
    kept = deflected() if orders else 1.0
    angle = 2 * np.arcsin(np.linspace(0, 1, SINES))
    shape = phase(np.maximum(angle, STRAIGHT_RAD if orders else 1e-3)) / kept
    volume, surface = (
        _of_water(read_nodes(), a, b)
        if orders
        else (np.zeros((RANGES, OFFS, WAYS, SPINS, 3)), np.zeros((RANGES, OFFS, 3)))
    )
    return Scattering(*(np.ascontiguousarray(x, np.float32) for x in (shape, kept * b, a + kept * b, volume, surface)))


def _of_water(nodes: Nodes, a: Array, b: Array) -> tuple[Array, Array]:
    """Both tables over range in metres and sines of half angles, from those over scattering lengths and angles."""
    range_m = np.maximum(np.arange(RANGES), 1) * RANGE_STEP_M
    finely_m = np.maximum(np.arange(SURFACES), 1) * SURFACE_STEP_M
    off = np.degrees(2 * np.arcsin(np.linspace(0, 1, OFFS)))
    way = np.degrees(2 * np.arcsin(np.linspace(0, 1, WAYS)))
    volume, surface = np.empty((RANGES, OFFS, WAYS, SPINS, 3)), np.empty((SURFACES, OFFS, 3))
    for c in range(3):
        at_share = nodes.share, b[c] / (a[c] + b[c])
        decay = a[c] + FADE * b[c]
        of = _along(_along(nodes.surface, *at_share)[0], np.log(nodes.tau), np.log(b[c] * finely_m))
        surface[..., c] = np.exp(_along(of, nodes.off_deg, off, axis=1) - decay * finely_m[:, None])
        of = _along(_along(nodes.volume, *at_share)[0], np.log(nodes.tau), np.log(b[c] * range_m))
        of = _along(_along(of, nodes.off_deg, off, axis=1), nodes.way_deg, way, axis=2)
        # for b = 1 it is per scattering length and squared one; r^2 is taken out, a length is left
        volume[..., c] = np.exp(of - decay * range_m[:, None, None, None]) * b[c]
    return volume, surface


def _along(values: Array, nodes: Array, x: Array | float, axis: int = 0) -> Array:
    """Linear interpolation along one axis; the ends hold beyond them."""
    at = np.clip(np.atleast_1d(np.asarray(x, float)), nodes[0], nodes[-1])
    i = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    part = (at - nodes[i]) / (nodes[i + 1] - nodes[i])
    shape = [1] * values.ndim
    shape[axis] = len(at)
    part = part.reshape(shape)
    return np.asarray(np.take(values, i, axis) * (1 - part) + np.take(values, i + 1, axis) * part)


# --- beams: lamps that burn, and what stands in their light ---

INTENSITY_W_SR = 1.2  # on the axis, in each of three bands, at full power: some 1000 lm
HALF_RAD = math.radians(25.0)  # in water; even to 0.8 of it, nothing beyond 1.2
EDGE_RAD = 1.2 * HALF_RAD
COSINES = 2048


class Beams(NamedTuple):
    """All lamps in the terms of one camera, float32."""

    place: NDArray[np.float32]  # (n, 3) camera frame
    aim: NDArray[np.float32]  # (n, 3)
    power: NDArray[np.float32]  # (n,) W/sr on the axis
    first: NDArray[np.int64]  # (n + 1,) rows of `bodies` that may throw a shadow in lamp k's light: from first[k] on
    bodies: NDArray[np.int64]  # rows of `maps`
    origins: NDArray[np.float32]  # (rows of `bodies`, 3) the lamp, as that body's map has it
    maps: NDArray[np.float32]  # (e, 3, 4) camera to the unit sphere, or cube, of each body
    cubes: NDArray[np.int64]  # (e,)


def beam_table() -> NDArray[np.float32]:
    """(COSINES,) share of the intensity on the axis, by the cosine off it from cos(EDGE_RAD) to 1."""
    angle = np.arccos(np.linspace(math.cos(EDGE_RAD), 1.0, COSINES))
    t = np.clip((1.2 - angle / HALF_RAD) / 0.4, 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)


def make_beams(
    lamps: Sequence[LampBeam], camera: Array, bodies: Sequence[tuple[Array, float]], maps: Array, cubes: ArrayLike
) -> Beams:
    """`camera` (3, 4) to world; `bodies`: centre (3,), world, and radius around it of each row of `maps` (e, 3, 4)."""
    rotation, eye_m = camera[:, :3], camera[:, 3]
    first, found, origins = [0], list[int](), list[Array]()
    for lamp in lamps:
        place_m, aim = np.asarray(lamp.position_m, float), np.asarray(lamp.aim, float)
        local = rotation.T @ (place_m - eye_m)
        for e, (centre_m, radius_m) in enumerate(bodies):
            to_body = centre_m - place_m
            range_m = float(np.linalg.norm(to_body))
            unit = maps[e, :, :3] @ local + maps[e, :, 3]
            if np.abs(unit).max() < 1 if np.asarray(cubes)[e] else unit @ unit < 1:
                continue  # its own housing, or hull
            off = math.acos(min(max(float(to_body @ aim) / max(range_m, 1e-9), -1.0), 1.0))
            if range_m <= radius_m or off <= EDGE_RAD + math.asin(min(radius_m / range_m, 1.0)):
                found.append(e)
                origins.append(unit)
        first.append(len(found))
    places = np.array([rotation.T @ (np.asarray(lamp.position_m, float) - eye_m) for lamp in lamps])
    aims = np.array([rotation.T @ np.asarray(lamp.aim, float) for lamp in lamps])
    return Beams(
        place=places.astype(np.float32).reshape(-1, 3),
        aim=aims.astype(np.float32).reshape(-1, 3),
        power=np.array([INTENSITY_W_SR * lamp.power for lamp in lamps], np.float32),
        first=np.array(first),
        bodies=np.array(found, np.int64),
        origins=np.array(origins, np.float32).reshape(-1, 3),
        maps=np.asarray(maps, np.float32),
        cubes=np.asarray(cubes, np.int64),
    )


# --- veil: light added up along the rays of a grid ---

PER_M = np.float32(512)  # steps a metre of transmission
CELLS, SUB = 24, 3  # along a ray, and steps in each
HALF = np.float32(0.5)
LEAST_M = np.float32(0.015)  # the lamp's radius: no water is nearer to its middle
PER_COSINE = np.float32((COSINES - 1) / (1 - math.cos(EDGE_RAD)))
EDGE_COS = np.float32(math.cos(EDGE_RAD))
PER_RANGE = np.float32(1 / RANGE_STEP_M)
TINY = np.float32(1e-6)
INV_SUB = np.float32(1 / SUB)


class Grid(NamedTuple):
    """Where the rays are: node (i, j) is pixel (x0 + i step, y0 + j step); cells end at k far_m / CELLS."""

    x0: int
    y0: int
    step: int
    columns: int
    rows: int
    far_m: float  # z-depth


def grid_for(part: tuple[int, int, int, int], full_width: int, far_m: float) -> Grid:
    """Around a part (x, y, width, height) of a frame, on the nodes of the whole frame: 41 across."""
    step = max(full_width // 40, 4)
    x, y, width, height = part
    x0, y0 = x // step, y // step
    return Grid(x0 * step, y0 * step, step, -(-(x + width) // step) - x0 + 1, -(-(y + height) // step) - y0 + 1, far_m)


@inlined
def in_shadow(beams: Beams, lamp: int, wx: F, wy: F, wz: F, itself: int) -> bool:
    """Whether a body other than `itself` is between a lamp and the point so far from it, camera frame."""
    for n in range(beams.first[lamp], beams.first[lamp + 1]):
        e = beams.bodies[n]
        if e == itself:
            continue
        m = beams.maps
        qx, qy, qz = beams.origins[n, 0], beams.origins[n, 1], beams.origins[n, 2]
        dx = m[e, 0, 0] * wx + m[e, 0, 1] * wy + m[e, 0, 2] * wz
        dy = m[e, 1, 0] * wx + m[e, 1, 1] * wy + m[e, 1, 2] * wz
        dz = m[e, 2, 0] * wx + m[e, 2, 1] * wy + m[e, 2, 2] * wz
        if beams.cubes[e]:
            low, high = ZERO, ONE
            for q, d in ((qx, dx), (qy, dy), (qz, dz)):
                d = d if abs(d) > TINY else TINY
                first, second = (-ONE - q) / d, (ONE - q) / d
                low, high = max(low, min(first, second)), min(high, max(first, second))
            if low < high:
                return True
        else:
            dd = dx * dx + dy * dy + dz * dz
            dq = dx * qx + dy * qy + dz * qz
            if dq < ZERO and -dq < dd and dq * dq > dd * (qx * qx + qy * qy + qz * qz - ONE):
                return True
    return False


@inlined
def beam_at(cosine: F, table: Floats) -> F:
    """Share of the intensity on the axis."""
    if cosine <= EDGE_COS:
        return ZERO
    x = min((cosine - EDGE_COS) * PER_COSINE, np.float32(COSINES - 1.001))
    i = int(x)
    return table[i] + (x - np.float32(i)) * (table[i + 1] - table[i])


@inlined
def phase_at(cosine: F, table: Floats) -> F:
    x = math.sqrt(max(HALF - HALF * cosine, ZERO)) * np.float32(SINES - 1)
    i = min(int(x), SINES - 2)
    return table[i] + (x - np.float32(i)) * (table[i + 1] - table[i])


@inlined
def place_in(x: F, nodes: int) -> tuple[int, F]:
    """Node below x, in nodes, and what is beyond it."""
    x = min(max(x, ZERO), np.float32(nodes) - np.float32(1.001))
    i = int(x)
    return i, x - np.float32(i)


@kernel
def fill_veil(
    optics: Optics,
    beams: Beams,
    water: Scattering,
    beam: Floats,
    straight: Floats,
    grid: Grid,
    veil: NDArray[np.float32],
) -> None:
    """Fill veil (rows, columns, CELLS + 1, 3), radiance from the camera to the end of each cell. straight: (n, 3)
    transmission per 1/PER_M m."""
    du = np.float32(grid.far_m) / np.float32(CELLS)
    lamps = beams.power.shape[0]
    last = straight.shape[0] - 1
    for row in range(grid.rows):
        for col in range(grid.columns):
            mx, my, a, b = ray(optics, grid.x0 + col * grid.step, grid.y0 + row * grid.step)
            length = math.sqrt(ONE + mx * mx + my * my)
            dx, dy, dz = mx / length, my / length, ONE / length
            v0 = v1 = v2 = ZERO
            for c in range(3):
                veil[row, col, 0, c] = ZERO
            for cell in range(CELLS):
                j0 = j1 = j2 = ZERO
                for lamp in range(lamps):
                    lx, ly, lz = beams.place[lamp, 0], beams.place[lamp, 1], beams.place[lamp, 2]
                    ax, ay, az = beams.aim[lamp, 0], beams.aim[lamp, 1], beams.aim[lamp, 2]
                    power = beams.power[lamp]
                    for sub in range(SUB):
                        u = (np.float32(cell) + (np.float32(sub) + HALF) * INV_SUB) * du
                        px, py, pz = a + u * mx, b + u * my, u
                        wx, wy, wz = px - lx, py - ly, pz - lz
                        r2 = wx * wx + wy * wy + wz * wz
                        r = math.sqrt(r2)
                        if r < LEAST_M:
                            continue
                        inverse = ONE / r
                        cosine = (wx * ax + wy * ay + wz * az) * inverse
                        way = -(wx * dx + wy * dy + wz * dz) * inverse
                        shining = beam_at(cosine, beam)
                        if shining > ZERO and not in_shadow(beams, lamp, wx, wy, wz, -1):
                            once = power * shining * phase_at(way, water.phase) * inverse * inverse * INV_SUB
                            n = min(int((r + u * length) * PER_M), last)
                            j0 += once * water.scatter[0] * straight[n, 0]
                            j1 += once * water.scatter[1] * straight[n, 1]
                            j2 += once * water.scatter[2] * straight[n, 2]
                        if sub == SUB // 2:
                            m0, m1, m2 = _more_orders(cosine, way, -(dx * ax + dy * ay + dz * az), r, water.volume)
                            more = power * inverse * inverse
                            n = min(int(u * length * PER_M), last)
                            j0 += more * m0 * straight[n, 0]
                            j1 += more * m1 * straight[n, 1]
                            j2 += more * m2 * straight[n, 2]
                v0 += j0 * du * length
                v1 += j1 * du * length
                v2 += j2 * du * length
                veil[row, col, cell + 1, 0] = v0
                veil[row, col, cell + 1, 1] = v1
                veil[row, col, cell + 1, 2] = v2


@inlined
def _more_orders(cosine: F, way: F, against: F, r: F, volume: Floats) -> tuple[F, F, F]:
    """r^2 times light of two and more orders at r from a lamp, `cosine` off its axis, that goes `way` (cosine) off the
    ray from it. against: cosine between that way and the lamp's axis."""
    sine = math.sqrt(max(ONE - cosine * cosine, TINY) * max(ONE - way * way, TINY))
    spin = min(max((cosine * way - against) / sine, -ONE), ONE)  # 1: away from the axis
    i, fi = place_in(r * PER_RANGE, RANGES)
    j, fj = place_in(math.sqrt(max(HALF - HALF * cosine, ZERO)) * np.float32(OFFS - 1), OFFS)
    k, fk = place_in(math.sqrt(max(HALF - HALF * way, ZERO)) * np.float32(WAYS - 1), WAYS)
    m, fm = place_in(ONE - spin, SPINS)
    t0 = t1 = t2 = ZERO
    for corner in range(16):
        up_i, up_j, up_k, up_m = corner & 1, corner >> 1 & 1, corner >> 2 & 1, corner >> 3
        weight = fi if up_i else ONE - fi
        weight *= fj if up_j else ONE - fj
        weight *= fk if up_k else ONE - fk
        weight *= fm if up_m else ONE - fm
        t0 += weight * volume[i + up_i, j + up_j, k + up_k, m + up_m, 0]
        t1 += weight * volume[i + up_i, j + up_j, k + up_k, m + up_m, 1]
        t2 += weight * volume[i + up_i, j + up_j, k + up_k, m + up_m, 2]
    return t0, t1, t2
