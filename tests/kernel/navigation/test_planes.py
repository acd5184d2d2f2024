"""Odometry on the floor: points of a known floor, seen before and after a known move."""

import numpy as np
import pytest

from agent.kernel.navigation.body_model import Hull
from agent.kernel.navigation.planes import FARTHEST_M, FEWEST, odometry
from agent.kernel.navigation.pose_filter import Drift, add_flow, begin, keep_key, predict
from tests.kernel.navigation.tank_with_tags import HALF, VIEW, project

THEN = (1.2, 0.9, 0.7, 0.30, 0.02, -0.015, 0.2, -0.7)
NOW = (1.26, 0.87, 0.78, 0.32, -0.01, 0.02, 0.1, -0.75)


def moved(then=THEN, now=NOW):
    """(x, y, psi) of the second in the frame of the first."""
    c, s = np.cos(then[2]), np.sin(then[2])
    return np.r_[np.array([[c, s], [-s, c]]) @ np.subtract(now, then)[:2], now[2] - then[2]]


def pairs_of(rng, n=64, then=THEN, now=NOW, noise_px=0.0):
    """Slopes (n, 4) of points that lie on the floor in both pictures."""
    points = np.c_[rng.uniform([1.1, 0.9], [1.9, 1.7], (4000, 2)), np.zeros(4000)]
    (a, far_a), (b, far_b) = project(then, points), project(now, points)
    seen = (np.abs(a) < HALF).all(axis=1) & (np.abs(b) < HALF).all(axis=1) & (far_a > 0.1) & (far_b > 0.1)
    both = np.c_[a, b][seen & (far_a < 0.9) & (far_b < 0.9)][:n]
    assert len(both) == n
    return both + rng.normal(0.0, 1.0, both.shape) * noise_px / VIEW.f_px


def odometry_of(pairs, then=THEN, now=NOW):
    free = lambda theta: (0.0, 0.0, 0.0, *theta[3:])  # noqa: E731
    return odometry(VIEW, free(then), free(now), [tuple(map(float, pair)) for pair in pairs])


def test_a_move_is_found_exactly() -> None:
    found = odometry_of(pairs_of(np.random.default_rng(0)))
    np.testing.assert_allclose(found.pose, moved(), atol=1e-12)
    assert found.pairs >= FEWEST
    np.testing.assert_allclose(found.sigma_m, np.hypot(0.002, 0.008 * np.hypot(*moved()[:2])))


def test_points_that_were_mistaken_do_no_harm() -> None:
    rng = np.random.default_rng(1)
    pairs = pairs_of(rng, noise_px=0.3)
    pairs[:20, 2:] += rng.uniform(-0.1, 0.1, (20, 2))
    found = odometry_of(pairs)
    assert found.pairs <= 50
    np.testing.assert_allclose(found.pose[:2], moved()[:2], atol=0.001)
    np.testing.assert_allclose(found.pose[2], moved()[2], atol=0.002)


def test_errors_are_no_larger_than_said() -> None:
    """Level noise of 0.05 degrees in each frame, depth of 0.7 mm, gimbal of 0.02 degrees, corners of 0.3 px."""
    rng, ratios = np.random.default_rng(2), []
    for _ in range(40):
        pairs = pairs_of(rng, noise_px=0.3)
        wrong = [
            np.add(theta, np.r_[np.zeros(3), rng.normal(0.0, [0.0007, *np.radians([0.05, 0.05, 0.02, 0.02])])])
            for theta in (THEN, NOW)
        ]
        found = odometry_of(pairs, *map(tuple, wrong))
        off = np.subtract(found.pose, moved())
        ratios.append([*(off[:2] / found.sigma_m), off[2] / found.sigma_rad])
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all(rms < 1.3) and np.all(rms > 0.2)


@pytest.mark.parametrize(
    ("pairs", "why"),
    [
        (lambda all_: all_[: FEWEST - 1], "too few"),
        (lambda all_: np.tile([0.0, -0.9, 0.0, -0.9], (40, 1)), "above the horizon"),
        (lambda all_: np.random.default_rng(3).uniform(-0.2, 0.2, (64, 4)), "nothing agrees"),
    ],
)
def test_there_is_no_odometry_without_points(pairs, why) -> None:
    assert odometry_of(pairs(pairs_of(np.random.default_rng(0)))) is None


def test_the_floor_far_away_does_not_count() -> None:
    up = (*THEN[:7], -0.1)  # the horizon is in the picture, and the floor before it beyond the limit
    pairs = pairs_of(np.random.default_rng(0))
    assert odometry_of(pairs, up, up) is None and (VIEW.surface_m - THEN[3]) / np.sin(0.1 + 0.1) > FARTHEST_M


def test_increments_from_frame_to_frame_are_worse() -> None:
    """The same odometry ten times from one key frame, and ten times from the frame before."""
    P = (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6)
    begun = begin(0, (0.0, 0.0, 0.0), P)
    from_key = chained = keep_key(begun)
    for k in range(1, 11):
        from_key, chained = (predict(belief, Hull(), Drift(), 200_000_000 * k) for belief in (from_key, chained))
        from_key = add_flow(from_key, 0, (0.0, 0.0, 0.0), 0.002, 0.002)
        chained = keep_key(add_flow(chained, 200_000_000 * (k - 1), (0.0, 0.0, 0.0), 0.002, 0.002))
    assert np.sqrt(chained.P[0][0]) > 2.0 * np.sqrt(from_key.P[0][0])
