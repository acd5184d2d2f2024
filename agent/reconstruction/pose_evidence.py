"""What one picture says of its camera's pose, given what the scene looks like from there.

Residuals are tones, (picture - seen) / s, and depths, (focus - seen) / (sigma + 4 mm), both by Huber's loss; s is 1.5
times the median of the tones' size, 0.01 at least. Neighbouring pixels are wrong together, so that a picture of n
pixels does not count n times: hence the two weights. `place` moves a view to where its picture fits.

Small motions: a view's is (w, t) along its camera's axes, as in `views`; a robot's is (w, t) along the world's, about
a centre: R <- exp([w]x) R, T <- c + exp([w]x) (T - c) + t.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.views import Camera, View, moved, rotation_of, slopes_of
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


# --- motions of one view, of all views of a robot together, and of everything at once ---


def carried(view: View, centre_m: Floats) -> Floats:
    """(6, 6) from its robot's motion about `centre_m` to the view's own: [R', 0; -R' [a]x, R'], a from the centre."""
    x, y, z = view.position_m - centre_m
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    to_camera = view.rotation.T
    return np.block([[to_camera, np.zeros((3, 3))], [-to_camera @ cross, to_camera]])


def moved_about(view: View, centre_m: Floats, w_rad: Floats, t_m: Floats) -> View:
    """The view after its robot's motion."""
    turn = rotation_of(w_rad)
    return replace(view, rotation=turn @ view.rotation, position_m=centre_m + turn @ (view.position_m - centre_m) + t_m)


class Motion(NamedTuple):
    """Of the world as a whole: place -> rotation @ place + shift_m."""

    rotation: Floats  # (3, 3)
    shift_m: Floats  # (3,)


LEVER_M = 0.5  # how far before each camera stands for what it looks at: half of a tank


def between(found: Sequence[View], true: Sequence[View]) -> Motion:
    """The one that brings `found` cameras nearest to the `true` ones, in the least squares of what they look at.

    Pictures cannot tell it, so it is taken off before a reconstruction is scored. Each camera stands with its place and
    three points LEVER_M before, right of and below it (Kabsch 1976 on all of them).
    """
    a, b = (np.concatenate([_marks(view) for view in views]) for views in (found, true))
    middle_a, middle_b = a.mean(axis=0), b.mean(axis=0)
    u, _, vt = np.linalg.svd((b - middle_b).T @ (a - middle_a))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return Motion(rotation, middle_b - rotation @ middle_a)


def by_motion(view: View, motion: Motion) -> View:
    """The view where the whole world has moved."""
    return replace(
        view, rotation=motion.rotation @ view.rotation, position_m=motion.rotation @ view.position_m + motion.shift_m
    )


def apart(found: Sequence[View], true: Sequence[View]) -> tuple[Floats, Floats]:
    """How far each found camera is from the true one: metres (n,) and radians (n,)."""
    metres = [float(np.linalg.norm(a.position_m - b.position_m)) for a, b in zip(found, true, strict=True)]
    cosine = [(np.trace(a.rotation.T @ b.rotation) - 1.0) / 2.0 for a, b in zip(found, true, strict=True)]
    return np.array(metres), np.arccos(np.clip(cosine, -1.0, 1.0))


def _marks(view: View) -> Floats:
    return np.asarray(view.position_m + np.concatenate([np.zeros((1, 3)), LEVER_M * view.rotation.T]))


# --- one view moved to where it fits a scene that stands still ---

Look = Callable[[View], tuple[Floats, Floats]]  # linear light (h, w, 3) and depth (h, w) from a view; NaN in holes

CLIP = (10e-3, 8e-3)  # rad and m of one step
ROUNDS = 8


class Placed(NamedTuple):
    view: View
    costs: tuple[float, ...]  # before each round, and at the end


def place(view: View, look: Look, prior: Floats | None = None, rounds: int = ROUNDS) -> Placed:
    """The view where its picture fits, by Gauss and Newton's steps on tones and depths.

    prior: information (6, 6) of its motion.
    """
    information = np.zeros((6, 6)) if prior is None else prior
    gone, costs, now = np.zeros(6), [], view
    for _ in range(rounds):
        found = evidence(now, *look(now))
        costs.append(found.cost)
        hessian = found.hessian + information + 1e-9 * np.eye(6)
        pull = found.pull - information @ gone
        xi = clipped(np.asarray(np.linalg.solve(hessian, pull), float), CLIP)
        gone, now = gone + xi, moved(now, xi[:3], xi[3:])
    costs.append(evidence(now, *look(now)).cost)
    return Placed(now, tuple(costs))


def clipped(xi: Floats, clip: tuple[float, float]) -> Floats:
    """A step (6,), shortened as a whole until it turns by clip[0] rad at most, and goes no farther than clip[1] m."""
    over = max(float(np.linalg.norm(xi[:3])) / clip[0], float(np.linalg.norm(xi[3:])) / clip[1], 1.0)
    return np.asarray(xi / over)
