"""Bundle adjustment against differences, errors that come back whole, and matches that are wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agent.reconstruction.matches import Corners, Matches
from agent.reconstruction.pose_evidence import apart, between, by_motion, moved_about
from agent.reconstruction.refine_poses import (
    FOCUS_SCALE,
    FOCUS_SHARED,
    Bundle,
    bundle_of,
    errors_of,
    focus_sigma,
)
from agent.reconstruction.views import VIEW_SIGMA, View, diagonal_prior, project, stacked, surface_points, to_camera
from tests.reconstruction.a_plane import CAMERA, some_views

RNG = np.random.default_rng(11)


def seen(true: list[View], wrong: float = 0.0) -> tuple[Corners, Matches]:
    """Forty corners of each view, and where all others that see them truly have them; a share is anywhere else."""
    at = np.stack([RNG.integers(8, 152, (len(true), 40)), RNG.integers(8, 112, (len(true), 40))], axis=-1)
    owner, pixel = np.repeat(np.arange(len(true)), 40), at.reshape(-1, 2)
    depth = np.array([true[n].depth_m[v, u] for n, (u, v) in zip(owner, pixel, strict=True)], float)
    places = np.array([surface_points(true[n])[v, u] for n, (u, v) in zip(owner, pixel, strict=True)])
    there = np.stack([project(CAMERA, to_camera(view, places)) for view in true], axis=1)
    with np.errstate(invalid="ignore"):
        inside = ((there > 2.0) & (there < np.array([CAMERA.width, CAMERA.height]) - 3.0)).all(axis=-1)
    inside[np.arange(len(owner)), owner] = False
    corner, other = np.nonzero(inside)
    found = there[corner, other]
    astray = RNG.random(len(found)) < wrong
    found[astray] += RNG.uniform(-20.0, 20.0, (int(astray.sum()), 2))
    return Corners(owner, pixel.astype(float), depth, np.full(len(depth), 4e-3)), Matches(corner, other, found)


def lost(true: list[View]) -> list[View]:
    errors = {r: (RNG.normal(0, np.radians(0.5), 3), RNG.normal(0, 3e-3, 3)) for r in ("r1", "r2", "r3")}
    return [moved_about(view, np.array([0.0, 0.0, 0.0]), *errors[view.robot]) for view in true]


def bundle(true: list[View], off: list[View], wrong: float = 0.0) -> Bundle:
    corners, matches = seen(true, wrong)
    return bundle_of(stacked(off), corners, matches, errors_of(off), focus_sigma(off, corners), 0.5)


def cost(some: Bundle, x: np.ndarray, scale_px: float) -> float:
    poses, depths = some.parts(x)
    off = some.off_px(x)
    matches = (scale_px / some.sigma_px) ** 2 * np.log1p((off / scale_px) ** 2).sum()
    return 0.5 * float(matches + FOCUS_SCALE**2 * np.log1p((depths / FOCUS_SCALE) ** 2).sum() + poses @ poses)


def test_the_jacobian_is_what_central_differences_say() -> None:
    true = some_views()
    some = bundle(true, lost(true))
    x, h = RNG.normal(0.0, 1.0, some.errors.shape[1] + len(some.sigma)), 1e-6
    at = some.moved(x)
    by_view, by_corner = some.jacobian(at, some.points(at))
    for toward in RNG.normal(0.0, 1.0, (5, len(x))):
        poses, depths = some.parts(toward)
        ends = [some.points(some.moved(x + s * h * toward)).off_px.ravel() for s in (1.0, -1.0)]
        change = by_view @ (some.errors @ poses) + by_corner @ depths
        np.testing.assert_allclose(change, (ends[0] - ends[1]) / (2 * h), rtol=1e-5, atol=1e-6)


def test_steps_end_where_the_cost_is_least() -> None:
    true = some_views()
    some = bundle(true, lost(true))
    x, h = np.zeros(some.errors.shape[1] + len(some.sigma)), 1e-4
    costs = [cost(some, x, 2.0)]
    for _ in range(25):
        x = some.step(x, 2.0)
        costs.append(cost(some, x, 2.0))
    assert costs[-1] < 0.1 * costs[0]
    for toward in RNG.normal(0.0, 1.0, (5, len(x))):
        up, down = (cost(some, x + s * h * toward, 2.0) for s in (1.0, -1.0))
        assert up > costs[-1] and down > costs[-1]
        assert abs(up - down) < 0.01 * (up + down - 2 * costs[-1])


@pytest.mark.parametrize("wrong", [0.0, 0.25], ids=["all right", "a quarter wrong"])
def test_poses_come_back_whole(wrong: float) -> None:
    true = some_views()
    off = lost(true)
    some = bundle(true, off, wrong)
    # What is measured here has no errors, so that priors would only be in its way; focus says how large everything is.
    poses, sure = 1e3 * errors_of(off), np.full(len(some.corners.owner), 1e-3)
    some = bundle_of(some.stack, some.corners, some.matches, poses, sure, 0.5)
    x = np.zeros(some.errors.shape[1] + len(sure))
    for scale in (8.0, 8.0, 4.0, 4.0, 2.0, 1.0, 0.3, 0.1, 0.1, 0.1):
        x = some.step(x, scale)
    at = some.moved(x)
    placed = zip(off, at.rotations, at.positions_m, strict=True)
    found = [replace(view, rotation=rotation, position_m=place) for view, rotation, place in placed]
    motion = between(found, true)
    metres, radians = apart([by_motion(view, motion) for view in found], true)
    assert metres.max() < 2e-5 and np.degrees(radians.max()) < 2e-3
    assert np.quantile(some.off_px(x), 0.7) < 0.01


def test_views_of_a_robot_share_their_error() -> None:
    views = some_views()
    errors = errors_of(views).toarray()
    covariance = errors @ errors.T
    assert covariance[:6, 12:18].max() == pytest.approx(0.0, abs=1e-9)  # of other robots: nothing
    both = [slice(0, 6), slice(6, 12)]
    own = np.diag(covariance[both[0], both[0]])
    assert own[:3].min() > views[0].pose_covariance[0, 0]
    difference = covariance[both[0], both[0]][:3, :3].trace() - covariance[both[0], both[1]][:3, :3].trace()
    assert difference < 0.2 * own[:3].sum()
    assert own[3:].min() > VIEW_SIGMA[1] ** 2


def test_a_robot_that_swims_is_wrong_anew_in_each_view() -> None:
    fixed, alone = diagonal_prior(1e-4, 1e-4), diagonal_prior(np.radians(1.0), 5e-3)
    views = [replace(view, pose_covariance=fixed, own_covariance=alone) for view in some_views()]
    errors = errors_of(views).toarray()
    covariance = errors @ errors.T
    assert np.allclose(covariance[:6, :6], alone, atol=1e-6)
    assert np.abs(covariance[:6, 6:12]).max() < 1e-2 * alone.min(where=alone > 0, initial=1.0)


def test_a_robots_focus_is_wrong_in_all_of_its_depths_together() -> None:
    views = some_views()
    count = 5000
    many = Corners(
        np.repeat([0, 1, 2], count), np.zeros((3 * count, 2)), np.full(3 * count, 0.5), np.full(3 * count, 5e-3)
    )
    relative = focus_sigma(views, many) ** -2
    assert relative[: 2 * count].sum() == pytest.approx(FOCUS_SHARED**-2)  # r1's, in two views
    few = Corners(*(field[:5] for field in many))
    assert focus_sigma(views, few) == pytest.approx(5e-3 / 0.5)
