"""The worlds and bounds of the localization experiment against formulas."""

import math

import numpy as np
import pytest

from agent.experiments.localization.draws import bound_m, central_m, central_track_m, closed_form_m
from agent.experiments.localization.lockstep import (
    TARGET_M,
    Dive,
    circle_m,
    diameter,
    draw_dive,
    draw_world,
    graph,
    metropolis_weights,
    paper_weights,
    seen,
)

TYPICAL = np.random.default_rng(1)


@pytest.mark.parametrize("topology", ["full", "ring", "line", "geometric"])
@pytest.mark.parametrize("robots", [3, 10, 100])
def test_graphs_are_symmetric_and_connected(topology, robots) -> None:
    near = graph(topology, robots)
    assert all(i in near[j] and i != j for i in range(robots) for j in near[i])
    assert diameter(near) < math.inf
    assert paper_weights(near).sum(axis=1) == pytest.approx(1.0)
    W = metropolis_weights(near)
    assert W.sum(axis=0) == pytest.approx(1.0)
    assert W.sum(axis=1) == pytest.approx(1.0)


def test_the_hard_graph_is_sparse_and_long() -> None:
    near = graph("geometric", 10)
    assert sorted(map(len, near)) == [1, 1, 1, 2, 2, 2, 3, 3, 3, 4]
    assert diameter(near) == 6
    assert diameter(((1,), (0,), ())) == math.inf


def test_errors_have_the_stated_size_along_and_across_the_ray() -> None:
    world = draw_world(3, "aniso", True, TYPICAL)
    ray = TARGET_M - world.camera_m[0]
    reach = np.linalg.norm(ray)
    along, across = (
        ray / reach,
        np.cross(ray / reach, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(ray, [0, 0, 1])) * reach,
    )
    assert math.sqrt(along @ world.random_m2[0] @ along) == pytest.approx(
        math.hypot(0.0449 * (reach - 0.015) ** 2, 0.002)
    )
    assert math.sqrt(across @ world.random_m2[0] @ across) == pytest.approx(
        math.hypot(reach * math.radians(0.3), 0.002)
    )
    assert math.sqrt(along @ world.systematic_m2[0] @ along) == pytest.approx(math.hypot(0.01 * reach, 0.001))


def test_samples_scatter_as_the_covariance_says_and_one_robot_is_wrong() -> None:
    world = draw_world(3, "aniso", False, TYPICAL)
    dive = draw_dive(world, "all", 0.3, 20_000, np.random.default_rng(2))
    for i in (1, 2):
        error = dive.sample_m[:, i] - TARGET_M
        assert np.cov(error.T) == pytest.approx(world.random_m2[i], rel=0.1, abs=1e-6)
    off = (dive.sample_m[:, 0] - TARGET_M).mean(axis=0)
    assert np.linalg.norm(off) == pytest.approx(0.3, rel=0.01)
    assert abs(off[2]) < 0.001


def test_who_sees_when() -> None:
    late = seen("paper", 3, 40)
    assert [int(np.argmax(late[:, i])) for i in range(3)] == [0, 16, 28]
    assert np.flatnonzero(seen("relay", 10, 5)[3]).tolist() == [0, 4, 9]


def test_the_bound_of_equal_cameras_and_of_bias_that_stays() -> None:
    world = draw_world(3, "iso", False, TYPICAL)
    assert bound_m(world, np.array([10, 10, 10])) == pytest.approx(0.005 * math.sqrt(3 / 30))
    assert bound_m(world, np.array([10, 0, 5])) == pytest.approx(0.005 * math.sqrt(3 / 15))
    assert bound_m(world, np.array([10, 10, 10]), slice(1, None)) == pytest.approx(0.005 * math.sqrt(3 / 20))
    biased = draw_world(3, "iso", True, TYPICAL)
    floor = math.sqrt(np.trace(np.linalg.inv(np.linalg.inv(biased.systematic_m2).sum(axis=0))))
    assert bound_m(biased, np.full(3, 10**9)) == pytest.approx(floor, rel=1e-6)


def test_central_fusion_meets_the_bound() -> None:
    world = draw_world(5, "aniso", True, np.random.default_rng(3))
    rng = np.random.default_rng(4)
    square = [np.sum((central_m(world, draw_dive(world, "all", 0.0, 5, rng), 5) - TARGET_M) ** 2) for _ in range(4000)]
    assert math.sqrt(np.mean(square)) == pytest.approx(bound_m(world, np.full(5, 5)), rel=0.03)


def test_closed_form_of_full_graphs_is_known_by_hand() -> None:
    """Metropolis weights on a full graph are the mean: after one exchange all past is shared, the newest is not."""
    world, T = draw_world(3, "iso", False, TYPICAL), 10
    expected = math.sqrt((T - 1) * 3 * 25e-6 / 3 + 3 * 25e-6) / T
    assert closed_form_m(metropolis_weights(graph("full", 3)), world.random_m2, T) == pytest.approx(expected)


def test_the_central_track_follows_a_line_without_error_and_smooths_noise() -> None:
    world = draw_world(10, "aniso", False, np.random.default_rng(6))
    path = TARGET_M + np.arange(30)[:, None] * np.array([0.01, 0.005, 0.0])
    exact = Dive(np.repeat(path[:, None], 10, axis=1), np.ones((30, 10), dtype=bool))
    assert central_track_m(world, exact, 4e-6)[-1] == pytest.approx([*path[-1], 0.01, 0.005, 0.0], abs=2e-4)
    noisy = draw_dive(world, "all", 0.0, 30, np.random.default_rng(1), path)
    error = np.linalg.norm(central_track_m(world, noisy, 4e-6)[10:, :3] - path[10:], axis=1)
    assert 0.0 < error.mean() < bound_m(world, np.ones(10))
    assert np.linalg.norm(np.diff(circle_m(0.02, np.arange(50) * 0.2), axis=0), axis=1) == pytest.approx(
        0.004, rel=1e-3
    )
