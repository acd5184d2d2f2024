"""Depths of all views -> one surface: a truncated signed distance, weighted by how sure each view is.

For a cell at depth z in a view whose pixel there has the depth d (Curless and Levoy 1996, with sigma for the band):

    e = d - z,  tr = max(TRUNCATION_M, 3 sigma) ;  w = 1e-4 / (sigma^2 + 1e-6)
    e < -tr: hidden, nothing ;  e > tr: free space, e = tr and w x FREE

and the distance is the mean of e by w, made robust: a view that contradicts the mean by more than its own sigma counts
for less, w / (1 + (r / (ROBUST sigma))^2), twice over. Bricks are worked on one after the other, each with all views,
so that nothing depends on the order of bricks.

`build` makes the surface of a scene: from focus alone, then with the plane sweep where it finds anything.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.process.command import Progress, Show
from agent.reconstruction.bricks import SIDE, Surface, allocated, cones, kernel, touches
from agent.reconstruction.mesh import Mesh, coloured, mesh_of, pieces_of, rendered
from agent.reconstruction.plane_sweep import Swept, neighbours, plane_sweep
from agent.reconstruction.views import Floats, Stack, View, camera_in, inlined, pixel_of, stacked

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


# --- views -> surface: focus alone, then the plane sweep, fused with focus where the sweep is silent ---

CELL_M = 5e-3
PRIOR_M, PRIOR_PER_M = 4e-3, 4e-3  # sigma of a surface's depth as a prior: PRIOR_M + PRIOR_PER_M z^2
SWEEP_SHARE, FUSE_SHARE = 80, 10  # of the bar


class Built(NamedTuple):
    views: list[View]  # with the depths that the surface is made of
    mesh: Mesh
    swept: float  # share of the known depths that the plane sweep found


def build(views: Sequence[View], cell_m: float, stereo: bool, show: Show) -> Built:
    """The surface of a scene. Raises Failed where nothing has a depth."""
    given = list(views)
    share = 0.0
    if stereo:
        given, share = sharpened(given, cell_m, _part(show, 0, SWEEP_SHARE, "comparing pictures"))
    mesh = mesh_of(fuse(stacked(given, 0), cell_m, _part(show, SWEEP_SHARE, FUSE_SHARE, "fusing depths")))
    show(SWEEP_SHARE + FUSE_SHARE, 100, "triangles and colours")
    mesh = coloured(mesh, stacked(given))  # pictures come when the grid is gone: both do not have to fit the memory
    show(100, 100, "surface")
    return Built(given, mesh, share)


def sharpened(
    views: Sequence[View], cell_m: float, progress: Progress = lambda done, total: None
) -> tuple[list[View], float]:
    """The same views with their best depths: by the plane sweep where it found any, else by focus; and the share of
    the sweep's."""
    stack = stacked(views, 1)
    found = swept_twice(views, stack, cell_m, progress)
    both = merged(stack, found)
    better = [
        replace(view, depth_m=_cut(both.depth_m[n], view), sigma_m=_cut(both.sigma_m[n], view))
        for n, view in enumerate(views)
    ]
    return better, float(np.isfinite(found.depth_m).sum()) / max(float(np.isfinite(both.depth_m).sum()), 1.0)


def swept_twice(
    views: Sequence[View], stack: Stack, cell_m: float, progress: Progress = lambda done, total: None
) -> Swept:
    """The plane sweep about what focus says, then, where it found nothing, about the surface that came of both.

    Focus is silent or wrong beside edges in depth; the surface knows there what other views saw.
    """
    count = len(views)
    near_by = neighbours(stack)
    first = plane_sweep(stack, near_by, lambda done, total: progress(done, 2 * count))
    prior = _expected(views, mesh_of(fuse(merged(stack, first), cell_m)), stack)
    prior[np.isfinite(first.depth_m)] = np.nan
    again = stack._replace(depth_m=prior, sigma_m=PRIOR_M + PRIOR_PER_M * prior * prior)
    return plane_sweep(again, near_by, lambda done, total: progress(count + done, 2 * count), before=first.depth_m)


def _expected(views: Sequence[View], mesh: Mesh, stack: Stack) -> NDArray[np.float32]:
    """Depths (n, height, width) at which each view would see a surface; NaN where there is none."""
    found, pieces = np.full_like(stack.depth_m, np.nan), pieces_of(mesh)
    for n, view in enumerate(views):
        seen = rendered(mesh, mesh.colours, view.camera, view.rotation, view.position_m, pieces)
        found[n, : view.camera.height, : view.camera.width] = seen.depth_m
    return found


def merged(stack: Stack, found: Swept) -> Stack:
    """The depths of the plane sweep, and those of focus where it has none."""
    known = np.isfinite(found.depth_m)
    return stack._replace(
        depth_m=np.where(known, found.depth_m, stack.depth_m), sigma_m=np.where(known, found.sigma_m, stack.sigma_m)
    )


def _cut(values: np.ndarray, view: View) -> np.ndarray:
    return values[: view.camera.height, : view.camera.width]


def _part(show: Show, first: int, share: int, what: str) -> Progress:
    """A progress that is so many per cent of the whole, from `first` on."""
    return lambda done, total: show(first + share * done // max(total, 1), 100, what)
