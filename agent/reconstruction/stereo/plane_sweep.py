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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.process.command import Progress
from agent.reconstruction.camera import Floats, inlined, slopes_of
from agent.reconstruction.stack import Stack, camera_in
from agent.reconstruction.stereo.neighbours import Neighbours
from agent.reconstruction.stereo.warp import between, most_shift_px, seen_at, slopes_of_map
from hw.compiled import compiled

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
    """Where to look if no focus says it: so many equal steps of 1/z between two depths, and who has to agree."""

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

    before (n, height, width): depths that were found already, which are kept and bear witness; they are not looked for
    again where the stack has no depth.
    """
    grey = stack.pictures[..., 0] if stack.pictures.shape[-1] == 1 else stack.pictures.mean(axis=-1)
    grey = np.ascontiguousarray(grey)
    count = len(grey)
    found = np.full(stack.depth_m.shape, np.nan, np.float32) if before is None else before.copy()
    tilt = np.zeros((*stack.depth_m.shape[1:], 2))
    for n in range(count):
        progress(n, count)
        if everywhere is None:
            slopes_of_map(stack.depth_m[n], tilt)
            ends, hypotheses = (0.0, 0.0), MOST_HYPOTHESES
        else:
            ends, hypotheses = (1.0 / everywhere.near_m, 1.0 / everywhere.far_m), everywhere.hypotheses
        _sweep(stack, grey, n, neighbours.of[n, :COMPARED], tilt, ends, np.empty(hypotheses), found[n])
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
            if not depth > 0.0 and ends[0] == 0.0:
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
