"""Depths of all views -> one surface: a truncated signed distance, weighted by how sure each view is.

For a cell at depth z in a view whose pixel there has the depth d (Curless and Levoy 1996, with sigma for the band):

    e = d - z,  tr = max(TRUNCATION_M, 3 sigma) ;  w = 1e-4 / (sigma^2 + 1e-6)
    e < -tr: hidden, nothing ;  e > tr: free space, e = tr and w x FREE

and the distance is the mean of e by w, made robust: a view that contradicts the mean by more than its own sigma counts
for less, w / (1 + (r / (ROBUST sigma))^2), twice over. Bricks are worked on one after the other, each with all views,
so that nothing depends on the order of bricks.

`build` makes the surface of a scene: from focus alone, then with the plane sweep where it finds anything, then with
what is concluded where nothing is seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from agent.process.command import Failed, Progress, Show
from agent.reconstruction.bricks import SIDE, Surface, allocated, cones, kernel, touches
from agent.reconstruction.mesh import LEAST_WEIGHT, Mesh, coloured, joined, mesh_of, pieces_of, rendered
from agent.reconstruction.plane_sweep import Swept, neighbours, plane_sweep
from agent.reconstruction.views import (
    Floats,
    Stack,
    View,
    camera_in,
    inlined,
    pixel_of,
    see,
    stacked,
    to_world,
    unproject,
)

TRUNCATION_M = 12e-3  # at cells of 5 mm: two cells and a half to both sides
FREE = 0.3  # of the weight: that something is not there is known less sharply than where it is
ROBUST = 2.0  # sigmas of a contradiction that halves a view's weight
ROUNDS = 2  # of reweighing
MOST_VIEWS = 128  # that one cell listens to; the first ones
MOST_STEP = 0.03  # of 1/z between neighbouring pixels, relative: beyond it there is an edge, which is not interpolated
BATCH = 512  # bricks between two looks at the progress


def fuse(
    stack: Stack, cell_m: float, progress: Progress = lambda done, total: None, like: Surface | None = None
) -> Surface:
    """The surface that all depths of the stack show, in the places of another if one is given.

    Raises Failed where there is none, or too much.
    """
    truncation = max(TRUNCATION_M, 2.4 * cell_m)
    surface = allocated(stack, cell_m, truncation, like)
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


# --- what nobody saw: concluded from what lies around it ---
#
# Where a picture is plain, neither focus nor a plane sweep finds a depth. There 1/z bends as little as what is known
# around it allows, from each view: the least of
#
# sum of w (second differences of q)^2  +  PULL sum over known pixels of r (q - q_known)^2
#
# with q = 1/z, w = exp(-|tone_i - tone_j| / EDGE) between neighbours, so that depth breaks where the picture does (as
# colours in Levin et al. 2004), and r that falls where the rest contradicts a known depth, as beside edges. A plane's q
# is linear, so a plane stays one. LEVEL w (first differences)^2 keeps q from running away where one side is open.
# How unsure that is grows with the way to what is known, as a random walk's time there does, from how steep known
# surfaces are. What is concluded counts only if it is known to MOST_UNSURE of z, and if a neighbour concludes
# or sees the same within sigma; where views look through it, it loses, for their weights are larger.

EDGE = 0.03  # of tones 0 to 1
BARRIER = 1e-3  # w at least
LEVEL = 1e-4
PULL, LEAST_PULL = 0.3, 1e-9
OFF = 0.02  # of q, relative: a contradiction that takes three quarters of a known depth's r away
TIMES_SOLVED = 2
ACROSS_PX = 80  # a plain region needs no more: pictures are about so wide here
LEAST_KNOWN = 0.25  # of the pixels that make one here
STEEP = 1.5  # times the median step of q from pixel to pixel
MOST_UNSURE = 0.2
AGREE = 0.015  # of z, where sigma is less
LARGEST_SIGMA_M = 20e-3  # in the grid: with more, one view is no surface


class Concluded(NamedTuple):
    """Of all views; NaN where something was seen, or nothing can be said."""

    depth_m: NDArray[np.float32]  # (n, height, width)
    sigma_m: NDArray[np.float32]

    def into(self, stack: Stack, largest_m: float = math.inf) -> Stack:
        """The depths of a stack with these beside them; largest_m: of sigma."""
        here = np.isfinite(self.depth_m)
        return stack._replace(
            depth_m=np.where(here, self.depth_m, stack.depth_m),
            sigma_m=np.where(here, np.minimum(self.sigma_m, np.float32(largest_m)), stack.sigma_m),
        )


def conclude(views: Sequence[View], expected: NDArray[np.float32]) -> Concluded:
    """What lies between known depths; expected (n, height, width): of the surface that all views together saw."""
    stack = stacked(views, 0)
    seen = np.where(np.isfinite(expected), expected, stack.depth_m)
    both, sigma = seen.copy(), np.full_like(seen, np.nan)
    for n, view in enumerate(views):
        inside = np.s_[n, : view.camera.height, : view.camera.width]
        if np.isfinite(seen[inside]).any():
            smooth, unsure = _smooth(view.picture, seen[inside])
            good = np.isnan(seen[inside]) & (unsure < MOST_UNSURE * smooth)
            both[inside] = np.where(good, smooth, seen[inside])
            sigma[inside] = np.where(good, unsure, np.nan)
    near_by = neighbours(stack._replace(depth_m=both))
    alone = [_alone(views, both, sigma, n, near_by.of[n]) for n in range(len(views))]
    for n, (rows, cols) in enumerate(alone):
        sigma[n, rows, cols] = np.nan
    return Concluded(np.where(np.isnan(sigma), np.nan, both), sigma)


Pixels = tuple[NDArray[np.int64], NDArray[np.int64]]


def _alone(
    views: Sequence[View], depth_m: NDArray[np.float32], sigma_m: NDArray[np.float32], n: int, others: NDArray[np.int64]
) -> Pixels:
    """Rows and columns of the pixels of view n with a sigma, at whose place no other view has a depth within it."""
    view = views[n]
    rows, cols = np.nonzero(np.isfinite(sigma_m[n]))
    depth, sigma = depth_m[n, rows, cols].astype(float), sigma_m[n, rows, cols]
    places = to_world(view, unproject(view.camera, np.stack([cols, rows], axis=1).astype(float), depth))
    alone = np.ones(len(rows), np.bool_)
    for other in others[others >= 0].tolist():
        at, there, z = _looked_up(views[other], depth_m[other], places)
        alone[at[np.abs(there - z) < np.maximum(AGREE * z, sigma[at])]] = False
    return rows[alone], cols[alone]


def _looked_up(view: View, values: NDArray[np.float32], places_m: Floats) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Which places (n, 3) are in the picture, what a map has there, and their depths."""
    pixels, z = see(view, places_m)
    with np.errstate(invalid="ignore"):
        inside = ((pixels > -0.5) & (pixels < np.array([view.camera.width, view.camera.height]) - 0.5)).all(axis=1)
    at = np.flatnonzero(inside)
    cols, rows = np.rint(pixels[at]).astype(np.int64).T
    return at, values[rows, cols].astype(float), z[at]


def _smooth(picture: NDArray[np.float32], depth_m: NDArray[np.float32]) -> tuple[Floats, Floats]:
    """Depth and its sigma (height, width) of all pixels of one view."""
    height, width = depth_m.shape
    times = max(1, round(width / ACROSS_PX))
    size = max(1, width // times), max(1, height // times)
    inverse, known = np.nan_to_num(1.0 / depth_m), np.isfinite(depth_m).astype(np.float32)
    share = cv2.resize(known, size, interpolation=cv2.INTER_AREA).astype(float)
    q = cv2.resize(inverse, size, interpolation=cv2.INTER_AREA) / np.maximum(share, 1e-9)
    tones = np.clip(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), 0.0, 1.0) ** (1.0 / 2.2)
    q, steps = _least(tones, np.where(share > LEAST_KNOWN, q, np.nan))
    across, down = (np.abs(np.diff(1.0 / depth_m, axis=axis)) for axis in (0, 1))
    both = np.concatenate([across[np.isfinite(across)], down[np.isfinite(down)]])
    steep = STEEP * times * float(np.median(both)) if both.size else np.inf
    large = [cv2.resize(one, (width, height), interpolation=cv2.INTER_LINEAR) for one in (q, steps)]
    depth = 1.0 / np.maximum(large[0], 1e-6)
    return depth, depth * depth * steep * np.sqrt(np.maximum(large[1], 0.0))


def _least(tones: NDArray[np.floating], q: Floats) -> tuple[Floats, Floats]:
    """The smooth q (height, width) of one that has NaN, and how many steps it is to what is known, squared."""
    steps = [_steps(length) for length in q.shape]
    down, right = (
        scipy.sparse.kron(*pair, format="csr")
        for pair in ((steps[0], _same(q.shape[1])), (_same(q.shape[0]), steps[1]))
    )
    like_down, like_right = (
        np.exp(-np.abs(np.diff(tones, axis=axis)).max(axis=-1) / EDGE) + BARRIER for axis in (0, 1)
    )
    first = scipy.sparse.vstack([_scaled(like_down, down), _scaled(like_right, right)], format="csc")
    bends = [
        _scaled(np.minimum(like_down[1:], like_down[:-1]), _bend(q.shape[0], q.shape[1], 0)),
        _scaled(np.minimum(like_right[:, 1:], like_right[:, :-1]), _bend(q.shape[0], q.shape[1], 1)),
        _scaled(
            2.0
            * np.minimum(np.minimum(like_down[:, 1:], like_down[:, :-1]), np.minimum(like_right[1:], like_right[:-1])),
            scipy.sparse.kron(*steps, format="csr"),
        ),
    ]
    second = scipy.sparse.vstack(bends, format="csc")
    level = (first.T @ first).tocsc()
    smooth = (second.T @ second + LEVEL * level).tocsc()
    pull, target = PULL * np.isfinite(q).ravel(), np.nan_to_num(q).ravel()
    trust = np.ones(q.size)
    for _ in range(TIMES_SOLVED):
        here = scipy.sparse.diags(pull * trust + LEAST_PULL, format="csc")
        found = _solved(smooth + here, pull * trust * target)
        trust = 1.0 / (1.0 + ((found - target) / (OFF * np.maximum(target, 1e-9))) ** 2) ** 2
    walk = _solved(level + here, np.ones(q.size))
    return found.reshape(q.shape), walk.reshape(q.shape)


def _solved(matrix: scipy.sparse.spmatrix, right: Floats) -> Floats:
    """Of a symmetric positive matrix, whose order of elimination is half of the work."""
    solver = scipy.sparse.linalg.splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return np.asarray(solver.solve(right))


def _same(count: int) -> scipy.sparse.spmatrix:
    return scipy.sparse.identity(count, format="csr")


def _steps(count: int) -> scipy.sparse.spmatrix:
    """(count - 1, count): from each of a row to the next."""
    return scipy.sparse.diags([-np.ones(count - 1), np.ones(count - 1)], [0, 1], (count - 1, count), format="csr")


def _bend(height: int, width: int, axis: int) -> scipy.sparse.spmatrix:
    """Second differences along an axis of pixels (height, width), a row each."""
    count = (height, width)[axis]
    twice = _steps(count - 1) @ _steps(count)
    return scipy.sparse.kron(*((twice, _same(width)) if axis == 0 else (_same(height), twice)), format="csr")


def _scaled(weights: Floats, rows: scipy.sparse.spmatrix) -> scipy.sparse.spmatrix:
    """Rows whose squares count by these weights."""
    return scipy.sparse.diags(np.sqrt(weights.ravel()), format="csr") @ rows


def with_concluded(views: Sequence[View], seen: Surface, found: Concluded) -> Mesh:
    """The surface with what was concluded beside it, whose vertices have no views; sigma is that of the surest view."""
    try:
        both = fuse(found.into(stacked(views, 0), LARGEST_SIGMA_M), seen.cell_m, like=seen)
    except Failed:  # too much for the memory, though what was seen alone is not
        return mesh_of(seen)
    there = seen.table >= 0
    known = seen.weight[seen.table[there]] >= LEAST_WEIGHT
    for name in ("distance_m", "weight"):
        its = getattr(both, name)[both.table[there]]
        its[known] = getattr(seen, name)[seen.table[there]][known]
        getattr(both, name)[both.table[there]] = its
    mesh = joined(seen, both)
    nobody = np.flatnonzero(mesh.views == 0)
    mesh.sigma_m[nobody] = _surest(views, found, mesh.vertices_m[nobody])
    return mesh


def _surest(views: Sequence[View], found: Concluded, places_m: Floats) -> NDArray[np.float32]:
    """The least sigma (n,) of the views that conclude these places (n, 3); LARGEST_SIGMA_M where none does."""
    least = np.full(len(places_m), np.inf, np.float32)
    for n, view in enumerate(views):
        at, depth, z = _looked_up(view, found.depth_m[n], places_m)
        sigma = _looked_up(view, found.sigma_m[n], places_m)[1].astype(np.float32)
        same = np.abs(depth - z) < np.maximum(sigma, TRUNCATION_M)
        least[at[same]] = np.minimum(least[at[same]], sigma[same])
    return np.where(np.isfinite(least), least, np.float32(LARGEST_SIGMA_M))


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
    mesh = surface_of(given, cell_m, _part(show, SWEEP_SHARE, FUSE_SHARE, "fusing depths"))
    show(100, 100, "surface")
    return Built(given, mesh, share)


def surface_of(views: Sequence[View], cell_m: float, progress: Progress = lambda done, total: None) -> Mesh:
    """Surface and colours of views that have their best depths; with what is concluded, in vertices without views."""
    seen = fuse(stacked(views, 0), cell_m, progress)
    found = conclude(views, _expected(views, mesh_of(seen), stacked(views, 0)))
    mesh = with_concluded(views, seen, found)
    del seen  # pictures come when the grid is gone: both do not have to fit the memory
    return coloured(mesh, found.into(stacked(views)))


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
