"""The detection experiment runs and counts honestly; its truth is the outline that a sphere has."""

import json
import math

import numpy as np
import pytest

from agent.core.ranging.camera_model import CameraFit
from agent.experiments.detection import Settings, outline, run, table
from agent.experiments.experiment import write_result

CAMERA = CameraFit(width_px=320, height_px=240, f_px=600.0, cx_px=159.5, cy_px=119.5)


def depths(centre_m, radius_m=0.07):
    """z-depth of a wall at 2 m with and without a sphere in front of it."""
    v, u = np.mgrid[:240, :320]
    m = np.stack([(u - CAMERA.cx_px) / CAMERA.f_px, (v - CAMERA.cy_px) / CAMERA.f_px, np.ones(u.shape)], axis=-1)
    c = np.asarray(centre_m)
    mm, mc = (m * m).sum(-1), m @ c
    root = mc**2 - mm * (c @ c - radius_m**2)
    wall = np.full(u.shape, 2.0)
    return np.where(root > 0, (mc - np.sqrt(np.maximum(root, 0))) / mm, wall), wall


def test_the_truth_is_the_cone_around_the_sphere():
    centre_m = (0.05, -0.03, 0.7)
    truth = outline(*depths(centre_m), CAMERA)
    px = (CAMERA.cx_px + CAMERA.f_px * 0.05 / 0.7, CAMERA.cy_px - CAMERA.f_px * 0.03 / 0.7)
    assert math.dist(truth.centre_px, px) < 0.1
    assert truth.radius_px == pytest.approx(CAMERA.f_px * math.asin(0.07 / math.hypot(*centre_m)), abs=0.1)
    assert truth.visible == 1.0


def test_what_stands_in_front_is_not_the_balls_border():
    ball, wall = depths((0.0, 0.0, 0.7))
    ball[:, :160], wall[:, :160] = 0.3, 0.3  # a post before its left half
    truth = outline(ball, wall, CAMERA)
    assert math.dist(truth.centre_px, (CAMERA.cx_px, CAMERA.cy_px)) < 0.5
    assert truth.visible == pytest.approx(0.5, abs=0.03)


def test_a_small_run(tmp_path):
    shown = []
    result = run(Settings(count=2, waters=("tap",)), lambda *at: shown.append(at))
    write_result(result, tmp_path)
    assert json.loads((tmp_path / "result.json").read_text()) == result.as_json()
    assert shown[-1] == (2, 2)
    whole = [case for case in result.cases if case["range_m"] == [0.25, 1.5] and case["image"] == "raw"]
    assert [case["focus"] for case in whole] == ["sharp", "defocused"]
    for case in whole:
        assert case["found"] == case["frames"] >= 1  # one place shows too little of the ball
        assert case["false"] == 0 and case["pictures"] == 4
        assert case["centre_p95_px"] < 3.0
    assert (result.seed, result.sensor, result.places) == (0, "imx519_640", 2)
    assert table(result).row_count == 8, "four images, sharp and defocused"
