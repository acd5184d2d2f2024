"""Corners of one picture are found in others where they truly are, and not where something merely looks alike."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from agent.reconstruction.matches import MOST, corners, correlate, matched, read, summit, top
from agent.reconstruction.views import Stack, View, camera_at, moved, project, stacked, unproject
from tests.reconstruction.drawn import drawn_view, plane_depth

FLOOR = partial(plane_depth, normal=np.array([0.0, 0.0, 1.0]), offset=0.0)
PLACES = [(0.0, -0.45, 0.4), (0.12, -0.42, 0.42), (-0.13, -0.42, 0.41), (0.02, -0.36, 0.5)]


@pytest.fixture(scope="module")
def views() -> list[View]:
    return [drawn_view(n, place, (0.0, 0.0, 0.0), FLOOR) for n, place in enumerate(PLACES)]


def off_px(stack: Stack, believed: Stack, reach_px: float, robots: list[str]) -> np.ndarray:
    """How far each match by the believed poses is from where the true ones have the corner."""
    found = corners(believed)
    got = matched(believed, found, robots, reach_px)
    off = []
    for corner, other, pixel in zip(*got, strict=True):
        n = found.owner[corner]
        point = unproject(camera_at(stack, n), found.pixel[corner], found.depth_m[corner])
        place = stack.rotations[n] @ point + stack.positions_m[n]
        there = (place - stack.positions_m[other]) @ stack.rotations[other]
        off.append(np.linalg.norm(project(camera_at(stack, other), there) - pixel))
    return np.array(off)


def test_corners_are_found_where_they_are_though_poses_are_off(views: list[View]) -> None:
    lost = [views[0], moved(views[1], np.array([0.02, -0.02, 0.015]), np.array([3e-3, -2e-3, 3e-3])), *views[2:]]
    off = off_px(stacked(views), stacked(lost), 16.0, ["r1", "r2", "r3", "r4"])
    assert len(off) > 100
    assert np.median(off) < 0.2 and np.mean(off < 1.0) > 0.97


def test_hardly_any_are_found_where_none_can_be(views: list[View]) -> None:
    turned = [views[0], moved(views[1], np.array([0.0, 0.25, 0.0]), np.zeros(3))]  # 55 px, and 16 are looked at
    true, wrong = (len(off_px(stacked(views[:2]), stacked(of), 16.0, ["r1", "r2"])) for of in (views[:2], turned))
    assert wrong < 0.15 * true


def test_tiles_that_look_alike_are_refused(views: list[View]) -> None:
    found = corners(stacked(views[:2]))
    assert 20 < len(found.owner) <= 2 * MOST
    across = np.indices(views[0].depth_m.shape)[1]
    striped = np.repeat((0.4 + 0.2 * np.sin(across * (2 * np.pi / 10.0)))[..., None], 3, axis=-1).astype(np.float32)
    same = [replace(views[0], seq=n, picture=striped) for n in range(2)]
    assert not len(matched(stacked(same), found, ["r1", "r2"], 16.0).corner)


def test_a_window_is_found_to_a_part_of_a_pixel() -> None:
    v, u = np.mgrid[:60, :60].astype(float)
    waves = [
        (0.5 + 0.2 * np.sin((u + du) / 3.0 + 0.3) * np.cos((v + dv) / 4.0)).astype(np.float32)
        for du, dv in ((0, 0), (1.3, -2.4))
    ]
    own, wide, alike = np.empty((11, 11)), np.empty((19, 19)), np.empty((9, 9))
    read(waves[0], 60, 60, 30.0, 30.0, (1.0, 0.0), (0.0, 1.0), own)
    read(waves[1], 60, 60, 30.0, 30.0, (1.0, 0.0), (0.0, 1.0), wide)
    correlate(own, wide, alike)
    row, col = top(alike)
    assert alike[row, col] > 0.9
    assert np.array(summit(alike, row, col)) - 4.0 == pytest.approx([2.4, -1.3], abs=0.06)
    read(waves[1], 60, 60, 57.0, 30.0, (1.0, 0.0), (0.0, 1.0), wide)
    assert np.isnan(wide[:, -1]).all() and np.isfinite(wide[:, :9]).all()
