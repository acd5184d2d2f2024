"""Depths of all views -> one surface: a truncated signed distance, weighted by how sure each view is.

For a cell at depth z in a view whose pixel there has the depth d (Curless and Levoy 1996, with sigma for the band):

    e = d - z,  tr = max(TRUNCATION_M, 3 sigma) ;  w = 1e-4 / (sigma^2 + 1e-6)
    e < -tr: hidden, nothing ;  e > tr: free space, e = tr and w x FREE

and the distance is the mean of e by w, made robust: a view that contradicts the mean by more than its own sigma counts
for less, w / (1 + (r / (ROBUST sigma))^2), twice over. Bricks are worked on one after the other, each with all views,
so that nothing depends on the order of bricks.
"""

from __future__ import annotations

import math

import numpy as np

from agent.process.command import Progress
from agent.reconstruction.bricks import SIDE, Surface, allocated, kernel
from agent.reconstruction.camera import Floats, inlined, pixel_of
from agent.reconstruction.reach import cones, touches
from agent.reconstruction.stack import Stack, camera_in

TRUNCATION_M = 12e-3  # at cells of 5 mm: two cells and a half to both sides
FREE = 0.3  # of the weight: that something is not there is known less sharply than where it is
ROBUST = 2.0  # sigmas of a contradiction that halves a view's weight
ROUNDS = 2  # of reweighing
MOST_VIEWS = 128  # that one cell listens to; the first ones
MOST_STEP = 0.03  # of 1/z between neighbouring pixels, relative: beyond it there is an edge, which is not interpolated
BATCH = 512  # bricks between two looks at the progress


def fuse(stack: Stack, cell_m: float, progress: Progress = lambda done, total: None) -> Surface:
    """The surface that all depths of the stack show. Raises Failed where there is none, or too much."""
    truncation = max(TRUNCATION_M, 2.4 * cell_m)
    surface = allocated(stack, cell_m, truncation)
    places, reach = np.argwhere(surface.table >= 0), cones(stack, truncation)
    for first in range(0, len(places), BATCH):
        progress(first, len(places))
        _fuse(stack, reach, surface, places[first : first + BATCH], truncation)
    progress(len(places), len(places))
    return surface


@inlined
def depth_at(depth: np.ndarray, n: int, u: float, v: float, width: int, height: int) -> float:
    """Depth between pixels, by 1/z where the four agree, else of the nearest; NaN: unknown."""
    col, row = int(u + 0.5), int(v + 0.5)
    nearest = float(depth[n, row, col])
    i, j = math.floor(v), math.floor(u)
    if i < 0 or j < 0 or i + 1 >= height or j + 1 >= width:
        return nearest
    a, b = 1.0 / float(depth[n, i, j]), 1.0 / float(depth[n, i, j + 1])
    c, d = 1.0 / float(depth[n, i + 1, j]), 1.0 / float(depth[n, i + 1, j + 1])
    low, high = min(min(a, b), min(c, d)), max(max(a, b), max(c, d))
    if not (high - low) <= MOST_STEP * high:  # NaN: one is unknown
        return nearest
    across, down = u - j, v - i
    return 1.0 / ((1 - down) * ((1 - across) * a + across * b) + down * ((1 - across) * c + across * d))


@kernel
def _fuse(stack: Stack, reach: Floats, surface: Surface, places: np.ndarray, truncation_m: float) -> None:
    count, cell = stack.depth_m.shape[0], surface.cell_m
    half = 0.5 * (SIDE - 1) * cell
    radius = math.sqrt(3.0) * half
    near = np.empty(count, np.int64)
    e, w, s = np.empty(MOST_VIEWS), np.empty(MOST_VIEWS), np.empty(MOST_VIEWS)
    for brick in range(len(places)):
        i, j, k = places[brick]
        b = surface.table[i, j, k]
        x0 = surface.origin_m[0] + i * SIDE * cell
        y0 = surface.origin_m[1] + j * SIDE * cell
        z0 = surface.origin_m[2] + k * SIDE * cell
        seen = _near_views(stack, reach, x0 + half, y0 + half, z0 + half, radius, near)
        for ci in range(SIDE):
            for cj in range(SIDE):
                for ck in range(SIDE):
                    x, y, z = x0 + ci * cell, y0 + cj * cell, z0 + ck * cell
                    found, close = 0, 0
                    for m in range(seen):
                        if found == MOST_VIEWS:
                            break
                        n = near[m]
                        camera = camera_in(stack, n)
                        r, t = stack.rotations[n], stack.positions_m[n]
                        dx, dy, dz = x - t[0], y - t[1], z - t[2]
                        px = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
                        py = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
                        pz = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
                        u, v, before = pixel_of(camera, px, py, pz)
                        if not (before and -0.5 < u < camera.width - 0.5 and -0.5 < v < camera.height - 0.5):
                            continue
                        depth = depth_at(stack.depth_m, n, u, v, camera.width, camera.height)
                        row, col = int(v + 0.5), int(u + 0.5)
                        sigma = float(stack.sigma_m[n, row, col])
                        error = depth - pz
                        band = max(truncation_m, 3.0 * sigma)
                        if not error >= -band:  # hidden, or unknown
                            continue
                        e[found] = min(error, band)
                        s[found] = np.inf if error > band else sigma  # free space is a bound: no mean contradicts it
                        w[found] = 1e-4 / (sigma * sigma + 1e-6) * (FREE if error > band else 1.0)
                        if error <= band:
                            close += 1
                        found += 1
                    if found == 0 or close == 0:
                        continue
                    _settle(surface, b, ci, cj, ck, e, w, s, found, close)


@inlined
def _settle(
    surface: Surface, b: int, ci: int, cj: int, ck: int,
    e: np.ndarray, w: np.ndarray, s: np.ndarray, found: int, close: int,
) -> None:  # fmt: skip
    """One cell's distance and weight from what its views say."""
    mean = 0.0
    for round_ in range(ROUNDS + 1):
        total, moment = 0.0, 0.0
        for m in range(found):
            share = w[m]
            if round_ > 0:
                off = (e[m] - mean) / (ROBUST * s[m])
                share = share / (1.0 + off * off)
            total += share
            moment += share * e[m]
        mean = moment / total
    surface.distance_m[b, ci, cj, ck] = mean
    surface.weight[b, ci, cj, ck] = total
    surface.views[b, ci, cj, ck] = min(close, 255)


@inlined
def _near_views(stack: Stack, reach: Floats, x: float, y: float, z: float, radius: float, near: np.ndarray) -> int:
    """Indices of the views whose picture a ball may touch, into `near`; how many."""
    seen = 0
    for n in range(stack.depth_m.shape[0]):
        if not touches(reach, n, x, y, z, radius):
            continue
        r, t, c, size = stack.rotations[n], stack.positions_m[n], stack.cameras[n], stack.sizes[n]
        dx, dy, dz = x - t[0], y - t[1], z - t[2]
        px = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
        py = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
        pz = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
        if pz - c[4] < -radius:
            continue
        depth = max(pz - c[4], radius)
        rim = 1.5 * c[0] * radius / depth
        scale = c[0] / depth * (1.0 + c[3] * (px * px + py * py) / (depth * depth))
        u, v = c[1] + scale * px, c[2] + scale * py
        if -rim < u < size[0] + rim and -rim < v < size[1] + rim:
            near[seen] = n
            seen += 1
    return seen
