"""Poses of all views from their pictures together: corners of each found in the others, then everything moved to fit.

Pictures are compared with pictures, not with a scene that was built from them: such a scene holds each view's own
error, and draws the view back to where it was. First corners are looked for as far away as poses may be wrong, then,
once they fit, close by. The common motion of everything stays what priors make of it (`pose_evidence.between`); its
scale is what places and focus depths say of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from agent.process.command import Progress
from agent.reconstruction.matches import Corners, Matches, corners, matched
from agent.reconstruction.pose_evidence import carried
from agent.reconstruction.views import Camera, Floats, Stack, View, camera_in, pixel_of, rotation_of, slopes_of, stacked
from hw.compiled import compiled

# --- how well a camera's pose is known: errors of the robot and of its gimbal ---

LEVEL_RAD = math.radians(0.3)  # roll and pitch by four pressure sensors 0.2 m apart
DEPTH_M = 1.5e-3  # by the same, with what waves leave


class Sigmas(NamedTuple):
    """Standard deviations of one robot."""

    place_m: float  # in x and in y
    yaw_rad: float
    gimbal_rad: float  # of pan and of tilt


def covariance_of(rotation: Floats, arm_m: Floats, sigmas: Sigmas) -> Floats:
    """(6, 6) of (w, t) along the camera's axes; rotation (3, 3) camera to world, arm (3,) body to camera, world axes.

    A turn of the body moves the camera on its arm; one of the gimbal does not.
    """
    turns = [(np.array([0.0, 0.0, 1.0]), sigmas.yaw_rad, True)]
    turns += [(axis, LEVEL_RAD, True) for axis in np.eye(3)[:2]]
    turns += [(axis, sigmas.gimbal_rad, False) for axis in (np.array([0.0, 0.0, 1.0]), rotation[:, 0])]
    shifts = [(axis, sigma) for axis, sigma in zip(np.eye(3), (sigmas.place_m, sigmas.place_m, DEPTH_M), strict=True)]
    total = np.zeros((6, 6))
    for axis, sigma, with_arm in turns:
        moved = np.cross(axis, arm_m) if with_arm else np.zeros(3)
        column = np.concatenate([rotation.T @ axis, rotation.T @ moved])
        total += sigma**2 * np.outer(column, column)
    for axis, sigma in shifts:
        column = np.concatenate([np.zeros(3), rotation.T @ axis])
        total += sigma**2 * np.outer(column, column)
    return total


# --- normal equations of many views: blocks of six by six, only for pairs of views that see something in common ---
#
# A view of a survey shares corners with those around it, not with all: 16 a view of 500 keyframes of a basin. So the
# time and the memory that it takes to solve for all of them go nearly with how many they are, not with their cube and
# square.

SIZE = 6
Sparse = Any  # scipy's csc_array, which comes without types

kernel = compiled(error_model="numpy")


class Pairs(NamedTuple):
    """k pairs of n views, each view with itself among them, in both orders."""

    row: NDArray[np.int64]  # (k,)
    column: NDArray[np.int64]  # (k,)
    slot: NDArray[np.int32]  # (n, n) which of them, -1 for none


def pairs_of(count: int, owner: NDArray[np.int64], corner: NDArray[np.int64], other: NDArray[np.int64]) -> Pairs:
    """All pairs of so many views that see the same corner: its owner's, or one in which it was found.

    corner: of each match, in order; other: the view of each.
    """
    slot = np.full((count, count), -1, np.int32)
    np.fill_diagonal(slot, 0)
    _mark(owner, np.searchsorted(corner, np.arange(len(owner) + 1)), other, slot)
    row, column = np.nonzero(slot == 0)
    slot[row, column] = np.arange(len(row))
    return Pairs(row, column, slot)


@kernel
def _mark(
    owner: NDArray[np.int64], first: NDArray[np.int64], other: NDArray[np.int64], slot: NDArray[np.int32]
) -> None:
    for c in range(len(owner)):
        n, mine = owner[c], other[first[c] : first[c + 1]]
        for a in mine:
            slot[n, a] = slot[a, n] = 0
            for b in mine:
                slot[a, b] = 0


def matrix(count: int, row: ArrayLike, column: ArrayLike, blocks: ArrayLike) -> Sparse:
    """(6 count, 6 count) of k blocks (k, 6, 6) at places (k,); those at the same place are added."""
    values, within = np.asarray(blocks, float), np.arange(SIZE)
    rows = np.broadcast_to(SIZE * np.asarray(row)[:, None, None] + within[:, None], values.shape)
    columns = np.broadcast_to(SIZE * np.asarray(column)[:, None, None] + within, values.shape)
    places = rows.ravel(), columns.ravel()
    return csc_array(coo_array((values.ravel(), places), shape=(SIZE * count, SIZE * count)))


def solved(information: Sparse, pull: Floats) -> Floats:
    """x of information @ x = pull, for a symmetric one that is positive definite: pivots stay on the diagonal."""
    factors = splu(information, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(factors.solve(pull), float)


# --- what is known before pictures are compared: errors that a robot's views share ---

VIEW_SIGMA = (np.radians(0.1), 1e-3)  # rad and m: what a view's pose has of its own, beside its robot
FOCUS_SHARED = 4e-3  # of z: what a lens' calibration makes all its depths wrong by together
LEAST_SIGMA = 1e-6  # rad and m: of a pose that claims to be known


def robots_of(views: Sequence[View]) -> list[list[int]]:
    """Which views are one robot's, between two of its starts."""
    names = sorted({(view.robot, view.incarnation) for view in views})
    return [[n for n, view in enumerate(views) if (view.robot, view.incarnation) == name] for name in names]


def information_of(views: Sequence[View]) -> Sparse:
    """(6 (n + r), 6 (n + r)) of (w, t) of n views, and after them of their r robots.

    A robot's is what its views' covariances say as one; between that, carried over, and a view's own is VIEW_SIGMA.
    Views have to do with each other by their robot alone, so nearly all of it is empty.
    """
    own, groups = np.diag(np.repeat(np.array(VIEW_SIGMA) ** -2, 3)), robots_of(views)
    found = list[tuple[int, int, Floats]]()
    for robot, group in enumerate(groups, len(views)):
        mine = [views[n] for n in group]
        centre = np.mean([view.position_m for view in mine], axis=0)
        found.append((robot, robot, shared(mine, centre)))
        for n, view in zip(group, mine, strict=True):
            carry = carried(view, centre)
            between = -own @ carry
            found += [(n, n, own), (n, robot, between), (robot, n, between.T), (robot, robot, carry.T @ own @ carry)]
    return matrix(len(views) + len(groups), *zip(*found, strict=True))


def shared(views: Sequence[View], centre_m: Floats) -> Floats:
    """Information (6, 6) of a robot's motion about a centre: the mean of what its views say."""
    total = np.zeros((6, 6))
    for view in views:
        carry = carried(view, centre_m)
        total += carry.T @ np.linalg.inv(view.pose_covariance + LEAST_SIGMA**2 * np.eye(6)) @ carry
    return total / len(views)


def certainty_of(views: Sequence[View], corners: Corners) -> Floats:
    """(c,) information of corners' 1/z: so little that all of a robot's together know FOCUS_SHARED at best."""
    relative = (corners.depth_m / corners.sigma_m) ** 2
    for group in robots_of(views):
        mine = np.isin(corners.owner, group)
        relative[mine] /= max(1.0, float(relative[mine].sum()) * FOCUS_SHARED**2)
    return np.asarray(relative * corners.depth_m**2)


# --- bundle adjustment: poses of views and depths of their corners ---
#
# They fit where the corners were found in other pictures. A corner lies on its own pixel's ray at 1/z: one unknown,
# which is eliminated (Schur), so that six for each view are left. Steps are Gauss and Newton's, with Cauchy's weights
# of a scale c that narrows; least becomes
#
# c^2/2 sum log(1 + |found - seen|^2 / c^2) / s^2 + the like of (1/z_focus - 1/z) + 1/2 xi' Lambda xi
#
# with xi = (w, t) of all views along their cameras' axes, and of all robots, Lambda the information of
# `information_of`, and s what a match is worth, in pixels.

FOCUS_SCALE = 2.0  # Cauchy's, for depths, in their standard deviations
DAMPING = 1e-6


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


# --- poses of all views, refined in rounds ---

REACH_SIGMAS, LEAST_REACH_PX, MOST_REACH_PX = 3.5, 8.0, 40.0
LEAST_SIGMA_PX = 0.5  # what one match is worth at best
TOGETHER = 6.0  # times the median of how far matches are off: those of a picture are wrong together, as its camera is
# Cauchy's scales in pixels, a step each: what is found far away may be wrong, but poses are, too.
SCALES_PX = ((8.0,) * 4 + (4.0,) * 3 + (2.0,) * 3 + (1.0,) * 3, (3.0,) * 3 + (1.0,) * 5)


class Refined(NamedTuple):
    views: list[View]
    matches: int  # corners found in other pictures, in the last round
    off_px: tuple[float, float]  # median of how far they are from where poses put them, before and after


def refine(views: Sequence[View], progress: Progress = lambda done, total: None) -> Refined:
    """Views in the same order, where they fit each other. progress counts views, once a round.

    Raises Failed where there is no view.
    """
    stack = stacked(views)
    found, robots = corners(stack), [(view.robot, view.incarnation) for view in views]
    prior = Prior(information_of(views), 1.0 / found.depth_m, certainty_of(views, found))
    state = start = first_state(stack, found, prior)
    total = len(SCALES_PX) * len(views)
    reach_px, sigma_px = _reach_px(views, stack, found), LEAST_SIGMA_PX
    for n, scales in enumerate(SCALES_PX):
        now = stack._replace(rotations=state.rotations, positions_m=state.positions_m)
        there = found._replace(depth_m=1.0 / state.inverse)
        seen = matched(now, there, robots, reach_px, partial(_part, progress, n * len(views), total))
        for scale in scales:
            state, off_px = step(stack, found, seen, prior, state, Loss(scale, sigma_px))
        reach_px, sigma_px = LEAST_REACH_PX, max(LEAST_SIGMA_PX, TOGETHER * _median(off_px))
    placed = [
        replace(view, rotation=rotation, position_m=position)
        for view, rotation, position in zip(views, state.rotations, state.positions_m, strict=True)
    ]
    last = Loss(1.0, sigma_px)
    before, after = (_median(normal_of(stack, found, seen, prior, one, last)[0].off_px) for one in (start, state))
    return Refined(placed, len(seen.other), (before, after))


def _part(progress: Progress, before: int, total: int, done: int, _: int) -> None:
    progress(before + done, total)


def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _reach_px(views: Sequence[View], stack: Stack, found: Corners) -> float:
    """How far from where it should be a corner may be in another picture, by what poses are said to be wrong by."""
    variance = np.array([np.diag(view.pose_covariance) for view in views]).reshape(-1, 2, 3).mean(axis=(0, 2))
    z = float(np.median(found.depth_m)) if len(found.depth_m) else 1.0
    sigma_px = float(stack.cameras[:, 0].max()) * np.sqrt(2.0 * (variance[0] + variance[1] / z**2))
    return float(np.clip(REACH_SIGMAS * sigma_px, LEAST_REACH_PX, MOST_REACH_PX))
