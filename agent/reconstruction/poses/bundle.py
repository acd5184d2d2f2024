"""Poses of views and depths of their corners that fit where the corners were found in other pictures.

Bundle adjustment. A corner lies on its own pixel's ray at 1/z: one unknown, which is eliminated (Schur), so that six
for each view are left. Steps are Gauss and Newton's, with Cauchy's weights of a scale c that narrows; least becomes

    c^2/2 sum log(1 + |found - seen|^2 / c^2) / s^2 + the like of (1/z_focus - 1/z) + 1/2 xi' Lambda xi

with xi = (w, t) of all views along their cameras' axes, and of all robots, Lambda the information of shared_prior.py,
and s what a match is worth, in pixels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Camera, Floats, pixel_of, slopes_of
from agent.reconstruction.poses.blocks import Sparse, matrix, pairs_of, solved
from agent.reconstruction.poses.corners import Corners
from agent.reconstruction.poses.matches import Matches
from agent.reconstruction.stack import Stack, camera_in
from agent.reconstruction.view import rotation_of
from hw.compiled import compiled

FOCUS_SCALE = 2.0  # Cauchy's, for depths, in their standard deviations
DAMPING = 1e-6

kernel = compiled(error_model="numpy")


class State(NamedTuple):
    """What is looked for, n views of r robots, and c corners."""

    rotations: Floats  # (n, 3, 3)
    positions_m: Floats  # (n, 3)
    gone: Floats  # (n + r, 6) sum of xi: how far each view is from where it was believed to be, and each robot
    inverse: Floats  # (c,) 1/z


class Prior(NamedTuple):
    """What is known beside the matches."""

    poses: Sparse  # (6 (n + r), 6 (n + r)) information of `gone`
    inverse: Floats  # (c,) 1/z by focus
    certainty: Floats  # (c,) information of that


class Loss(NamedTuple):
    """Of matches, in pixels."""

    scale_px: float  # Cauchy's: what is so far off has half the weight
    sigma_px: float  # what one match is worth beside priors


class Normal(NamedTuple):
    """Normal equations; a kernel adds to them."""

    slot: NDArray[np.int32]  # (n, n) which block is that of two views
    blocks: Floats  # (k, 6, 6) of matches: what they say of poses, corners eliminated
    pull: Floats  # (6 (n + r),) of matches and of priors
    curve: Floats  # (c,) of corners
    tug: Floats  # (c,)
    of_corner: Floats  # (c, 6) coupling of a corner with its own view
    of_match: Floats  # (m, 6) and with the one it was found in
    off_px: Floats  # (m,) between where it was found and where it should be


def first_state(stack: Stack, corners: Corners, prior: Prior) -> State:
    """Everything where it is believed to be."""
    return State(stack.rotations, stack.positions_m, np.zeros((prior.poses.shape[0] // 6, 6)), 1.0 / corners.depth_m)


def normal_of(
    stack: Stack, corners: Corners, matches: Matches, prior: Prior, state: State, loss: Loss
) -> tuple[Normal, Sparse, float]:
    """The normal equations there, their matrix (6 (n + r), 6 (n + r)), and the cost."""
    gone, c, m = state.gone.ravel(), len(corners.owner), len(matches.other)
    pull = -(prior.poses @ gone)
    held = -0.5 * float(pull @ gone)
    pairs = pairs_of(len(stack.cameras), corners.owner, matches.corner, matches.other)
    blocks = np.zeros((len(pairs.row), 6, 6))
    made = Normal(pairs.slot, blocks, pull, np.zeros(c), np.zeros(c), np.zeros((c, 6)), np.zeros((m, 6)), np.zeros(m))
    first = np.searchsorted(matches.corner, np.arange(c + 1))
    there = stack._replace(rotations=state.rotations, positions_m=state.positions_m)
    cost = _sum(there, corners, matches, first, prior.inverse, prior.certainty, state.inverse, loss, made)
    return made, prior.poses + matrix(len(state.gone), pairs.row, pairs.column, blocks), cost + held


def step(
    stack: Stack, corners: Corners, matches: Matches, prior: Prior, state: State, loss: Loss
) -> tuple[State, Floats]:
    """One step; and how far, in pixels, each match was off before it."""
    normal, hessian, _ = normal_of(stack, corners, matches, prior, state, loss)
    hessian.setdiag(hessian.diagonal() * (1.0 + DAMPING))
    moves = solved(hessian, normal.pull).reshape(-1, 6)
    xi = moves[: len(stack.cameras)]
    with np.errstate(invalid="ignore", divide="ignore"):
        tug = normal.tug - (normal.of_corner * xi[corners.owner]).sum(axis=1)
        tug -= np.bincount(matches.corner, (normal.of_match * xi[matches.other]).sum(axis=1), len(tug))
        further = np.where(normal.curve > 0.0, tug / normal.curve, 0.0)
    inverse = np.clip(state.inverse + further, 0.5 * state.inverse, 2.0 * state.inverse)
    turns = np.array([rotation_of(w) for w in xi[:, :3]])
    positions = state.positions_m + np.einsum("nij,nj->ni", state.rotations, xi[:, 3:])
    return State(state.rotations @ turns, positions, state.gone + moves, inverse), normal.off_px


@kernel
def _sum(
    stack: Stack, corners: Corners, matches: Matches, first: NDArray[np.int64], focus: Floats, certainty: Floats,
    q: Floats, loss: Loss, to: Normal,
) -> float:  # fmt: skip
    cost = 0.0
    for c in range(len(q)):
        if first[c] == first[c + 1]:
            continue
        miss, certain = focus[c] - q[c], certainty[c]
        large = 1.0 + miss * miss * certain / FOCUS_SCALE**2
        cost += 0.5 * FOCUS_SCALE**2 * math.log(large)
        to.curve[c], to.tug[c] = certain / large, certain / large * miss
        for m in range(first[c], first[c + 1]):
            cost += _add(stack, corners, matches, c, m, q[c], loss, to)
        _eliminate(corners.owner[c], matches.other[first[c] : first[c + 1]], c, first[c], to)
    return cost


@kernel
def _add(stack: Stack, corners: Corners, matches: Matches, c: int, m: int, q: float, loss: Loss, to: Normal) -> float:
    """One match."""
    n, o, z = corners.owner[c], matches.other[m], 1.0 / q
    mine, its = camera_in(stack, n), camera_in(stack, o)
    x, y = slopes_of(mine, corners.pixel[c, 0], corners.pixel[c, 1])
    p, there, h = np.zeros(3), np.zeros(3), np.zeros(3)
    p[0], p[1], p[2] = x * (z - mine.ahead_m), y * (z - mine.ahead_m), z
    turn = np.zeros((3, 3))  # from n's axes to o's
    for i in range(3):
        for j in range(3):
            for k in range(3):
                turn[i, j] += stack.rotations[o, k, i] * stack.rotations[n, k, j]
            there[i] += turn[i, j] * p[j] + stack.rotations[o, j, i] * (
                stack.positions_m[n, j] - stack.positions_m[o, j]
            )
    u, v, good = pixel_of(its, there[0], there[1], there[2])
    du, dv = matches.pixel[m, 0] - u, matches.pixel[m, 1] - v
    to.off_px[m] = (du * du + dv * dv) ** 0.5
    if not good:
        to.off_px[m] = np.inf
        return 0.0
    large = 1.0 + (du * du + dv * dv) / loss.scale_px**2
    share = 1.0 / loss.sigma_px**2 / large
    by_point, of_n, of_o = np.zeros((2, 3)), np.zeros(6), np.zeros(6)
    pixel_by_point(its, there, by_point)
    for r in range(2):
        rest = du if r == 0 else dv
        # A point of o's frame goes to p' + turn (w x p + t) with n's motion, to p' - w x p' - t with o's.
        g = by_point[r]
        for k in range(3):
            h[k] = g[0] * turn[0, k] + g[1] * turn[1, k] + g[2] * turn[2, k]
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            of_n[k], of_n[3 + k] = p[i] * h[j] - p[j] * h[i], h[k]
            of_o[k], of_o[3 + k] = there[j] * g[i] - there[i] * g[j], -g[k]
        of_q = -z * z * (h[0] * x + h[1] * y + h[2])
        to.curve[c] += share * of_q * of_q
        to.tug[c] += share * of_q * rest
        for i in range(6):
            to.of_corner[c, i] += share * of_q * of_n[i]
            to.of_match[m, i] += share * of_q * of_o[i]
            to.pull[6 * n + i] += share * of_n[i] * rest
            to.pull[6 * o + i] += share * of_o[i] * rest
            for j in range(6):
                to.blocks[to.slot[n, n], i, j] += share * of_n[i] * of_n[j]
                to.blocks[to.slot[o, o], i, j] += share * of_o[i] * of_o[j]
                to.blocks[to.slot[n, o], i, j] += share * of_n[i] * of_o[j]
                to.blocks[to.slot[o, n], i, j] += share * of_o[i] * of_n[j]
    return 0.5 * (loss.scale_px / loss.sigma_px) ** 2 * math.log(large)


@kernel
def _eliminate(n: int, others: NDArray[np.int64], c: int, first: int, to: Normal) -> None:
    """A corner's own unknown: what it leaves to each pair of the views that see it."""
    for a in range(len(others) + 1):
        va, pa = (n, to.of_corner[c]) if a == 0 else (others[a - 1], to.of_match[first + a - 1])
        for i in range(6):
            part = pa[i] / to.curve[c]
            to.pull[6 * va + i] -= part * to.tug[c]
            for b in range(len(others) + 1):
                vb, pb = (n, to.of_corner[c]) if b == 0 else (others[b - 1], to.of_match[first + b - 1])
                for j in range(6):
                    to.blocks[to.slot[va, vb], i, j] -= part * pb[j]


@kernel
def pixel_by_point(camera: Camera, p: Floats, out: Floats) -> None:
    """Fill out (2, 3): how the pixel of a point (3,) of the camera frame changes with it, 1/m; bend and all."""
    d = p[2] - camera.ahead_m
    x, y = p[0] / d, p[1] / d
    k, b2, f = 1.0 + camera.bend * (x * x + y * y), 2.0 * camera.bend, camera.f_px / d
    xx, xy, yy = f * (k + b2 * x * x), f * b2 * x * y, f * (k + b2 * y * y)
    out[0, 0], out[0, 1], out[0, 2] = xx, xy, -xx * x - xy * y
    out[1, 0], out[1, 1], out[1, 2] = xy, yy, -xy * x - yy * y
