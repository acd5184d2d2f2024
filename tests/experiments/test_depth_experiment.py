"""The depth experiment's parts on one small view; the whole of it takes minutes and is run by hand."""

import numpy as np
import pytest

from agent.core.ranging.camera_model import Calibration
from agent.core.ranging.focus import lens_position
from agent.experiments import depth
from agent.experiments import depth as experiment
from agent.experiments.depth import figure
from agent.experiments.still_camera import VIEWS, StillCamera, breathing, facing_wall, sweep_view
from hw.camera.camera import Roi


@pytest.fixture(scope="module")
def camera():
    camera = StillCamera("imx519_640", 4)
    camera.prepare()
    return camera


@pytest.fixture(scope="module")
def known(camera):
    distances, depth.WALL_M = depth.WALL_M, 1.0 / np.linspace(1.0, 4.5, 6)
    depth.WALL_REPEATS, repeats = 1, depth.WALL_REPEATS
    fit = depth.calibrate(camera, 0.043, lambda: None)
    depth.WALL_M, depth.WALL_REPEATS = distances, repeats
    return Calibration(robot="r1", made="", source="", focus=fit, camera=experiment.nominal_pinhole(camera))


def test_the_camera_is_one_and_its_truth_is_the_wall_s_distance(camera):
    camera.view = facing_wall(0.7)
    assert camera.truth_m(500.0) == pytest.approx(0.7, abs=1e-4)
    part = camera.read(Roi(96, 96, 64, 48))
    assert part.image.shape == (48, 64, 3) and camera.set_focus(5000) == 1023


def test_breathing_is_that_of_the_lens(camera):
    lens = camera.lens
    true = lens.at_position_m(1023) / lens.at_position_m(0) - 1
    assert breathing(camera) == pytest.approx(true, rel=0.08)


@pytest.mark.slow
def test_calibration_on_the_wall(camera, known):
    fit = known.focus
    assert fit.r2 > 0.999 and fit.held_out_rmse_m < 0.02
    assert lens_position(fit, 0.4) > lens_position(fit, 0.8)
    assert abs(fit.sag - camera.lens.sag_m / camera.lens.per_position_m) < 3 * fit.sag_sigma < 4


@pytest.mark.slow
def test_one_view(camera, known, tmp_path):
    swept = sweep_view(camera, VIEWS[1], 0.043)
    maps = {method: [experiment.map_of(swept, known, method)] for method in experiment.METHODS}
    errors = {}
    for method in experiment.METHODS:
        found = experiment.error_rows("imx519_640", method, [swept], maps[method])
        assert [tuple(case["range_m"]) for case in found] == list(experiment.RANGES_M)
        errors[method] = found[0]["mae_mm"]
        assert found[0]["blocks"] > 20 and found[0]["accepted"] > 0.7
    assert errors["matched"] < 10 and errors["matched"] < errors["argmax"]
    (found,) = maps["matched"]
    figure(found, experiment.truth_on_parts(swept, found)).savefig(tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 50_000


def test_missed_targets_are_said():
    case = {"sensor": experiment.SENSORS[0], "peak": "matched", "grid": "breathing", "range_m": [0.0, 0.6]}
    assert experiment.missed([{**case, "mae_mm": 3.1}]) and not experiment.missed([{**case, "mae_mm": 2.9}])
