"""What one picture says of its camera's pose, given what the scene looks like from there.

Residuals are tones, (picture - seen) / s, and depths, (focus - seen) / (sigma + 4 mm), both by Huber's loss; s is 1.5
times the median of the tones' size, 0.01 at least. Neighbouring pixels are wrong together, so that a picture of n
pixels does not count n times: hence the two weights.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Camera, slopes_of
from agent.reconstruction.view import View
from hw.compiled import compiled

Floats = NDArray[np.float64]

GAMMA, DARKEST = 1.0 / 2.2, 1e-5
TONE_WEIGHT, DEPTH_WEIGHT = 0.02, 0.002
TONE_SPREAD, LEAST_TONE = 1.5, 0.01
DEPTH_SLACK_M, DEPTH_HUBER = 4e-3, 1.5
STEP_PX, RIM_PX, HOLE_PX = 2, 4, 7  # every second pixel; none near the rim, and none so near to a hole

kernel = compiled(error_model="numpy")


class Normal(NamedTuple):
    """Normal equations of a pose: `hessian` @ xi = `pull`, xi = (w, t) along the camera's axes."""

    hessian: Floats  # (6, 6)
    pull: Floats  # (6,)
    cost: float


def evidence(view: View, seen: Floats, seen_depth_m: Floats) -> Normal:
    """seen: linear light (height, width, 3) and depth (height, width) as they look from the view; NaN in holes."""
    good = np.isfinite(seen).all(axis=-1) & np.isfinite(seen_depth_m)
    side = 2 * HOLE_PX + 1
    good = cv2.erode(good.astype(np.uint8), np.ones((side, side), np.uint8), borderValue=1).astype(bool)
    model = _tone(np.where(np.isfinite(seen), seen, 0.0))
    tones = _tone(view.picture.astype(float))
    depth = np.where(np.isfinite(seen_depth_m), seen_depth_m, 0.0)
    off = np.abs(tones - model)[good]
    scale = max(TONE_SPREAD * float(np.median(off)), LEAST_TONE) if off.size else 1.0
    hessian, pull = np.zeros((6, 6)), np.zeros(6)
    sigma = view.sigma_m.astype(float) + DEPTH_SLACK_M
    across, down = _slopes(model)
    cost = _sum(
        view.camera, tones, model, across, down, view.depth_m.astype(float), sigma, depth, good, scale, hessian, pull
    )
    return Normal(hessian, pull, cost)


def _tone(light: Floats) -> Floats:
    return np.ascontiguousarray((np.maximum(light, 0.0) + DARKEST) ** GAMMA)


def _slopes(tones: Floats) -> tuple[Floats, Floats]:
    """Change of a picture per pixel to the right and downwards: central differences."""
    down, across = np.gradient(tones, axis=(0, 1))
    return np.ascontiguousarray(across), np.ascontiguousarray(down)


@kernel
def flow(camera: Camera, u: float, v: float, depth_m: float, out: Floats) -> None:
    """Fill out (3, 6): how the pixel (u, v) [px] and the depth [m] of what is there now change with (w, t).

    A point p of the camera frame goes to p - w x p - t; its pixel is that of the whole camera, bend and all. Without
    bend and `ahead_m` these are the pinhole's f x y, -f (1 + x^2), f y, -f / z, 0, f x / z, and so on.
    """
    x, y = slopes_of(camera, u, v)
    d, b2 = depth_m - camera.ahead_m, 2.0 * camera.bend
    k = 1.0 + camera.bend * (x * x + y * y)
    f = camera.f_px / d
    xx, xy, yy = f * (k + b2 * x * x), f * b2 * x * y, f * (k + b2 * y * y)
    p = (x * d, y * d, depth_m)
    move = np.zeros((3, 6))  # of p: columns w, then t
    move[0, 1], move[0, 2] = -p[2], p[1]
    move[1, 0], move[1, 2] = p[2], -p[0]
    move[2, 0], move[2, 1] = -p[1], p[0]
    for k2 in range(3):
        move[k2, 3 + k2] = -1.0
    for j in range(6):
        across, down = move[0, j] - x * move[2, j], move[1, j] - y * move[2, j]
        out[0, j] = xx * across + xy * down
        out[1, j] = xy * across + yy * down
        out[2, j] = move[2, j]


@kernel
def _sum(
    camera: Camera,
    tones: Floats,
    model: Floats,
    across: Floats,
    down: Floats,
    focus: Floats,
    sigma: Floats,
    depth: Floats,
    good: NDArray[np.bool_],
    scale: float,
    hessian: Floats,
    pull: Floats,
) -> float:
    cost, moves, row_of = 0.0, np.zeros((3, 6)), np.zeros(6)
    for row in range(RIM_PX, depth.shape[0] - RIM_PX, STEP_PX):
        for col in range(RIM_PX, depth.shape[1] - RIM_PX, STEP_PX):
            if not good[row, col]:
                continue
            flow(camera, float(col), float(row), depth[row, col], moves)
            for c in range(3):
                # What is at a pixel after the motion was beside it before: seen changes against the flow.
                for j in range(6):
                    row_of[j] = -(across[row, col, c] * moves[0, j] + down[row, col, c] * moves[1, j]) / scale
                rest = (tones[row, col, c] - model[row, col, c]) / scale
                cost += _add(row_of, rest, 1.0, TONE_WEIGHT, hessian, pull)
            if math.isfinite(focus[row, col]):
                slope_u = 0.5 * (depth[row, col + 1] - depth[row, col - 1])
                slope_v = 0.5 * (depth[row + 1, col] - depth[row - 1, col])
                for j in range(6):
                    change = moves[2, j] - slope_u * moves[0, j] - slope_v * moves[1, j]
                    row_of[j] = change / sigma[row, col]
                rest = (focus[row, col] - depth[row, col]) / sigma[row, col]
                cost += _add(row_of, rest, DEPTH_HUBER, DEPTH_WEIGHT, hessian, pull)
    return cost


@kernel
def _add(row: Floats, rest: float, huber: float, weight: float, hessian: Floats, pull: Floats) -> float:
    size = abs(rest)
    share = weight if size <= huber else weight * huber / size
    for i in range(6):
        pull[i] += share * row[i] * rest
        for j in range(6):
            hessian[i, j] += share * row[i] * row[j]
    return 0.5 * weight * rest * rest if size <= huber else weight * huber * (size - 0.5 * huber)
