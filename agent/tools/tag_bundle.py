"""Bundle adjustment of a survey of tags: places of tags and of the camera, adjusted together until every corner is
where it was seen.

Bundle adjustment (Triggs et al. 2000): Gauss-Newton on all poses at once, those of the camera eliminated by the Schur
complement, each tag's eight numbers weighed together and robustly (Huber). Unknown beside poses: each print's own size,
and the focal length as well as its calibration left it open. What is known beforehand (that a tag is flat on a face,
where somebody measured some) enters as Gaussian priors in the axes of the face; without any, nothing says where all is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agent.capabilities.swim.landmarks import ORDER
from agent.capabilities.swim.projection import BENT_PX, EDGE_AT, EDGE_PX, FOUND_PX, OFFSET_PX, STRETCH
from agent.core.step_io import SeenTag
from agent.perception.tags import Array

# --- rotations ---
# Small turns as vectors, and rotations: right-handed, rad.


def crossed(vectors: Array) -> Array:
    """(..., 3) -> (..., 3, 3) that multiplies another vector crosswise from the left."""
    out = np.zeros((*vectors.shape, 3))
    x, y, z = np.moveaxis(vectors, -1, 0)
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out


def turn_of(vector: Array) -> Array:
    """(3,) rad -> the rotation (3, 3) about it (Rodrigues)."""
    angle = float(np.sqrt(vector @ vector))
    K = crossed(vector)
    if angle < 1e-9:
        return np.asarray(np.eye(3) + K, np.float64)
    out: Array = np.eye(3) + np.sin(angle) / angle * K + (1.0 - np.cos(angle)) / angle**2 * K @ K
    return out


def turned_by(rotation: Array) -> Array:
    """The inverse: (3, 3) -> (3,) rad, less than half a turn."""
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    sine, cosine = 0.5 * float(np.sqrt(axis @ axis)), 0.5 * float(np.trace(rotation) - 1.0)
    angle = float(np.arctan2(sine, cosine))
    out: Array = 0.5 * axis * (angle / sine if sine > 1e-9 else 1.0)
    return out


# --- bundle adjustment ---

HUBER = 4.0  # of a tag's eight residuals, whose mean length is 2.8
PASSES = 40
DONE = 1e-7  # of the cost
OWN = 7  # unknowns of a tag: shift (3), turn (3), logarithm of its size
WEAKEST, STRONGEST = 1e-6, 1e9  # damping, of the diagonal
CORNERS = np.array(ORDER)  # half sides


class SurveyFrame(NamedTuple):
    """The tags of one picture, and the focal length at its lens position."""

    f_px: float
    width_px: int
    tags: tuple[SeenTag, ...]


class Tags(NamedTuple):
    """Tags in the world; rotation's columns are right, up and out, as seen."""

    ids: tuple[int, ...]
    middle_m: Array  # (n, 3)
    rotation: Array  # (n, 3, 3)


class Prior(NamedTuple):
    """What is known beforehand of tags (n of them): standard deviations along and about `axes`; inf: nothing."""

    tags: Tags
    axes: Array  # (n, 3, 3) columns
    sigma_m: Array  # (n, 3)
    sigma_rad: Array  # (n, 3)
    size: float  # relative, of each print
    focal: float  # relative


class Cameras(NamedTuple):
    """World to camera (right, down, forward), of the point where its rays meet."""

    rotation: Array  # (m, 3, 3)
    shift_m: Array  # (m, 3)


class Bundle(NamedTuple):
    tags: Tags
    covariance: Array  # (n, 6, 6) of shift (m) and of turn (rad) about the world's axes
    cameras: Cameras
    misfit_px: float  # rms of a corner's coordinate
    doubtful: Array  # (tags seen,) length of each one's whitened residual
    seen: Array  # (tags seen, 2) number of the frame, of the tag


class _State(NamedTuple):
    cameras: Cameras
    tags: Tags
    size: Array  # (n,) logarithm, of the nominal one
    focal: float  # logarithm, of the calibrated one


class _System(NamedTuple):
    """One linearization; the last unknown is the focal length's."""

    cost: float
    reduced: Array  # (7 n + 1, 7 n + 1), cameras eliminated
    right: Array  # (7 n + 1,)
    own: Array  # (m, 6, 6) of each camera
    own_right: Array  # (m, 6)
    mixed: Array  # (m, 6, 7 n + 1)
    residual_px: Array  # (k, 8)
    length: Array  # (k,)


def bundle(frames: Sequence[SurveyFrame], cameras: Cameras, prior: Prior, size_m: float) -> Bundle:
    """Adjust from where `prior.tags` and `cameras` (one a frame) say. Tags that the prior lacks do not count.

    Where corners are noisier than is known of them, by motion or by a calibration that is off, all is adjusted again
    with as much noise as they show: the prior counts for more then, and what is found is less sure.
    """
    problem = _Problem(frames, prior, size_m)
    state, here = _adjusted(problem, _State(cameras, prior.tags, np.zeros(len(prior.tags.ids)), 0.0))
    if (times := problem.noisier(here)) > 1.0:
        problem.whiten /= times
        state, here = _adjusted(problem, state)
    covariance = np.linalg.inv(here.reduced)
    at = [slice(OWN * k, OWN * k + 6) for k in range(len(prior.tags.ids))]
    return Bundle(
        state.tags,
        np.array([covariance[one, one] for one in at]),
        state.cameras,
        float(np.sqrt((here.residual_px**2).mean())),
        here.length,
        np.column_stack([problem.frame, problem.tag]),
    )


def _adjusted(problem: _Problem, state: _State) -> tuple[_State, _System]:
    """Levenberg and Marquardt from a state on."""
    here, damping = problem.linearize(state), 1e-3
    for _ in range(PASSES):
        moved = problem.moved(state, here, damping)
        there = problem.linearize(moved)
        if not there.cost < here.cost:
            damping *= 10.0
            if damping > STRONGEST:
                break
            continue
        done = here.cost - there.cost < DONE * here.cost
        state, here, damping = moved, there, max(0.1 * damping, WEAKEST)
        if done:
            break
    return state, here


class _Problem:
    """What does not change from pass to pass."""

    def __init__(self, frames: Sequence[SurveyFrame], prior: Prior, size_m: float) -> None:
        number = {one: k for k, one in enumerate(prior.tags.ids)}
        seen = [(m, number[tag.id], tag) for m, one in enumerate(frames) for tag in one.tags if tag.id in number]
        self.frame = np.array([m for m, _, _ in seen])
        self.tag = np.array([k for _, k, _ in seen])
        self.slopes = np.array([tag.corners for _, _, tag in seen])  # (k, 4, 2)
        self.f_px = np.array([frames[m].f_px for m, _, _ in seen])[:, None, None]
        self.whiten = np.array([whitener(tag, frames[m].f_px, frames[m].width_px) for m, _, tag in seen])  # (k, 8, 8)
        self.prior, self.half_m = prior, 0.5 * size_m

    def linearize(self, at: _State) -> _System:
        tags, m, n = at.tags, len(at.cameras.rotation), len(at.tags.ids)
        turn = at.cameras.rotation[self.frame]  # (k, 3, 3)
        arm = (
            self.half_m
            * np.exp(at.size[self.tag])[:, None, None]
            * (CORNERS @ tags.rotation[self.tag][:, :, :2].transpose(0, 2, 1))
        )  # (k, 4, 3) from the tag's middle, world
        point = (tags.middle_m[self.tag][:, None] + arm) @ turn.transpose(0, 2, 1)
        point = point + at.cameras.shift_m[self.frame][:, None]
        depth = np.maximum(point[..., 2], 1e-3)
        slope = point[..., :2] / depth[..., None]
        scale = self.f_px * np.exp(at.focal)
        residual = (self.f_px * self.slopes - scale * slope).reshape(-1, 8)
        by_point = np.zeros((*slope.shape, 3))  # (k, 4, 2, 3)
        by_point[..., 0, 0] = by_point[..., 1, 1] = 1.0
        by_point[..., 2] = -slope
        by_point *= (scale / depth[..., None])[..., None]
        by_world = by_point @ turn[:, None]
        columns = [  # of what is predicted, (k, 4, 2, .)
            -by_point @ crossed(point), by_point, by_world, -by_world @ crossed(arm),
            by_world @ arm[..., None], (scale * slope)[..., None],
        ]  # fmt: skip
        jacobian = self.whiten @ np.concatenate(columns, axis=-1).reshape(len(residual), 8, 14)
        white = np.einsum("kij,kj->ki", self.whiten, residual)
        length = np.sqrt((white * white).sum(axis=1))
        weight = np.minimum(1.0, HUBER / np.maximum(length, 1e-12))
        cost = float(np.where(length <= HUBER, 0.5 * length**2, HUBER * (length - 0.5 * HUBER)).sum())

        full = np.einsum("k,kai,kaj->kij", weight, jacobian, jacobian)
        right = np.einsum("k,kai,ka->ki", weight, jacobian, white)
        reduced, total = np.zeros((OWN * n + 1,) * 2), np.zeros(OWN * n + 1)
        own, own_right, mixed = np.zeros((m, 6, 6)), np.zeros((m, 6)), np.zeros((m, 6, OWN * n + 1))
        np.add.at(own, self.frame, full[:, :6, :6])
        np.add.at(own_right, self.frame, right[:, :6])
        for k, (frame, tag) in enumerate(zip(self.frame, self.tag, strict=True)):
            where = np.r_[OWN * tag : OWN * (tag + 1), OWN * n]
            mixed[frame][:, where] += full[k, :6, 6:]
            reduced[np.ix_(where, where)] += full[k, 6:, 6:]
            total[where] += right[k, 6:]
        cost += self._add_priors(at, reduced, total)
        solved = np.linalg.solve(own + 1e-9 * np.eye(6), np.concatenate([mixed, own_right[..., None]], axis=-1))
        reduced -= np.einsum("mai,maj->ij", mixed, solved[..., :-1], optimize=True)
        total -= np.einsum("mai,ma->i", mixed, solved[..., -1], optimize=True)
        return _System(cost, reduced, total, own, own_right, mixed, residual, length)

    def noisier(self, here: _System) -> float:
        """How many times noisier than they should be corners are, by the robust sum of their residuals."""
        free = 8 * len(here.length) - 6 * len(here.own) - len(here.right)
        weight = np.minimum(1.0, HUBER / np.maximum(here.length, 1e-12))
        return float(np.sqrt((weight * here.length**2).sum() / max(free, 1)))

    def _add_priors(self, at: _State, reduced: Array, total: Array) -> float:
        """Adds them to the equations; returns their cost."""
        prior, cost = self.prior, 0.0
        for k in range(len(at.tags.ids)):
            axes = prior.axes[k]
            away = np.concatenate(
                [
                    axes.T @ (at.tags.middle_m[k] - prior.tags.middle_m[k]),
                    axes.T @ turned_by(at.tags.rotation[k] @ prior.tags.rotation[k].T),
                    at.size[k : k + 1],
                ]
            )
            weight = np.concatenate([prior.sigma_m[k], prior.sigma_rad[k], [prior.size]]) ** -2.0
            along = np.zeros((OWN, OWN))
            along[:3, :3] = along[3:6, 3:6] = axes
            along[6, 6] = 1.0
            where = slice(OWN * k, OWN * (k + 1))
            reduced[where, where] += along @ np.diag(weight) @ along.T
            total[where] -= along @ (weight * away)
            cost += 0.5 * float(weight @ away**2)
        reduced[-1, -1] += prior.focal**-2.0
        total[-1] -= at.focal * prior.focal**-2.0
        return cost + 0.5 * (at.focal / prior.focal) ** 2

    def moved(self, at: _State, here: _System, damping: float) -> _State:
        """One step of Levenberg and Marquardt from there."""
        damped = here.reduced + damping * np.diag(np.diag(here.reduced))
        step = np.linalg.solve(damped, here.right)
        back = here.own_right - here.mixed @ step
        camera = np.linalg.solve(here.own + 1e-9 * np.eye(6), back[..., None])[..., 0]
        tag = step[:-1].reshape(-1, OWN)
        about = np.array([turn_of(one) for one in camera[:, :3]])
        cameras = Cameras(
            about @ at.cameras.rotation, np.einsum("mij,mj->mi", about, at.cameras.shift_m) + camera[:, 3:]
        )
        rotation = np.array([turn_of(one) for one in tag[:, 3:6]]) @ at.tags.rotation
        tags = Tags(at.tags.ids, at.tags.middle_m + tag[:, :3], rotation)
        return _State(cameras, tags, at.size + tag[:, 6], at.focal + float(step[-1]))


def whitener(tag: SeenTag, f_px: float, width_px: int) -> Array:
    """(8, 8) that makes the noise of a tag's corners, px, white: that of projection.py without the survey's part."""
    flat = f_px * np.array(tag.corners)
    offset_px = OFFSET_PX + BENT_PX * (tag.rho_px / (EDGE_AT * width_px)) ** 3
    stretch = STRETCH * (flat - flat.mean(axis=0)).ravel()
    variance = (EDGE_PX if tag.edges else FOUND_PX) ** 2 * np.eye(8) + np.outer(stretch, stretch)
    variance += offset_px**2 * np.kron(np.ones((4, 4)), np.eye(2))
    out: Array = np.linalg.inv(np.linalg.cholesky(variance))
    return out
