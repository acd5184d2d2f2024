"""Poses of all views from their pictures together: corners of each found in the others, then everything moved to fit.

Pictures are compared with pictures, not with a scene that was built from them: such a scene holds each view's own
error, and draws the view back to where it was. First corners are looked for as far away as poses may be wrong, then,
once they fit, close by. The common motion of everything stays what priors make of it (`pose_evidence.between`); its
scale is what places and focus depths say of it.

Steps are our own, by scipy's sparse matrices: `scipy.optimize.least_squares` (LSMR of 60 rounds) has as good poses, but
takes 6 s in place of 3 for 45 views, and 116 s in place of 26 for 500 of a survey (1.3 mm by both).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, csr_array, diags_array, eye_array, hstack
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from agent.process.command import Progress
from agent.reconstruction.matches import Corners, Matches, corners, matched
from agent.reconstruction.pose_evidence import carried
from agent.reconstruction.views import Floats, Stack, View, camera_at, ray_slopes, stacked

# --- how well a camera's pose is known: errors of the robot and of its gimbal ---

LEVEL_RAD = math.radians(0.3)  # roll and pitch by four pressure sensors 0.2 m apart
DEPTH_M = 1.5e-3  # by the same, with what waves leave


class Sigmas(NamedTuple):
    """Standard deviations of one robot."""

    place_m: float  # in x and in y
    yaw_rad: float
    gimbal_rad: float  # of pan and of tilt
    level_rad: float = LEVEL_RAD  # of roll and of pitch
    depth_m: float = DEPTH_M


def covariance_of(rotation: Floats, arm_m: Floats, sigmas: Sigmas) -> Floats:
    """(6, 6) of (w, t) along the camera's axes; rotation (3, 3) camera to world, arm (3,) body to camera, world axes.

    A turn of the body moves the camera on its arm; one of the gimbal does not.
    """
    turns = [(np.array([0.0, 0.0, 1.0]), sigmas.yaw_rad, True)]
    turns += [(axis, sigmas.level_rad, True) for axis in np.eye(3)[:2]]
    turns += [(axis, sigmas.gimbal_rad, False) for axis in (np.array([0.0, 0.0, 1.0]), rotation[:, 0])]
    shifts = zip(np.eye(3), (sigmas.place_m, sigmas.place_m, sigmas.depth_m), strict=True)
    total = np.zeros((6, 6))
    for axis, sigma, with_arm in turns:
        moved = np.cross(axis, arm_m) if with_arm else np.zeros(3)
        column = np.concatenate([rotation.T @ axis, rotation.T @ moved])
        total += sigma**2 * np.outer(column, column)
    for axis, sigma in shifts:
        column = np.concatenate([np.zeros(3), rotation.T @ axis])
        total += sigma**2 * np.outer(column, column)
    return total


# --- what is known before pictures are compared: errors that a robot's views share, and those of each ---

FOCUS_SHARED = 4e-3  # of z: what a lens' calibration makes all its depths wrong by together
LEAST_SIGMA = 1e-6  # rad and m: of a pose that claims to be known
Sparse = Any  # scipy's csr_array, which comes without types


def robots_of(views: Sequence[View]) -> list[list[int]]:
    """Which views are one robot's, between two of its starts."""
    names = sorted({(view.robot, view.incarnation) for view in views})
    return [[n for n, view in enumerate(views) if (view.robot, view.incarnation) == name] for name in names]


def errors_of(views: Sequence[View]) -> Sparse:
    """(6 n, 6 (n + r)): (w, t) of n views by errors of unit variance, their own and after them those of r robots.

    A robot's error is what its views' covariances say as one, carried over to each.
    """
    groups = robots_of(views)
    together = np.zeros((6 * len(views), 6 * len(groups)))
    for robot, group in enumerate(groups):
        mine = [views[n] for n in group]
        centre = np.mean([view.position_m for view in mine], axis=0)
        root = np.linalg.cholesky(np.linalg.inv(shared(mine, centre)))
        for n, view in zip(group, mine, strict=True):
            together[6 * n : 6 * n + 6, 6 * robot : 6 * robot + 6] = carried(view, centre) @ root
    alone = block_diag([np.linalg.cholesky(view.own_covariance) for view in views])
    return hstack([alone, csr_array(together)], format="csr")


def shared(views: Sequence[View], centre_m: Floats) -> Floats:
    """Information (6, 6) of a robot's motion about a centre: the mean of what its views say."""
    total = np.zeros((6, 6))
    for view in views:
        carry = carried(view, centre_m)
        total += carry.T @ np.linalg.inv(view.pose_covariance + LEAST_SIGMA**2 * np.eye(6)) @ carry
    return total / len(views)


def focus_sigma(views: Sequence[View], corners: Corners) -> Floats:
    """(c,) standard deviation of the logarithm of z: all of a robot's depths together know FOCUS_SHARED at best."""
    relative = (corners.depth_m / corners.sigma_m) ** 2
    for group in robots_of(views):
        mine = np.isin(corners.owner, group)
        relative[mine] /= max(1.0, float(relative[mine].sum()) * FOCUS_SHARED**2)
    return np.asarray(relative**-0.5)


# --- bundle adjustment: poses of views and depths of their corners, where the corners were found in other pictures ---
#
# A corner lies on its own pixel's ray: its depth is the one unknown of it. All unknowns x are errors of unit variance:
# of views, of robots, of the corners' log z. Steps are Gauss and Newton's, with Cauchy's weights of a scale c that
# narrows; least becomes
#
# c^2/2 sum log(1 + |found - seen|^2 / c^2) / s^2 + 2 sum log(1 + x_corner^2 / 4) + 1/2 |x_view, x_robot|^2
#
# with s what a match is worth, in pixels.

FOCUS_SCALE = 2.0  # Cauchy's, for depths, in their standard deviations
MOST_FURTHER = math.log(2.0)  # of log z in one step


class Moved(NamedTuple):
    """Where everything is by some errors."""

    turns: Floats  # (n, 3) of views, along their cameras' axes
    rotations: Floats  # (n, 3, 3)
    positions_m: Floats  # (n, 3)
    depth_m: Floats  # (c,)


class Points(NamedTuple):
    """Of m matches: each corner in the camera that it was found in."""

    turn: Floats  # (m, 3, 3) from its own camera's axes to this one's
    own: Floats  # (m, 3) where it is, its own camera's frame
    there: Floats  # (m, 3) this one's
    slopes: Floats  # (m, 2)
    bend: Floats  # (m,) by what the lens magnifies there
    good: NDArray[np.bool_]  # (m,) before the camera
    off_px: Floats  # (m, 2) from where it should be to where it was found; 0 where it is not good


@dataclass(frozen=True, eq=False)
class Bundle:
    """n views, c corners, m matches; what is known of them beforehand, and what a match is worth."""

    stack: Stack
    corners: Corners
    matches: Matches
    slopes: Floats  # (c, 2) of the corners' rays
    errors: Sparse  # (6 n, 6 (n + r)) of `errors_of`
    sigma: Floats  # (c,) of `focus_sigma`
    sigma_px: float  # what one match is worth

    def parts(self, x: Floats) -> tuple[Floats, Floats]:
        """Those of views and robots (6 (n + r),), and those of corners (c,)."""
        count = self.errors.shape[1]
        return x[:count], x[count:]

    def moved(self, x: Floats) -> Moved:
        """Where everything is."""
        poses, depths = self.parts(x)
        xi = (self.errors @ poses).reshape(-1, 6)
        return Moved(
            xi[:, :3],
            self.stack.rotations @ Rotation.from_rotvec(xi[:, :3]).as_matrix(),
            self.stack.positions_m + np.einsum("nij,nj->ni", self.stack.rotations, xi[:, 3:]),
            self.corners.depth_m * np.exp(self.sigma * depths),
        )

    def points(self, at: Moved) -> Points:
        """The matches' corners, there."""
        corner, o = self.matches.corner, self.matches.other
        n, cameras, z = self.corners.owner[corner], self.stack.cameras, at.depth_m[corner]
        own = np.column_stack([self.slopes[corner] * (z - cameras[n, 4])[:, None], z])
        back = np.swapaxes(at.rotations[o], 1, 2)
        turn = back @ at.rotations[n]
        there = (turn @ own[:, :, None] + back @ (at.positions_m[n] - at.positions_m[o])[:, :, None])[..., 0]
        f_px, centre, bend = cameras[o, 0], cameras[o, 1:3], cameras[o, 3]
        ahead = there[:, 2] - cameras[o, 4]
        slopes = there[:, :2] / ahead[:, None]
        r2 = (slopes * slopes).sum(axis=1)
        good = (ahead > 1e-6) & (1.0 + 3.0 * bend * r2 > 0.0)
        off = self.matches.pixel - centre - (f_px * (1.0 + bend * r2))[:, None] * slopes
        return Points(turn, own, there, slopes, 1.0 + bend * r2, good, np.where(good[:, None], off, 0.0))

    def off_px(self, x: Floats) -> Floats:
        """(m,) how far each match is from where it should be; infinity where that is behind the camera."""
        points = self.points(self.moved(x))
        return np.where(points.good, np.linalg.norm(points.off_px, axis=1), np.inf)

    def jacobian(self, at: Moved, p: Points) -> tuple[Sparse, Sparse]:
        """Change of `off_px` (2 m), u and v in turn, with (w, t) of views (2 m, 6 n), and x of corners (2 m, c)."""
        m = len(self.matches.other)
        corner, o = self.matches.corner, self.matches.other
        n, cameras = self.corners.owner[corner], self.stack.cameras[o]
        across = 2.0 * cameras[:, 3, None, None] * p.slopes[:, :, None] * p.slopes[:, None, :]
        by_slope = cameras[:, 0, None, None] * (p.bend[:, None, None] * np.eye(2) + across)
        by_place = np.concatenate([by_slope, -by_slope @ p.slopes[:, :, None]], axis=2)  # (m, 2, 3)
        by_place /= (p.there[:, 2] - cameras[:, 4])[:, None, None]
        # A point of its own frame goes to p + w x p with the turn of its own camera, to p' - w x p' with the other's.
        by_own, chart = by_place @ p.turn, chart_of(at.turns)
        shift = by_place @ np.swapaxes(at.rotations[o], 1, 2)
        values = [
            np.cross(p.own[:, None], by_own) @ chart[n],
            shift @ self.stack.rotations[n],
            np.cross(by_place, p.there[:, None]) @ chart[o],
            -shift @ self.stack.rotations[o],
        ]
        by_depth = by_own @ (at.depth_m[corner, None] * np.column_stack([self.slopes[corner], np.ones(m)]))[:, :, None]
        bad = ~p.good[:, None, None]
        by_view = np.where(bad, 0.0, -np.concatenate(values, axis=2))  # (m, 2, 12)
        by_corner = np.where(bad, 0.0, -by_depth * self.sigma[corner, None, None])
        six = np.arange(6)
        columns = np.repeat(np.column_stack([6 * n[:, None] + six, 6 * o[:, None] + six]), 2, axis=0)
        return (
            csr_array((by_view.ravel(), columns.ravel(), 12 * np.arange(2 * m + 1)), shape=(2 * m, 6 * len(at.turns))),
            csr_array((by_corner.ravel(), np.repeat(corner, 2), np.arange(2 * m + 1)), shape=(2 * m, len(at.depth_m))),
        )

    def step(self, x: Floats, scale_px: float) -> Floats:
        """One step of Gauss and Newton's. Corners are eliminated (Schur), so that six for each view and robot are left.

        The matrix is sparse: a view of 500 keyframes of a basin shares corners with 16 others.
        """
        (poses, depths), at = self.parts(x), self.moved(x)
        points = self.points(at)
        by_view, by_corner = self.jacobian(at, points)
        off = points.off_px.ravel()
        weight = np.repeat(self.sigma_px**-2 / (1.0 + (points.off_px**2).sum(axis=1) / scale_px**2), 2)
        known = 1.0 / (1.0 + (depths / FOCUS_SCALE) ** 2)
        weighed = diags_array(weight) @ by_view
        coupling = weighed.T @ by_corner
        curve, tug = known + (by_corner**2).T @ weight, -known * depths - by_corner.T @ (weight * off)
        rest = by_view.T @ weighed - coupling @ diags_array(1.0 / curve) @ coupling.T
        pull = -(weighed.T @ off) - coupling @ (tug / curve)
        information = self.errors.T @ rest @ self.errors + eye_array(len(poses))
        moves = solved(information, self.errors.T @ pull - poses)
        further = (tug - coupling.T @ (self.errors @ moves)) / curve
        most = MOST_FURTHER / self.sigma
        return np.concatenate([poses + moves, depths + np.clip(further, -most, most)])


def solved(information: Sparse, pull: Floats) -> Floats:
    """x of information @ x = pull, for a symmetric one that is positive definite: pivots stay on the diagonal."""
    how = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    return np.asarray(splu(information.tocsc(), **how).solve(pull), float)


def bundle_of(
    stack: Stack, corners: Corners, matches: Matches, errors: Sparse, sigma: Floats, sigma_px: float
) -> Bundle:
    """errors: of `errors_of`; sigma (c,): of `focus_sigma`."""
    slopes = [ray_slopes(camera_at(stack, n), corners.pixel[corners.owner == n]) for n in range(len(stack.cameras))]
    return Bundle(stack, corners, matches, np.concatenate(slopes), errors, sigma, sigma_px)


def chart_of(turns: Floats) -> Floats:
    """(n, 3, 3) by which exp([w]x) turns on, along its own axes, as w (n, 3) grows: the right Jacobian of rotations."""
    angle = np.maximum(np.linalg.norm(turns, axis=1), 1e-6)[:, None, None]
    cross = np.cross(np.eye(3), turns[:, None])  # rows e x w: [w]x
    first, second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2, (1.0 - np.sinc(angle / np.pi)) / angle**2
    return np.asarray(np.eye(3) - first * cross + second * cross @ cross)


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
    errors, sigma = errors_of(views), focus_sigma(views, found)
    at, total = Moved(np.zeros((len(views), 3)), stack.rotations, stack.positions_m, found.depth_m), 2 * len(views)
    x = start = np.zeros(errors.shape[1] + len(sigma))
    reach_px, sigma_px = _reach_px(views, stack, found), LEAST_SIGMA_PX
    for n, scales in enumerate(SCALES_PX):
        now = stack._replace(rotations=at.rotations, positions_m=at.positions_m)
        there, part = found._replace(depth_m=at.depth_m), partial(_part, progress, n * len(views), total)
        bundle = bundle_of(stack, found, matched(now, there, robots, reach_px, part), errors, sigma, sigma_px)
        for scale in scales:
            x = bundle.step(x, scale)
        at, off_px = bundle.moved(x), (_median(bundle.off_px(start)), _median(bundle.off_px(x)))
        reach_px, sigma_px = LEAST_REACH_PX, max(LEAST_SIGMA_PX, TOGETHER * off_px[1])
    placed = [
        replace(view, rotation=rotation, position_m=position)
        for view, rotation, position in zip(views, at.rotations, at.positions_m, strict=True)
    ]
    return Refined(placed, len(bundle.matches.other), off_px)


def _part(progress: Progress, before: int, total: int, done: int, _: int) -> None:
    progress(before + done, total)


def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _reach_px(views: Sequence[View], stack: Stack, found: Corners) -> float:
    """How far from where it should be a corner may be in another picture, by what poses are said to be wrong by."""
    each = np.array([np.diag(view.pose_covariance + view.own_covariance) for view in views])
    variance = each.reshape(-1, 2, 3).mean(axis=(0, 2))
    z = float(np.median(found.depth_m)) if len(found.depth_m) else 1.0
    sigma_px = float(stack.cameras[:, 0].max()) * np.sqrt(2.0 * (variance[0] + variance[1] / z**2))
    return float(np.clip(REACH_SIGMAS * sigma_px, LEAST_REACH_PX, MOST_REACH_PX))
