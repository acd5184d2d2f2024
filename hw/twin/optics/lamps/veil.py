"""The veil of all lamps in cells of the camera's view: froxels, after Wronski, Volumetric Fog, SIGGRAPH 2014.

Along the rays of a coarse grid of pixels, light is added up from the camera on; a pixel takes the veil in front of its
own surface from the eight corners around it. Light scattered once is cast into shadow by hulls and solids; that of more
orders comes from everywhere, and is taken as in open water.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.optics.lamps.beam import COSINES, EDGE_RAD, Beams
from hw.twin.optics.lamps.scattered import OFFS, RANGE_STEP_M, RANGES, SINES, SPINS, WAYS, Floats, Scattering
from hw.twin.optics.raycast import ONE, ZERO, F, Optics, inlined, kernel, ray

PER_M = np.float32(512)  # steps a metre of transmission
CELLS, SUB = 24, 3  # along a ray, and steps in each
HALF, TWO, QUARTER = np.float32(0.5), np.float32(2), np.float32(0.25)
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
