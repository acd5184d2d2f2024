"""A ball in the dark by a lamp beside the camera: bright in its middle, dark at its rim: its edge looks soft."""

import math

import numpy as np
import pytest

from agent.core.ranging.camera_model import CameraFit
from agent.experiments.dark_water import DarkWater, stand
from agent.perception.detection.detect import LIMIT, find_ball
from agent.perception.detection.detectors import BY_LAMPS
from tests.perception.painted import CAMERA, expose

FAR_M = 0.73


@pytest.fixture(scope="module", params=[2])
def frame(request: pytest.FixtureRequest) -> tuple[np.ndarray, CameraFit]:
    """Of a camera of that world in harbour water, by its own lamp, and the camera."""
    sea = DarkWater("harbour", request.param)
    sea.prepare()
    image = sea.painter.expose(sea.moment("r1", {"r1": stand(FAR_M, 0.0)}, ["r1"]), sea.sharp_m(FAR_M))
    lens = sea.lens
    f_px = 1.333 * sea.sharp_m(FAR_M) / lens.pixel_m
    centre = dict(zip(("cx_px", "cy_px"), lens.centre_px, strict=True))
    return image, CameraFit(width_px=lens.width, height_px=lens.height, f_px=f_px, bend=0.39, **centre)


def test_an_edge_that_is_soft_by_its_lamp_is_no_doubt_by_lamps(frame: tuple[np.ndarray, CameraFit]) -> None:
    image, camera = frame
    plain = find_ball(image, camera, limit=0.0)
    ball = find_ball(image, camera, limit=BY_LAMPS, by_lamps=True)
    assert ball is not None and plain is not None
    assert ball.score > LIMIT > plain.score
    assert ball.radius_px == pytest.approx(math.asin(0.07 / FAR_M) * camera.f_px, rel=0.04)
    assert math.dist(ball.centre_px, (camera.cx_px, camera.cy_px)) < 4.0


@pytest.mark.parametrize("seed", range(3))
def test_veil_alone_is_no_ball(seed: int) -> None:
    veil = np.full((480, 640, 3), (0.10, 0.12, 0.11))
    assert find_ball(expose(veil, seed), CAMERA, limit=BY_LAMPS, by_lamps=True) is None
