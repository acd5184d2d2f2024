"""Poses from pictures: derivatives against differences, errors that come back, and what no picture can tell."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from agent.reconstruction.pose_evidence import (
    Motion,
    apart,
    between,
    by_motion,
    carried,
    clipped,
    evidence,
    flow,
    moved_about,
    place,
)
from agent.reconstruction.refine_poses import refine
from agent.reconstruction.views import diagonal_prior, moved, project, rotation_of, to_camera, unproject
from tests.reconstruction.a_plane import CAMERA, a_view, look, some_views
from tests.reconstruction.drawn import drawn_view, plane_depth


def test_flow_is_what_central_differences_of_the_whole_camera_say() -> None:
    view, h = a_view("r1", 0, (0.1, 0.2, -0.1), (0.3, -0.2, 0.1)), 1e-6
    for u, v, z in ((3.0, 5.0, 0.3), (150.0, 110.0, 0.8), (80.0, 20.0, 1.4)):
        there = view.position_m + view.rotation @ unproject(CAMERA, np.array([u, v]), np.array(z))
        found = np.zeros((3, 6))
        flow(CAMERA, u, v, z, found)
        for j, xi in enumerate(np.eye(6) * h):
            points = [to_camera(moved(view, s * xi[:3], s * xi[3:]), there) for s in (1.0, -1.0)]
            change = [np.append(project(CAMERA, p), p[2]) for p in points]
            assert (change[0] - change[1]) / (2 * h) == pytest.approx(found[:, j], rel=1e-5, abs=1e-4)


def test_pull_is_the_slope_of_the_cost() -> None:
    true, h = a_view("r1", 0, (0.0, 0.0, 0.0), (0.05, -0.1, 0.0)), 1e-5
    off = moved(true, np.array([4e-4, -3e-4, 5e-4]), np.array([1e-4, 2e-4, -2e-4]))  # so near that the scale is fixed
    found = evidence(off, *look(off))
    slope = []
    for xi in np.eye(6) * h:
        there = [moved(off, s * xi[:3], s * xi[3:]) for s in (1.0, -1.0)]
        up, down = (evidence(view, *look(view)).cost for view in there)
        slope.append((up - down) / (2 * h))
    assert -found.pull == pytest.approx(slope, rel=0.08, abs=0.02 * np.abs(slope).max())


def test_a_robots_motion_is_its_views_own_carried_over() -> None:
    view, centre, xi = a_view("r1", 0, (0.3, -0.1, 0.2), (0.4, 0.2, -0.3)), np.array([0.1, 0.1, 0.0]), np.zeros(6)
    xi[:] = (2e-5, -1e-5, 3e-5, 1e-5, 2e-5, -2e-5)
    own = carried(view, centre) @ xi
    a, b = moved_about(view, centre, xi[:3], xi[3:]), moved(view, own[:3], own[3:])
    assert np.allclose(a.rotation, b.rotation, atol=1e-9) and np.allclose(a.position_m, b.position_m, atol=1e-9)


def test_errors_of_robots_come_back() -> None:
    floor = partial(plane_depth, normal=np.array([0.0, 0.0, 1.0]), offset=0.0)
    places = [(0.0, -0.40), (0.02, -0.44), (0.30, -0.30), (0.33, -0.26), (-0.30, -0.28), (-0.26, -0.33)]
    drawn = [drawn_view(n, (x, y, 0.4 + 0.1 * (n % 2)), (0.0, 0.0, 0.0), floor) for n, (x, y) in enumerate(places)]
    survey = diagonal_prior(np.radians(0.5), 3e-3)
    true = [replace(view, robot=f"r{n // 2}", pose_covariance=survey) for n, view in enumerate(drawn)]
    rng = np.random.default_rng(3)
    errors = [(rng.normal(0, np.radians(0.5), 3), rng.normal(0, 3e-3, 3)) for _ in range(3)]
    off = [moved_about(view, true[n // 2 * 2].position_m, *errors[n // 2]) for n, view in enumerate(true)]
    found = refine(off)
    motion = [between(views, true) for views in (off, found.views)]  # of everything: nobody can see that
    (before, _), (metres, radians) = (
        apart([by_motion(view, taken) for view in views], true)
        for views, taken in zip((off, found.views), motion, strict=True)
    )
    assert before.max() > 7e-3
    assert metres.max() < 2e-3 and np.degrees(radians.max()) < 0.1  # how large everything is, three robots know badly
    assert found.off_px[1] < 0.1 < 1.0 < found.off_px[0]


def test_views_that_share_nothing_stay_where_they_are() -> None:
    plain = [replace(view, picture=np.full_like(view.picture, 0.3)) for view in some_views()]
    found = refine(plain)
    assert found.matches == 0
    assert apart(found.views, plain)[0].max() < 1e-9


def test_a_view_alone_finds_its_place_in_a_scene() -> None:
    true = a_view("r9", 0, (0.02, 0.03, 0.0), (0.0, 0.1, 0.05))
    lost = moved(true, np.array([0.006, -0.008, 0.01]), np.array([0.004, -0.003, 0.005]))
    found = place(lost, look).view
    metres, radians = apart([found], [true])
    assert metres[0] < 3e-4 and np.degrees(radians[0]) < 0.05


def test_a_common_motion_is_taken_off_whole() -> None:
    true = some_views()
    motion = Motion(rotation_of(np.array([0.02, -0.01, 0.03])), np.array([0.01, 0.02, -0.005]))
    found = [by_motion(view, motion) for view in true]
    back = between(found, true)
    metres, radians = apart([by_motion(view, back) for view in found], true)
    assert metres.max() < 1e-12 and radians.max() < 1e-7


def test_a_prior_that_knows_all_keeps_a_view_where_it_is() -> None:
    true = a_view("r1", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    lost = moved(true, np.array([0.003, 0.0, 0.0]), np.zeros(3))
    kept = place(lost, look, np.eye(6) * 1e12).view
    assert apart([kept], [lost])[0][0] < 1e-6


def test_a_step_that_is_too_long_keeps_its_direction() -> None:
    xi = np.array([0.1, 0.0, 0.0, 0.0, 0.01, 0.0])
    assert clipped(xi, (0.01, 0.01)) == pytest.approx(xi / 10)
    assert clipped(xi / 100, (0.01, 0.01)) == pytest.approx(xi / 100)
