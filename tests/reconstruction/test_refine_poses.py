"""Bundle adjustment against differences, errors that come back whole, and matches that are wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agent.reconstruction.matches import Corners, Matches
from agent.reconstruction.pose_evidence import apart, between, by_motion, moved_about
from agent.reconstruction.refine_poses import (
    DAMPING,
    FOCUS_SHARED,
    VIEW_SIGMA,
    Loss,
    Prior,
    State,
    certainty_of,
    first_state,
    information_of,
    normal_of,
    step,
)
from agent.reconstruction.views import View, moved, project, rotation_of, stacked, surface_points, to_camera
from tests.reconstruction.a_plane import CAMERA, some_views

LOSS = Loss(2.0, 0.5)
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


def test_the_pull_is_the_slope_of_the_cost() -> None:
    true = some_views()
    corners, matches = seen(true)
    off = [moved(view, RNG.normal(0, 2e-3, 3), RNG.normal(0, 1e-3, 3)) for view in true]
    stack, prior = stacked(off), Prior(information_of(off), 1.0 / corners.depth_m, certainty_of(off, corners))
    state, h = first_state(stack, corners, prior), 1e-6
    for _ in range(2):  # from where poses are not where priors have them, and depths not where focus has them
        state, _ = step(stack, corners, matches, prior, state, LOSS)
    state = state._replace(inverse=state.inverse * RNG.normal(1.0, 2e-3, len(state.inverse)))
    views = len(true)
    normal, _, _ = normal_of(stack, corners, matches, prior, state, LOSS)

    def cost(xi: np.ndarray, further: np.ndarray) -> float:
        turned = np.array([r @ rotation_of(w) for r, w in zip(state.rotations, xi[:views, :3], strict=True)])
        gone = state.positions_m + np.einsum("nij,nj->ni", state.rotations, xi[:views, 3:])
        there = State(turned, gone, state.gone + xi, state.inverse + further)
        return normal_of(stack, corners, matches, prior, there, LOSS)[2]

    still, none = np.zeros_like(state.gone), np.zeros(len(state.inverse))
    # Corners were eliminated from the pull: what they take of it is put back.
    taken = np.where(normal.curve > 0, normal.tug / np.maximum(normal.curve, 1e-12), 0.0)
    pull = normal.pull.reshape(-1, 6).copy()
    np.add.at(pull, corners.owner, normal.of_corner * taken[:, None])
    np.add.at(pull, matches.other, normal.of_match * taken[matches.corner, None])
    for n, i in ((0, 0), (1, 2), (3, 4), (4, 5), (5, 1), (views, 1), (views + 2, 4)):  # the last two are of robots
        xi = still.copy()
        xi[n, i] = h
        assert (cost(-xi, none) - cost(xi, none)) / (2 * h) == pytest.approx(pull[n, i], rel=1e-4, abs=1.0)
    for c in np.nonzero(normal.curve)[0][:3]:
        further = none.copy()
        further[c] = h
        assert (cost(still, -further) - cost(still, further)) / (2 * h) == pytest.approx(normal.tug[c], rel=1e-4)


@pytest.mark.parametrize("wrong", [0.0, 0.25], ids=["all right", "a quarter wrong"])
def test_poses_come_back_whole(wrong: float) -> None:
    true = some_views()
    corners, matches = seen(true, wrong)
    off = lost(true)
    # What is measured here has no errors, so that priors would only be in its way; focus says how large everything is.
    sure = np.full(len(corners.owner), 1e6)
    stack, prior = stacked(off), Prior(1e-6 * information_of(off), 1.0 / corners.depth_m, sure)
    state = first_state(stack, corners, prior)
    for scale in (8.0, 8.0, 4.0, 4.0, 2.0, 1.0, 0.3, 0.1, 0.1, 0.1):
        state, off_px = step(stack, corners, matches, prior, state, Loss(scale, 0.5))
    placed = zip(off, state.rotations, state.positions_m, strict=True)
    found = [replace(view, rotation=rotation, position_m=place) for view, rotation, place in placed]
    motion = between(found, true)
    metres, radians = apart([by_motion(view, motion) for view in found], true)
    assert metres.max() < 2e-5 and np.degrees(radians.max()) < 2e-3
    assert np.quantile(off_px, 0.7) < 0.01


def test_a_step_is_what_the_whole_matrix_says() -> None:
    true = some_views()
    corners, matches = seen(true)
    near = np.abs(corners.owner[matches.corner] - matches.other) == 1  # a chain: its ends have nothing in common
    matches = Matches(*(field[near] for field in matches))
    off = lost(true)
    stack, prior = stacked(off), Prior(information_of(off), 1.0 / corners.depth_m, certainty_of(off, corners))
    state = first_state(stack, corners, prior)
    normal, sparse, _ = normal_of(stack, corners, matches, prior, state, LOSS)
    whole = sparse.toarray()
    np.testing.assert_allclose(whole, whole.T, rtol=1e-9, atol=1e-6)
    assert whole[:6, 12:18].any() and not whole[:6, 18:36].any()
    whole[np.diag_indices(len(whole))] *= 1.0 + DAMPING
    moves = np.linalg.solve(whole, normal.pull).reshape(-1, 6)
    gone = step(stack, corners, matches, prior, state, LOSS)[0].gone
    np.testing.assert_allclose(gone, moves, rtol=1e-6, atol=1e-10)


def test_views_of_a_robot_share_their_error() -> None:
    views = some_views()
    covariance = np.linalg.inv(information_of(views).toarray())
    assert covariance[:6, 12:18].max() == pytest.approx(0.0, abs=1e-9)  # of other robots: nothing
    both = [slice(0, 6), slice(6, 12)]
    own = np.diag(covariance[both[0], both[0]])
    assert own[:3].min() > views[0].pose_covariance[0, 0]
    difference = covariance[both[0], both[0]][:3, :3].trace() - covariance[both[0], both[1]][:3, :3].trace()
    assert difference < 0.2 * own[:3].sum()
    assert own[3:].min() > VIEW_SIGMA[1] ** 2


def test_a_robots_focus_is_wrong_in_all_of_its_depths_together() -> None:
    views = some_views()
    count = 5000
    many = Corners(
        np.repeat([0, 1, 2], count), np.zeros((3 * count, 2)), np.full(3 * count, 0.5), np.full(3 * count, 5e-3)
    )
    relative = certainty_of(views, many) / 0.5**2
    assert relative[: 2 * count].sum() == pytest.approx(FOCUS_SHARED**-2)  # r1's, in two views
    few = Corners(*(field[:5] for field in many))
    assert certainty_of(views, few) == pytest.approx((0.5**2 / 5e-3) ** 2)
