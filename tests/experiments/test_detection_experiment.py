"""The detection claim counts honestly; its truth is the outline that a sphere has."""

import math

import numpy as np
import pytest

from agent.core.ranging.camera_model import CameraFit
from agent.experiments.claim import Share
from agent.experiments.detection import Settings, outline, run, summary

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


def test_a_small_run():
    rows = run(0, "tap", Settings(places=2))
    raw = [row for row in rows if row["way"] == "raw"]
    assert [row["focus"] for row in raw] == ["sharp", "defocused"]
    for row in raw:
        assert row["found"] == row["frames"] >= 1  # one place shows too little of the ball
        assert row["false"] == 0 and row["pictures"] == 4
        assert max(row["centre_px"]) < 3.0
    found = summary({"tap": rows})
    assert found["tap_found"] == Share(*(sum(row["frames"] for row in raw),) * 2)
    assert found["raw_false"] == Share(0, 8)
    assert found["raw_sharp_centre_px"] == max(raw[0]["centre_px"])
