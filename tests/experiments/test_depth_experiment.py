"""The depth claim's parts on one small view; the whole of it takes minutes."""

import numpy as np
import pytest

from agent.core.ranging.focus import lens_position
from agent.experiments import depth
from agent.experiments.still_camera import VIEWS, StillCamera, breathing, facing_wall, lens_positions, sweep, sweep_view
from agent.perception.depth_sweep import clarity_of, measure
from hw.camera.camera import Roi


@pytest.fixture(scope="module")
def camera():
    camera = StillCamera("imx519_640", 4)
    camera.prepare()
    return camera


@pytest.fixture(scope="module")
def fit(camera):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(depth, "WALL_M", 1.0 / np.linspace(1.0, 4.5, 6))
        return depth.calibrate(camera, 0.043, repeats=1)


def test_the_camera_is_one_and_its_truth_is_the_wall_s_distance(camera):
    camera.view = facing_wall(0.7)
    assert camera.truth_m(500.0) == pytest.approx(0.7, abs=1e-4)
    part = camera.read(Roi(96, 96, 64, 48))
    assert part.image.shape == (48, 64, 3) and camera.set_focus(5000) == 1023


def test_breathing_is_that_of_the_lens(camera):
    lens = camera.lens
    true = lens.at_position_m(1023) / lens.at_position_m(0) - 1
    assert breathing(camera) == pytest.approx(true, rel=0.08)


@pytest.mark.parametrize("u_m", [0.4, 0.9])
def test_blocks_of_a_wall_differ_by_what_their_sigma_says(camera, u_m):
    camera.view = facing_wall(u_m)
    rho, block = np.array(lens_positions(camera), float), 32
    found = measure(clarity_of(sweep(camera), rho, block, 0.043, split=True), block, None).blocks
    row, col = np.nonzero(found.accepted)
    y, x = row / 10.0 - 0.7, col / 10.0 - 1.0
    bowl = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, (x * x + y * y) ** 2], axis=1)  # the port's, the lens'
    peaks, sigma = found.lens_position[found.accepted], found.sigma[found.accepted]
    best, *_ = np.linalg.lstsq(bowl, peaks, rcond=None)
    assert len(peaks) > 200
    assert 0.8 < np.sqrt(np.mean(((peaks - bowl @ best) / sigma) ** 2)) < 1.2


@pytest.mark.slow
def test_calibration_on_the_wall(camera, fit):
    assert fit.r2 > 0.999 and fit.held_out_rmse_m < 0.02
    assert lens_position(fit, 0.4) > lens_position(fit, 0.8)
    assert abs(fit.sag - camera.lens.sag_m / camera.lens.per_position_m) < 3 * fit.sag_sigma < 4


@pytest.mark.slow
def test_one_view(camera, fit):
    swept = sweep_view(camera, VIEWS[1], 0.043)
    errors = {way: depth.errors([swept], [depth.map_of(swept, fit, camera.seen(), way)]) for way in depth.METHODS}
    assert all(found["told"] > 0.7 for found in errors.values())
    assert errors["matched"]["near_mm"] < 10 and errors["matched"]["near_mm"] < errors["argmax"]["near_mm"]


def test_figures_are_means_over_lenses_and_never_where_one_has_none():
    found = {"mm": 8.0, "near_mm": 2.0, "told": 0.9}
    ways = [{"way": way, **found} for way in depth.METHODS]
    other = [{**row, "mm": 10.0, "near_mm": None} for row in ways]
    figures = depth.summary({"crop-1280": [*ways, *other]})
    assert figures["crop-1280_matched_mm"] == 9.0 and figures["crop-1280_matched_near_mm"] is None
    assert figures["crop-1280_matched_told"] == 90.0 and not any("imx519" in key for key in figures)
