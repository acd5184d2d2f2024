"""The depth experiment's parts on one small view; the whole of it takes minutes and is run by hand."""

import json

import numpy as np
import pytest

from agent.config import ConfigError
from agent.experiments import depth as experiment
from agent.experiments import wall
from agent.experiments.depth_figure import draw
from agent.experiments.still import StillCamera
from agent.ranging.calibration import Calibration
from agent.ranging.focus import lens_position
from hw.camera import Roi


@pytest.fixture(scope="module")
def camera():
    camera = StillCamera("imx519_640", 4)
    camera.prepare()
    return camera


@pytest.fixture(scope="module")
def known(camera):
    distances, wall.WALL_M = wall.WALL_M, 1.0 / np.linspace(1.0, 4.5, 6)
    wall.WALL_REPEATS, repeats = 1, wall.WALL_REPEATS
    fit = wall.calibrate(camera, 0.043, lambda: None)
    wall.WALL_M, wall.WALL_REPEATS = distances, repeats
    return Calibration(robot="r1", made="", source="", focus=fit, camera=experiment.nominal(camera))


def test_the_camera_is_one_and_its_truth_is_the_wall_s_distance(camera):
    camera.view = wall.facing_wall(0.7)
    assert camera.truth_m(500.0) == pytest.approx(0.7, abs=1e-4)
    part = camera.read(Roi(96, 96, 64, 48))
    assert part.image.shape == (48, 64, 3) and camera.set_focus(5000) == 1023


def test_breathing_is_that_of_the_lens(camera):
    lens = camera.lens
    true = lens.at_position_m(1023) / lens.at_position_m(0) - 1
    assert wall.breathing(camera) == pytest.approx(true, rel=0.08)


def test_calibration_on_the_wall(camera, known):
    fit = known.focus
    assert fit.r2 > 0.999 and fit.held_out_rmse_m < 0.02
    assert lens_position(fit, 0.4) > lens_position(fit, 0.8)
    assert abs(fit.sag - camera.lens.sag_m / camera.lens.per_position_m) < 3 * fit.sag_sigma < 4


def test_one_view(camera, known, tmp_path):
    taken = experiment.take(camera, 1, 0.043)
    maps = {method: [experiment.map_of(taken, known, method)] for method in experiment.METHODS}
    errors = {}
    for method in experiment.METHODS:
        found = experiment.rows("imx519_640", method, [taken], maps[method], maps["matched"])
        assert [tuple(case["range_m"]) for case in found] == list(experiment.RANGES_M)
        errors[method] = found[0]["mae_mm"]
        assert found[0]["blocks"] > 20 and found[0]["accepted"] > 0.7
    assert errors["matched"] < 10 and errors["matched"] < errors["argmax"]
    draw(maps["matched"][0], taken.truth_m, tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 50_000


def test_a_folder_with_a_result_is_left_alone(tmp_path):
    (tmp_path / "result.json").write_text(json.dumps({}))
    with pytest.raises(ConfigError, match="holds a result"):
        experiment.depth(0, tmp_path, lambda done, total: None)


def test_missed_targets_are_said():
    case = {"sensor": experiment.SENSORS[0], "peak": "matched", "grid": "breathing", "range_m": [0.0, 0.6]}
    assert experiment.missed([{**case, "mae_mm": 3.1}]) and not experiment.missed([{**case, "mae_mm": 2.9}])
