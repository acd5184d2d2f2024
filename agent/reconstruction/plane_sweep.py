"""Depths by comparing pictures, searched for only where focus says that the surface is: a plane sweep with a prior.

Each pixel with a focus depth z and its sigma has HYPOTHESES depths, equal steps of 1/z over z +- (3.5 sigma + 10 mm),
and more where a neighbour's picture would shift by more than STEP_PX from one to the next: what lies between would be
missed. A window of 5 x 5 pixels at one of them is a small plane, tilted as the focus map is around the pixel; each
neighbouring view sees it through its whole camera (the bend is not small), by an affine map that is exact at three
corners. Cost: the mean of the two best normalised cross correlations (ZNCC) over neighbours; a parabola over the best
hypothesis; a best one at either end is refused, for then the prior excludes the truth. What remains must be above LEAST
and agree with what a neighbour found.

Without the prior 43 % of what is accepted is wrong: on tiles and gravel much looks alike.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.process.command import Progress
from agent.reconstruction.bricks import ball, cone, meets
from agent.reconstruction.views import (
    Camera,
    Floats,
    Stack,
    camera_at,
    camera_in,
    inlined,
    pixel_of,
    project,
    slopes_of,
    unproject,
)
from hw.compiled import compiled

# --- from one view to another: a window, tilted as its depths are, in the other's picture ---

ENDLESS_PX = 1e3  # beside a camera pixels go to infinity


@compiled(error_model="numpy")
def slopes_of_map(depth: NDArray[np.float32], tilt: Floats) -> None:
    """How 1/z changes with a pixel to the right and down (height, width, 2), over 9 x 9 pixels; 0 where unknown."""
    for row in range(depth.shape[0]):
        for col in range(depth.shape[1]):
            n, su, sv, sq = 0, 0.0, 0.0, 0.0
            suu, suv, svv, suq, svq = 0.0, 0.0, 0.0, 0.0, 0.0
            tilt[row, col, 0] = tilt[row, col, 1] = 0.0
            if not depth[row, col] > 0.0:
                continue
            middle = 1.0 / depth[row, col]
            for i in range(max(row - 4, 0), min(row + 5, depth.shape[0]), 2):
                for j in range(max(col - 4, 0), min(col + 5, depth.shape[1]), 2):
                    q = 1.0 / depth[i, j] - middle
                    if not abs(q) < 0.1 * middle:
                        continue
                    u, v = float(j - col), float(i - row)
                    n, su, sv, sq = n + 1, su + u, sv + v, sq + q
                    suu, suv, svv, suq, svq = suu + u * u, suv + u * v, svv + v * v, suq + u * q, svq + v * q
            if n < 9:
                continue
            suu, suv, svv = suu - su * su / n, suv - su * sv / n, svv - sv * sv / n
            suq, svq = suq - su * sq / n, svq - sv * sq / n
            determinant = suu * svv - suv * suv
            if determinant > 1e-6 * suu * svv:
                tilt[row, col, 0] = (svv * suq - suv * svq) / determinant
                tilt[row, col, 1] = (suu * svq - suv * suq) / determinant


@inlined
def seen_at(camera: Camera, m: Floats, shift: Floats, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """A point of one view's frame in another's picture, by the rotation (3, 3) and shift (3,) between them."""
    return pixel_of(
        camera,
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + shift[0],
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + shift[1],
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + shift[2],
    )


@inlined
def most_shift_px(
    stack: Stack, mine: Camera, others: NDArray[np.int64], turns: Floats, shifts: Floats, pixel: tuple[float, float],
    near: float, far: float,
) -> float:  # fmt: skip
    """How far what is at a pixel goes in any other view's picture from one 1/z to another; ENDLESS_PX at most."""
    x, y = slopes_of(mine, pixel[0], pixel[1])
    a, b = 1.0 / near - mine.ahead_m, 1.0 / far - mine.ahead_m
    most_px = 0.0
    for k in range(len(others)):
        if others[k] < 0:
            break
        its = camera_in(stack, others[k])
        u0, v0, good0 = seen_at(its, turns[k], shifts[k], x * a, y * a, 1.0 / near)
        u1, v1, good1 = seen_at(its, turns[k], shifts[k], x * b, y * b, 1.0 / far)
        if good0 and good1:
            most_px = max(most_px, min(math.hypot(u1 - u0, v1 - v0), ENDLESS_PX))
    return most_px


@compiled(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def between(stack: Stack, n: int, others: NDArray[np.int64], turns: Floats, shifts: Floats) -> None:
    """Rotation and shift from view n's frame into each other's."""
    for k in range(len(others)):
        o = others[k]
        if o < 0:
            continue
        for a in range(3):
            shifts[k, a] = 0.0
            for b in range(3):
                shifts[k, a] += stack.rotations[o, b, a] * (stack.positions_m[n, b] - stack.positions_m[o, b])
                turns[k, a, b] = 0.0
                for c in range(3):
                    turns[k, a, b] += stack.rotations[o, c, a] * stack.rotations[n, c, b]


# --- neighbours: views that look at the same places from not too far and not too near ---

MOST = 6
ANGLE_DEG, SPREAD_DEG = 14.0, 14.0  # between two sight lines: less has no depth in it, more looks different
LEAST_DEG, LEAST_SCORE = 3.0, 0.02
SAMPLE_PX = 16  # one known pixel of each square of so many stands for it


class Neighbours(NamedTuple):
    """Best first; -1: none any more."""

    of: NDArray[np.int64]  # (n, MOST)


def neighbours(stack: Stack) -> Neighbours:
    """score = share of a view's places that are inside the other's picture x exp(-((angle - 14) / 14)^2)."""
    count = len(stack.cameras)
    of = np.full((count, MOST), -1, np.int64)
    pictures = np.array([cone(camera_at(stack, n), stack.rotations[n], stack.positions_m[n]) for n in range(count)])
    for n in range(count):
        points = _places(stack, n)
        if not len(points):
            continue
        scores = np.zeros(count)
        for other in np.flatnonzero(meets(pictures, *ball(points))).tolist():
            if other != n:
                scores[other] = _score(stack, n, other, points)
        best = np.argsort(-scores, kind="stable")[:MOST]
        best = best[scores[best] > LEAST_SCORE]
        of[n, : len(best)] = best
    return Neighbours(of)


def _places(stack: Stack, n: int) -> Floats:
    """World places (m, 3) of some of its known pixels."""
    step = SAMPLE_PX
    depth = stack.depth_m[n, step // 2 :: step, step // 2 :: step].astype(np.float64)
    rows, cols = np.nonzero(np.isfinite(depth))
    pixels = np.stack([cols, rows], axis=-1).astype(np.float64) * step + step // 2
    points = unproject(camera_at(stack, n), pixels, depth[rows, cols])
    return np.asarray(points @ stack.rotations[n].T + stack.positions_m[n])


def _score(stack: Stack, n: int, other: int, points: Floats) -> float:
    camera, there = camera_at(stack, other), (points - stack.positions_m[other]) @ stack.rotations[other]
    pixels = project(camera, there)
    with np.errstate(invalid="ignore"):
        inside = ((pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5)).all(axis=-1)
    if not inside.any():
        return 0.0
    a, b = (points[inside] - stack.positions_m[k] for k in (n, other))
    cosine = (a * b).sum(axis=-1) / np.maximum(np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1), 1e-12)
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).mean())
    if angle < LEAST_DEG:
        return 0.0
    return float(inside.mean()) * float(np.exp(-(((angle - ANGLE_DEG) / SPREAD_DEG) ** 2)))


# --- the sweep ---

HYPOTHESES, MOST_HYPOTHESES = 16, 96
STEP_PX = 1.0  # that neighbours' pictures shift from one hypothesis to the next, at most: windows are five wide
SIGMAS, MARGIN_M = 3.5, 10e-3
HALF = 2  # of the window, pixels
LEAST_TEXTURE = 25 * 1e-5  # sum of (grey - mean)^2 over the window, grey 0 to 1
LEAST = 0.75  # of the cost
ALONE = 0.15  # taken off where only one neighbour sees it
AGREE = 0.015  # of z, between a depth and what a neighbour found there
SIGMA_M, SIGMA_PER_M = 3e-3, 3e-3  # sigma = SIGMA_M + SIGMA_PER_M z^2
COMPARED = 5  # neighbours whose pictures are looked into; all are asked for agreement
MOST_NEIGHBOURS = 8

kernel = compiled(error_model="numpy", fastmath={"contract", "arcp", "nsz"})


class Swept(NamedTuple):
    """Of all views; NaN where nothing is accepted."""

    depth_m: NDArray[np.float32]  # (n, height, width)
    sigma_m: NDArray[np.float32]


class Range(NamedTuple):
    """Where to look if no focus says it: equal steps of 1/z between two depths, and how many neighbours must agree."""

    near_m: float
    far_m: float
    hypotheses: int = 96
    witnesses: int = 2


def plane_sweep(
    stack: Stack,
    neighbours: Neighbours,
    progress: Progress = lambda done, total: None,
    everywhere: Range | None = None,
    before: NDArray[np.float32] | None = None,
) -> Swept:
    """Depths of all views; stack has the focus depths that say where to look, unless it is told to look everywhere.

    before (n, height, width): depths that were found already, which are not looked for again and bear witness.
    """
    grey = stack.pictures[..., 0] if stack.pictures.shape[-1] == 1 else stack.pictures.mean(axis=-1)
    grey = np.ascontiguousarray(grey)
    count = len(grey)
    found = np.full(stack.depth_m.shape, np.nan, np.float32) if before is None else before.copy()

    def sweep(n: int) -> None:
        tilt = np.zeros((*stack.depth_m.shape[1:], 2))
        if everywhere is None:
            slopes_of_map(stack.depth_m[n], tilt)
            ends, hypotheses = (0.0, 0.0), MOST_HYPOTHESES
        else:
            ends, hypotheses = (1.0 / everywhere.near_m, 1.0 / everywhere.far_m), everywhere.hypotheses
        _sweep(stack, grey, n, neighbours.of[n, :COMPARED], tilt, ends, np.empty(hypotheses), found[n])

    # The kernel holds no lock, and each view is written by its own thread alone.
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
        for n, _ in enumerate(threads.map(sweep, range(count))):
            progress(n, count)
    kept = np.full_like(found, np.nan)
    for n in range(count):
        _agreeing(stack, found, n, neighbours.of[n], 1 if everywhere is None else everywhere.witnesses, kept[n])
    progress(count, count)
    sigma = np.empty_like(kept)
    for one, z in zip(sigma, kept, strict=True):  # one by one: all of them in float64 are most of the memory
        one[:] = SIGMA_M + SIGMA_PER_M * z.astype(float) * z.astype(float)
    return Swept(kept, sigma)


@kernel
def _sweep(
    stack: Stack, grey: NDArray[np.float32], n: int, others: NDArray[np.int64], tilt: Floats,
    ends: tuple[float, float], costs: Floats, found: NDArray[np.float32],
) -> None:  # fmt: skip
    turns, shifts = np.empty((MOST_NEIGHBOURS, 3, 3)), np.empty((MOST_NEIGHBOURS, 3))
    between(stack, n, others, turns, shifts)
    mine = camera_in(stack, n)
    own = np.empty(25, np.float32)
    for row in range(HALF, mine.height - HALF):
        for col in range(HALF, mine.width - HALF):
            depth, sigma = float(stack.depth_m[n, row, col]), float(stack.sigma_m[n, row, col])
            if found[row, col] > 0.0 or (not depth > 0.0 and ends[0] == 0.0):
                continue
            texture = _window(grey, n, row, col, own)
            if texture < LEAST_TEXTURE:
                continue
            reach = SIGMAS * sigma + MARGIN_M
            near, far = 1.0 / max(depth - reach, 0.05), 1.0 / (depth + reach)
            if ends[0] > 0.0:
                near, far = ends
            count = len(costs)
            if not ends[0] > 0.0:
                shift_px = most_shift_px(stack, mine, others, turns, shifts, (float(col), float(row)), near, far)
                count = min(max(HYPOTHESES, int(shift_px / STEP_PX) + 2), MOST_HYPOTHESES)
            step = (near - far) / (count - 1)
            # Rays of the middle and of the window's right and lower edge: the plane through them has 1/z linear.
            x0, y0 = slopes_of(mine, float(col), float(row))
            x1, y1 = slopes_of(mine, float(col + HALF), float(row))
            x2, y2 = slopes_of(mine, float(col), float(row + HALF))
            right, down = HALF * tilt[row, col, 0], HALF * tilt[row, col, 1]
            for h in range(count):
                inverse = far + h * step
                z0 = 1.0 / inverse
                z1, z2 = 1.0 / max(inverse + right, 1e-3), 1.0 / max(inverse + down, 1e-3)
                best, second, seen = -1.0, -1.0, 0
                for k in range(len(others)):
                    o = others[k]
                    if o < 0:
                        break
                    its = camera_in(stack, o)
                    a0, a1, a2 = z0 - mine.ahead_m, z1 - mine.ahead_m, z2 - mine.ahead_m
                    u0, v0, good0 = seen_at(its, turns[k], shifts[k], x0 * a0, y0 * a0, z0)
                    u1, v1, good1 = seen_at(its, turns[k], shifts[k], x1 * a1, y1 * a1, z1)
                    u2, v2, good2 = seen_at(its, turns[k], shifts[k], x2 * a2, y2 * a2, z2)
                    if not (good0 and good1 and good2):
                        continue
                    ux, vx = (u1 - u0) / HALF, (v1 - v0) / HALF
                    uy, vy = (u2 - u0) / HALF, (v2 - v0) / HALF
                    rim_u, rim_v = HALF * (abs(ux) + abs(uy)), HALF * (abs(vx) + abs(vy))
                    if not (rim_u <= u0 < its.width - 1 - rim_u and rim_v <= v0 < its.height - 1 - rim_v):
                        continue
                    value = _zncc(grey, o, own, texture, u0, v0, ux, vx, uy, vy)
                    seen += 1
                    if value > best:
                        best, second = value, best
                    elif value > second:
                        second = value
                costs[h] = 0.5 * (best + second) if seen > 1 else (best - ALONE if seen == 1 else -1.0)
            found[row, col] = _peak(costs[:count], far, step)


@inlined
def _window(grey: NDArray[np.float32], n: int, row: int, col: int, own: NDArray[np.float32]) -> float:
    """The view's own window less its mean, into (25,); the sum of its squares."""
    total = np.float32(0.0)
    for i in range(5):
        for j in range(5):
            own[5 * i + j] = grey[n, row + i - HALF, col + j - HALF]
            total += own[5 * i + j]
    mean, squares = total / np.float32(25.0), np.float32(0.0)
    for i in range(25):
        own[i] -= mean
        squares += own[i] * own[i]
    return float(squares)


@inlined
def _zncc(
    grey: NDArray[np.float32], o: int, own: NDArray[np.float32], texture: float,
    u0: float, v0: float, ux: float, vx: float, uy: float, vy: float,
) -> float:  # fmt: skip
    """Normalised cross correlation of a window with view o's, sampled bilinearly along an affine map."""
    total, squares, product = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for i in range(5):
        for j in range(5):
            u = u0 + (j - HALF) * ux + (i - HALF) * uy
            v = v0 + (j - HALF) * vx + (i - HALF) * vy
            a, b = int(v), int(u)
            down, across = np.float32(v - a), np.float32(u - b)
            top = grey[o, a, b] + across * (grey[o, a, b + 1] - grey[o, a, b])
            bottom = grey[o, a + 1, b] + across * (grey[o, a + 1, b + 1] - grey[o, a + 1, b])
            value = top + down * (bottom - top)
            total += value
            squares += value * value
            product += value * own[5 * i + j]
    rest = float(squares) - float(total) * float(total) / 25.0
    return float(product) / math.sqrt(texture * rest) if rest > 0.1 * LEAST_TEXTURE else -1.0


@inlined
def _peak(costs: Floats, far: float, step: float) -> float:
    """Depth of the best hypothesis, with a parabola over it; NaN where it is at an end or not good enough."""
    top = 0
    for h in range(1, len(costs)):
        if costs[h] > costs[top]:
            top = h
    if top == 0 or top == len(costs) - 1 or not costs[top] > LEAST:
        return math.nan
    before, after = costs[top - 1], costs[top + 1]
    curve = before + after - 2.0 * costs[top]
    offset = 0.5 * (before - after) / curve if curve < 0.0 and before > -0.5 and after > -0.5 else 0.0
    return 1.0 / (far + (top + offset) * step)


@compiled(error_model="numpy")
def _agreeing(
    stack: Stack, found: NDArray[np.float32], n: int, others: NDArray[np.int64], least: int,
    kept: NDArray[np.float32],
) -> None:  # fmt: skip
    """The depths of view n that so many neighbours have, too."""
    turns, shifts = np.empty((MOST_NEIGHBOURS, 3, 3)), np.empty((MOST_NEIGHBOURS, 3))
    between(stack, n, others, turns, shifts)
    mine = camera_in(stack, n)
    for row in range(mine.height):
        for col in range(mine.width):
            z = float(found[n, row, col])
            if not z > 0.0:
                continue
            x, y = slopes_of(mine, float(col), float(row))
            px, py = x * (z - mine.ahead_m), y * (z - mine.ahead_m)
            agreed = 0
            for k in range(len(others)):
                o = others[k]
                if o < 0:
                    break
                its = camera_in(stack, o)
                u, v, good = seen_at(its, turns[k], shifts[k], px, py, z)
                if not (good and -0.5 < u < its.width - 0.5 and -0.5 < v < its.height - 0.5):
                    continue
                there = turns[k, 2, 0] * px + turns[k, 2, 1] * py + turns[k, 2, 2] * z + shifts[k, 2]
                if abs(float(found[o, int(v + 0.5), int(u + 0.5)]) - there) < AGREE * there:
                    agreed += 1
                    if agreed == least:
                        kept[row, col] = z
                        break
