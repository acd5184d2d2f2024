"""A ball target whose colour a picture shows, from the fleet file to the detector."""

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError, Fleet, Pose, Robot, Target
from agent.perception.detection.detectors import load_detectors
from tests.perception.painted import CAMERA, ball_light, expose

BLUE = expose(ball_light((0.0, 0.0, 0.8))[..., ::-1], 4)
RED = expose(ball_light((0.0, 0.0, 0.8)), 4)


def fleet(picture, box):
    robot = Robot(listen="tcp/h:1", serial="s", camera="c", calibration="k", pose=Pose(x_m=0.1, y_m=0.1, yaw_deg=0.0))
    return Fleet(fleet="t", target={"ball": Target(radius_m=0.07, picture=picture, box=box)}, robot={"r1": robot})


def test_a_sample_from_a_picture_tells_the_ball_from_others(tmp_path):
    path = tmp_path / "buoy.png"
    cv2.imwrite(str(path), BLUE)
    detector = load_detectors(fleet(str(path), (300.0, 220.0, 40.0, 40.0)), CAMERA)["ball"]
    found = detector.find(BLUE)
    assert found is not None and found.radius_sigma_px is not None and found.radius_sigma_px > 0.0
    assert detector.find(RED) is None


@pytest.mark.parametrize(("box", "why"), [((5.0, 5.0, 40.0, 40.0), "grey"), ((900.0, 5.0, 40.0, 40.0), "outside")])
def test_a_box_without_a_colour_is_refused(tmp_path, box, why):
    path = tmp_path / "buoy.png"
    cv2.imwrite(str(path), np.asarray(BLUE))
    with pytest.raises(ConfigError, match=why):
        load_detectors(fleet(str(path), box), CAMERA)
