"""Discs of a known plane drawn into pictures, and coloured by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agent.reconstruction.surfels import Cloud, blended, fit, gathered, picture, splats, stand, thinned
from tests.reconstruction.a_plane import NORMAL, OFFSET_M, a_view, look, some_views

CELL_M = 5e-3


@pytest.fixture(scope="module")
def cloud() -> Cloud:
    """The plane of a_plane.py, a disc for every 0.75 cells of its grid; its water is on the cameras' side."""
    x, y = np.meshgrid(np.arange(-0.45, 0.45, 2e-3), np.arange(-0.4, 0.4, 2e-3), indexing="ij")
    z = (OFFSET_M - NORMAL[0] * x - NORMAL[1] * y) / NORMAL[2]
    places = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    return thinned(places, np.broadcast_to(NORMAL, places.shape), CELL_M)


def test_thinning_leaves_one_disc_in_a_cube() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], [0.1, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = thinned(points, normals, CELL_M)
    assert found.place_m == pytest.approx(np.array([[0.5e-3, 0.0, 0.0], [0.1, 0.0, 0.0]]))
    assert np.linalg.norm(found.normal, axis=1) == pytest.approx(1.0) and found.radius_m == pytest.approx(0.55 * CELL_M)


def test_discs_of_a_plane_have_its_depth_and_leave_no_hole(cloud: Cloud) -> None:
    view = a_view("r1", 0, (0.0, 0.0, 0.0), (0.05, 0.1, 0.3))
    drawn = splats(cloud, view)
    assert np.isfinite(drawn.depth_m).all()
    error = np.abs(drawn.depth_m - view.depth_m)
    assert np.median(error) < 0.3e-3 and error.max() < 4e-3


def test_discs_that_look_away_are_not_seen(cloud: Cloud) -> None:
    view = a_view("r1", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert np.isnan(splats(cloud._replace(normal=-cloud.normal), view).depth_m).all()


def test_what_is_behind_the_front_is_hidden(cloud: Cloud) -> None:
    view = a_view("r1", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    behind = cloud.place_m + np.array([0.0, 0.0, 0.1])
    two = Cloud(np.concatenate([cloud.place_m, behind]), np.tile(cloud.normal, (2, 1)), cloud.radius_m)
    which = np.repeat([[1.0], [0.0]], len(cloud.place_m), axis=0)
    drawn = splats(two, view)
    seen = blended(drawn, which[drawn.numbers])[10:-10, 10:-10]
    assert seen == pytest.approx(1.0)


def test_gathering_is_the_transpose_of_blending(cloud: Cloud) -> None:
    drawn, rng = splats(cloud, a_view("r1", 0, (0.0, 0.0, 0.0), (0.0, 0.1, 0.0))), np.random.default_rng(0)
    values, pixels = rng.normal(size=(len(drawn.numbers), 2)), rng.normal(size=(120, 160, 2))
    assert (blended(drawn, values) * pixels).sum() == pytest.approx((gathered(drawn, pixels)[0] * values).sum())


def test_colours_come_from_pictures(cloud: Cloud) -> None:
    counts: list[tuple[int, int]] = []
    found = fit(cloud, some_views(), 2, lambda done, total: counts.append((done, total)))
    light, _ = picture(found, new := a_view("r9", 0, (0.02, 0.02, 0.0), (0.0, 0.05, 0.0)))
    error = (light ** (1 / 2.2) - look(new)[0] ** (1 / 2.2))[15:-15, 15:-15]
    assert -10 * np.log10(np.nanmean(error**2)) > 35.0
    assert counts[-1] == (18, 18)


def test_a_picture_is_exposed_as_those_taken_nearest_to_it(cloud: Cloud) -> None:
    """A third stop more or less, and another white balance, from picture to picture: as cameras set them."""
    views = some_views()
    gains = 0.9 * np.geomspace(0.8, 1.0, len(views))[:, None] * np.array([1.1, 1.0, 0.9])
    taken = [replace(view, picture=np.float32(view.picture * gain)) for view, gain in zip(views, gains, strict=True)]
    found = fit(cloud, taken, 4, lambda *_: None)
    assert found.gain / found.gain.mean(axis=0) == pytest.approx(gains / gains.mean(axis=0), rel=0.02)
    for k in (0, len(views) - 1):
        light, _ = picture(found, replace(taken[k], position_m=taken[k].position_m + np.array([1e-3, 0.0, 0.0])))
        apart = [np.linalg.norm(stand(other) - stand(taken[k])) for other in taken]
        three = np.exp(np.log(gains[np.argsort(apart)[:3]]).mean(axis=0))
        assert np.nanmedian(light / taken[k].picture, axis=(0, 1)) == pytest.approx(three / gains[k], rel=0.03)
