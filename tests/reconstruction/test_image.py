"""The image model as callers have it: surfels of a surface that was fused, judged by a photograph held back."""

from __future__ import annotations

import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.experiments.reconstruction.render import SHARED, noisy
from agent.reconstruction.fusion import fuse
from agent.reconstruction.held_back import ImageModel, judged, psnr_db, smaller
from agent.reconstruction.mesh import mesh_of
from agent.reconstruction.pose_evidence import apart
from agent.reconstruction.run import image_model
from agent.reconstruction.surfels import filled
from agent.reconstruction.views import moved, stacked, surface_points
from tests.reconstruction.a_plane import a_view, some_views


@pytest.fixture(scope="module")
def model() -> ImageModel:
    views = some_views()
    mesh = mesh_of(fuse(stacked(views), 6e-3))
    return image_model("surfels", views, mesh, 6e-3, lambda done, total: None)


def test_a_photograph_is_placed_before_it_is_compared(model: ImageModel) -> None:
    true = a_view("r9", 0, (0.02, 0.02, 0.0), (0.0, 0.05, 0.0))
    lost = moved(true, np.array([2e-3, -3e-3, 1e-3]), np.array([1e-3, 1e-3, 0.0]))
    found = judged(model.look, [lost])[0]
    assert found.psnr_db > 30.0 and found.unplaced_db < found.psnr_db - 3.0
    assert apart([found.view], [true])[1][0] < 1e-3


def test_a_field_without_torch_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    views = some_views()[:2]
    mesh = mesh_of(fuse(stacked(views), 10e-3))
    with pytest.raises(ConfigError, match=r"a field needs torch: .*\[reconstruct\]"):
        image_model("field", views, mesh, 10e-3, lambda done, total: None)


def test_holes_are_filled_from_around_them() -> None:
    light = np.full((20, 30, 3), 0.5, np.float32)
    light[5:15, 10:20] = np.nan
    assert filled(light) == pytest.approx(np.full((20, 30, 3), 0.5), abs=1e-5)
    assert (filled(np.full_like(light, np.nan)) == 0.0).all()
    nearly_empty = np.full((90, 120, 3), np.nan, np.float32)
    nearly_empty[40, 3] = 0.5
    assert filled(nearly_empty) == pytest.approx(np.full((90, 120, 3), 0.5), abs=1e-5)


def test_psnr_by_hand() -> None:
    a, b = np.full((4, 4, 3), 0.5**2.2, np.float32), np.full((4, 4, 3), 0.6**2.2, np.float32)
    assert psnr_db(a, b) == pytest.approx(20.0, abs=1e-4)


def test_a_smaller_view_sees_the_same_places() -> None:
    view = a_view("r1", 0, (0.0, 0.0, 0.0), (0.1, 0.0, 0.0))
    small = smaller(view, 2)
    assert small.picture.shape == (60, 80, 3) and small.depth_m.shape == (60, 80)
    there, whole = surface_points(small), surface_points(view)
    assert there[30, 40] == pytest.approx(whole[60:62, 80:82].mean(axis=(0, 1)), abs=2e-3)


def test_noise_is_a_robots_and_comes_again() -> None:
    true = some_views()
    a, b, other = noisy(true, 1), noisy(true, 1), noisy(true, 2)
    assert all((x.rotation == y.rotation).all() for x, y in zip(a, b, strict=True))
    assert not (a[0].rotation == other[0].rotation).all()
    metres, radians = apart(a, true)
    assert 0.0 < metres.max() < 8 * SHARED[0] and 0.0 < radians.max() < 8 * SHARED[1]
    assert a[0].pose_covariance[0, 0] == pytest.approx(SHARED[1] ** 2, rel=0.1)
