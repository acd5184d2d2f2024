"""Odometry on the planes of a tank: points of floor and walls, seen before and after a known move."""

from functools import cache

import numpy as np
import pytest

from agent.capabilities.swim.plane_odometry import FEWEST, Moved, meets, odometry
from agent.capabilities.swim.pose_filter import Drift, Hull, add_flow, begin, keep_key, predict
from agent.capabilities.swim.projection import upright
from tests.capabilities.swim.points_on_a_thing import without_tags
from tests.capabilities.swim.tank_with_tags import HALF, TANK_M, VIEW, project

BOX_M = (TANK_M[0], TANK_M[1], VIEW.surface_m)
DOWN = (1.2, 0.9, 0.7, 0.30, 0.02, -0.015, 0.2, -0.7), (1.26, 0.87, 0.78, 0.32, -0.01, 0.02, 0.1, -0.75)  # at the floor
AHEAD = (
    (1.2, 0.9, 0.7, 0.30, 0.02, -0.015, -0.15, -0.1),
    (1.26, 0.87, 0.78, 0.32, -0.01, 0.02, -0.2, -0.08),
)  # at a corner
WAYS = pytest.mark.parametrize("way", [DOWN, AHEAD], ids=["floor", "walls"])
SIGMA = np.r_[0.0007, np.radians([0.05, 0.05, 0.02, 0.02])]  # of depth, level and gimbal, in each frame


def moved(way):
    """(x, y, psi) of the second in the frame of the first."""
    then, now = way
    c, s = np.cos(then[2]), np.sin(then[2])
    return np.r_[np.array([[c, s], [-s, c]]) @ np.subtract(now, then)[:2], now[2] - then[2]]


def faces(rng, n):
    """Points (5 n, 3) of floor and walls."""
    points = rng.uniform(0.0, 1.0, (5, n, 3)) * BOX_M
    for face, (axis, at) in enumerate(((2, 0.0), (0, 0.0), (0, BOX_M[0]), (1, 0.0), (1, BOX_M[1]))):
        points[face, :, axis] = at
    return points.reshape(-1, 3)


@cache
def in_both(way):
    """Slopes (n, 4) of points that are in both pictures, each before nothing else."""
    points = faces(np.random.default_rng(8), 20000)
    (a, far_a), (b, far_b) = (project(theta, points) for theta in way)
    seen = (np.abs(a) < HALF).all(axis=1) & (np.abs(b) < HALF).all(axis=1) & (far_a > 0.1) & (far_b > 0.1)
    return np.c_[a, b][seen & (far_a < 2.5)]


def pairs_of(rng, way, n=64, noise_px=0.0):
    both = rng.permutation(in_both(way))[:n]
    assert len(both) == n
    return both + rng.normal(0.0, 1.0, both.shape) * noise_px / VIEW.f_px


def odometry_of(pairs, way, unsettled=0.0):
    return odometry(VIEW, *way, [tuple(map(float, pair)) for pair in pairs], BOX_M, unsettled)


def matrix(symmetric):
    xx, xy, xp, yy, yp, pp = symmetric
    return np.array([[xx, xy, xp], [xy, yy, yp], [xp, yp, pp]])


@WAYS
def test_a_move_is_found_exactly(way) -> None:
    then, now = way
    elsewhere = (*np.add(now[:3], (0.03, -0.02, 0.05)), *now[3:])  # where it is believed to be counts for nothing
    found = odometry_of(pairs_of(np.random.default_rng(0), way), (then, elsewhere))
    np.testing.assert_allclose(found.pose, moved(way), atol=1e-6)
    assert found.pairs > 60


@WAYS
def test_points_that_were_mistaken_do_no_harm(way) -> None:
    rng = np.random.default_rng(1)
    pairs = pairs_of(rng, way, noise_px=0.3)
    pairs[:20, 2:] += rng.uniform(-0.1, 0.1, (20, 2))
    found = odometry_of(pairs, way)
    assert found.pairs <= 50
    np.testing.assert_allclose(found.pose[:2], moved(way)[:2], atol=0.002)
    np.testing.assert_allclose(found.pose[2], moved(way)[2], atol=0.002)


def test_points_on_another_robot_are_left_out() -> None:
    """A third of them go with one that swims past in the middle of the picture."""
    now = AHEAD[1]
    pairs = pairs_of(np.random.default_rng(6), AHEAD, noise_px=0.3)
    x, y, psi = now[:3]
    bearing = psi + now[6]  # of the picture's middle: yaw and pan
    other_m = x + 1.8 * np.cos(bearing), y + 1.8 * np.sin(bearing), 0.3
    before_it = np.abs(pairs[:, 2]) < 0.09
    assert 15 < before_it.sum() < 40
    pairs[before_it, 2] += 0.03  # all alike: as if the robot had turned
    found = odometry(VIEW, *AHEAD, pairs.tolist(), BOX_M, 0.0, others_m=(other_m,))
    assert found.pairs <= 64 - before_it.sum()
    np.testing.assert_allclose(found.pose, moved(AHEAD), atol=0.004)
    near = pairs[before_it].tolist()  # as if there were no others
    led = odometry_of(near, AHEAD)
    assert isinstance(led, Moved) and np.abs(led.pose - moved(AHEAD)).max() > 0.02
    assert odometry(VIEW, *AHEAD, near, BOX_M, 0.0, others_m=(other_m,)) == "too few"
    behind_m = 2.0 * np.array(now[:2]) - other_m[:2]
    assert odometry(VIEW, *AHEAD, near, BOX_M, 0.0, others_m=((*behind_m, 0.3),)) == led


@pytest.mark.parametrize("share", [0.2, 0.4, 0.6, 0.7])
@WAYS
def test_points_on_a_thing_that_swims_are_left_out_where_the_motion_is_about_known(way, share) -> None:
    """Even where most of them lie on it, and agree with each other."""
    then, now = way
    expected = (*np.add(now[:3], (0.004, -0.003, 0.004)), *now[3:])
    pairs = pairs_of(np.random.default_rng(9), way, noise_px=0.2)
    on_it = round(share * len(pairs))
    pairs[:on_it, 2:] += (0.05, 0.02)
    found = odometry_of(pairs, (then, expected))
    assert len(pairs) - on_it - 4 <= found.pairs <= len(pairs) - on_it
    np.testing.assert_allclose(found.pose, moved(way), atol=0.003)


@WAYS
def test_errors_are_no_larger_than_said(way) -> None:
    """Points of 0.3 px; the place at the key frame is known to 4 mm an axis and 0.1 degrees."""
    rng, off, nees = np.random.default_rng(2), [], []
    for _ in range(30):
        key = rng.normal(0.0, [0.004, 0.004, 0.002])
        wrong = [tuple(np.add(theta, np.r_[key, rng.normal(0.0, SIGMA)])) for theta in way]
        found = odometry_of(pairs_of(rng, way, noise_px=0.3), wrong)
        off.append(np.subtract(found.pose, moved(way)))
        nees.append(off[-1] @ np.linalg.solve(matrix(found.covariance), off[-1]) / 3.0)
    rms = np.sqrt(np.mean(np.square(off), axis=0))
    assert rms[:2].max() < 0.003 and np.degrees(rms[2]) < 0.1
    assert 0.1 < np.mean(nees) < 1.3


@WAYS
def test_a_body_that_heels_as_it_is_pushed_does_not_seem_to_turn(way) -> None:
    """Its level is off by 0.3 degrees in the second frame, to each side, ahead or back."""
    then, now = way
    for roll_deg, pitch_deg in ((0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.2, -0.2)):
        heeled = (*now[:4], now[4] + np.radians(roll_deg), now[5] + np.radians(pitch_deg), *now[6:])
        found = odometry_of(pairs_of(np.random.default_rng(5), way, noise_px=0.3), (then, heeled))
        off = np.subtract(found.pose, moved(way))
        assert abs(np.degrees(off[2])) < 0.1
        assert off @ np.linalg.solve(matrix(found.covariance), off) < 16.0


def test_a_gimbal_that_settles_errs_in_yaw_alone() -> None:
    then, now = AHEAD
    tilted = (*now[:6], now[6] + 0.005, now[7] - 0.005)
    found = odometry_of(pairs_of(np.random.default_rng(4), AHEAD), (then, tilted), unsettled=0.005)
    off = np.subtract(found.pose, moved(AHEAD))
    assert np.abs(off[:2]).max() < 0.003 and off[2] == pytest.approx(-0.005, abs=0.001)
    assert np.sqrt(found.covariance[5]) > 0.005


@pytest.mark.parametrize(
    ("pairs", "why"),
    [
        (lambda all_: all_[: FEWEST - 1], "too few"),
        (lambda all_: np.tile([0.0, -0.9, 0.0, -0.9], (40, 1)), "too few"),  # at the surface
        (lambda all_: np.random.default_rng(3).uniform(-0.2, 0.2, (64, 4)), "contrary"),
    ],
)
def test_there_is_no_odometry_without_points(pairs, why) -> None:
    assert odometry_of(pairs(pairs_of(np.random.default_rng(0), AHEAD)), AHEAD) == why


# Most of them taken for the floor would turn a robot by 30 degrees and more, which then says that it knows its place.
SEEDS = range(6)


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_points_on_a_thing_lead_no_robot_astray(share) -> None:
    runs = np.array([without_tags(seed, share, 3.0, push_n=1.0) for seed in SEEDS])
    assert np.sqrt(np.mean(np.square(runs[..., 0]))) < 0.006, "m"
    assert np.degrees(np.sqrt(np.mean(np.square(runs[..., 1])))) < 0.3
    assert np.mean(runs[..., 3]) < 1.3


@pytest.mark.parametrize("share", [0.8, 1.0])
def test_a_robot_that_sees_hardly_anything_but_a_thing_says_that_it_does_not_know(share) -> None:
    runs = np.array([without_tags(seed, share, 4.0, push_n=1.0) for seed in SEEDS])
    assert np.mean(runs[..., 3]) < 1.3 and runs[..., 3].max() < 5.4  # one in a thousand
    assert np.degrees(np.sqrt(np.mean(np.square(runs[..., 1])))) < 6.0


def test_a_ray_meets_what_it_shows() -> None:
    """In the frame of the upright body, whatever the yaw."""
    theta = AHEAD[0]
    points = faces(np.random.default_rng(5), 200)
    slopes, far = project(theta, points)
    seen = (np.abs(slopes) < HALF).all(axis=1) & (far > 0.1) & (far < 2.0)
    c, s = np.cos(theta[2]), np.sin(theta[2])
    eye, kinds = upright(VIEW, theta), set()
    for slope, point in zip(slopes[seen], points[seen], strict=True):
        ahead, left, up = meets(eye, theta, tuple(slope), BOX_M)
        there = (theta[0] + c * ahead - s * left, theta[1] + s * ahead + c * left, up)
        np.testing.assert_allclose(there, point, atol=1e-9)
        kinds.add(tuple(np.flatnonzero(np.isclose(point, 0.0) | np.isclose(point, BOX_M))))
    assert len(kinds) == 3  # floor and two walls


def test_increments_from_frame_to_frame_are_worse() -> None:
    """The same odometry ten times from one key frame, and ten times from the frame before."""
    P_FLOW = (4e-6, 0.0, 0.0, 4e-6, 0.0, 4e-6)
    P = (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6)
    begun = begin(0, (0.0, 0.0, 0.0), P)
    from_key = chained = keep_key(begun)
    for k in range(1, 11):
        from_key, chained = (predict(belief, Hull(), Drift(), 200_000_000 * k) for belief in (from_key, chained))
        from_key = add_flow(from_key, 0, (0.0, 0.0, 0.0), P_FLOW)
        chained = keep_key(add_flow(chained, 200_000_000 * (k - 1), (0.0, 0.0, 0.0), P_FLOW))
    assert np.sqrt(chained.P[0][0]) > 2.0 * np.sqrt(from_key.P[0][0])
