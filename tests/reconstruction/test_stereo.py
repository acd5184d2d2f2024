"""The plane sweep finds textured planes between coarse focus depths, and believes no prior that excludes the truth."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from agent.reconstruction.plane_sweep import Swept, neighbours, plane_sweep, slopes_of_map
from agent.reconstruction.views import View, stacked
from tests.reconstruction.drawn import drawn_view, plane_depth

PLACES = [(0.0, -0.45, 0.4), (0.12, -0.42, 0.42), (-0.13, -0.42, 0.41), (0.02, -0.36, 0.5)]


def views(normal: tuple[float, float, float], wrong_m: float = 0.0, sigma_m: float = 8e-3) -> list[View]:
    """Focus depths that are off by waves of 6 mm, and all by wrong_m."""
    unit = np.array(normal) / np.linalg.norm(normal)
    drawn = [drawn_view(n, p, (0.0, 0.0, 0.0), partial(plane_depth, normal=unit, offset=0.0), sigma_m)
             for n, p in enumerate(PLACES)]  # fmt: skip
    waves = 6e-3 * np.cos(np.arange(160) / 9.0)[None] * np.cos(np.arange(120) / 7.0)[:, None]
    return [replace(view, depth_m=(view.depth_m + waves + wrong_m).astype(np.float32)) for view in drawn]


def swept(of: list[View]) -> Swept:
    stack = stacked(of)
    return plane_sweep(stack, neighbours(stack))


@pytest.mark.parametrize(
    "normal", [(0.0, -0.7, 0.7), (0.0, 0.0, 1.0), (0.35, 0.1, 1.0)], ids=["facing", "floor", "tilted"]
)
def test_planes_are_found_more_exactly_than_focus_has_them(normal: tuple[float, float, float]) -> None:
    found = swept(views(normal))
    truth = np.stack([view.depth_m for view in views(normal, sigma_m=1.0)])  # with waves: taken out below
    waves = 6e-3 * np.cos(np.arange(160) / 9.0)[None] * np.cos(np.arange(120) / 7.0)[:, None]
    off = np.abs(found.depth_m - (truth - waves))
    assert np.isfinite(off).mean() > 0.4
    assert np.nanmedian(off) < 1e-3
    assert np.nanquantile(off, 0.95) < 4e-3


def test_a_prior_that_says_little_costs_no_depth() -> None:
    """Its sixteenth part would be five pixels, as wide as the window that is compared."""
    sure, unsure = (swept(views((0.0, 0.0, 1.0), sigma_m=sigma_m)) for sigma_m in (8e-3, 60e-3))
    assert np.isfinite(unsure.depth_m).mean() > 0.9 * np.isfinite(sure.depth_m).mean()
    assert np.nanmedian(np.abs(unsure.depth_m - sure.depth_m)) < 1e-3


def test_a_prior_that_excludes_the_truth_is_refused() -> None:
    right, wrong = (swept(views((0.0, -0.7, 0.7), by, sigma_m=2e-3)) for by in (0.0, 0.08))
    assert np.isfinite(wrong.depth_m).mean() < 0.1 * np.isfinite(right.depth_m).mean()  # what looks alike by chance


def test_what_has_no_texture_has_no_depth() -> None:
    plain = [replace(view, picture=np.full_like(view.picture, 0.3)) for view in views((0.0, 0.0, 1.0))]
    assert not np.isfinite(swept(plain).depth_m).any()


def test_neighbours_look_from_elsewhere_at_the_same() -> None:
    of = views((0.0, 0.0, 1.0))
    away = replace(of[0], rotation=of[0].rotation @ np.diag([-1.0, 1.0, -1.0]))  # turned round
    found = neighbours(stacked([*of, away, of[0]])).of  # the last one stands where the first does
    assert set(found[0]) == {1, 2, 3, -1}
    assert set(found[4]) == {-1}


def test_slopes_of_a_tilted_map() -> None:
    q = 2.0 + 0.004 * np.arange(40)[None] - 0.003 * np.arange(30)[:, None]
    tilt = np.zeros((30, 40, 2))
    slopes_of_map((1.0 / q).astype(np.float32), tilt)
    np.testing.assert_allclose(tilt[10:20, 10:30], np.broadcast_to((0.004, -0.003), (10, 20, 2)), atol=1e-5)
