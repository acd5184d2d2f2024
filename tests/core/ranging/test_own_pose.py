"""An uncertain pose in what is said of a target: derivatives by differences, kappa by the sum whose limit it is."""

import math

import numpy as np
import pytest

from agent.core.config import Body, Pose
from agent.core.ranging.camera_model import camera_pose, to_world
from agent.core.ranging.fix import TAU_OF_GAP, TAU_S, carried, kappa, longest_gap_s

P = (4e-6, 1e-6, 2e-6, 9e-6, -3e-6, 2.5e-5)


def full(symmetric):
    xx, xy, xz, yy, yz, zz = symmetric
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def target(pose):
    """Where a robot at (x, y, psi) would say that a thing is which its camera has at the same place."""
    x, y, psi = map(float, pose)
    at = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(psi))
    eye = camera_pose(at, Body(camera_m=(0.1, 0.02, -0.01)), 0.3, 1.5, -2.0, 20.0, -15.0, 0.6)
    return np.array(to_world(eye, (0.05, 0.10, 0.70)))


def test_an_uncertain_pose_is_carried_to_the_target() -> None:
    pose, h = np.array([0.6, 0.8, 0.7]), 1e-6
    J = np.stack([(target(pose + d) - target(pose - d)) / (2 * h) for d in h * np.eye(3)], axis=1)
    arm = tuple((target(pose) - [0.6, 0.8, 0.3]).tolist())
    np.testing.assert_allclose(full(carried(arm, P)), J @ full(P) @ J.T, atol=1e-13)


@pytest.mark.parametrize("dt_s", [0.2, 1.0, 3.0])
def test_kappa_is_what_n_samples_lose_by_being_alike(dt_s) -> None:
    """The variance of the mean of n AR(1) samples, summed up, against its closed form."""
    gap_s = 2.0
    phi, worse = math.exp(-dt_s / (TAU_S + TAU_OF_GAP * gap_s)), kappa(dt_s, gap_s)
    for n in (1, 7, 60):
        lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        summed = np.sum(phi**lag) / n  # n Var(mean) / P
        assert summed == pytest.approx(worse - 2.0 * phi * (1.0 - phi**n) / (n * (1.0 - phi) ** 2))
        assert summed <= worse
    assert summed > 0.85 * worse


def test_samples_far_apart_are_independent_and_gaps_make_them_alike() -> None:
    assert kappa(60.0, 0.2) == pytest.approx(1.0)
    assert kappa(1.0, 4.0) > kappa(1.0, 0.2) > 1.0


def test_gaps_are_those_of_the_last_seconds() -> None:
    s = 1_000_000_000
    assert longest_gap_s([], 100 * s) == pytest.approx(10.0)
    assert longest_gap_s([80 * s, 93 * s, 94 * s, 98 * s], 100 * s) == pytest.approx(4.0)
    assert longest_gap_s([91 * s, 92 * s, 93 * s, 94 * s, 95 * s], 100 * s) == pytest.approx(5.0)
