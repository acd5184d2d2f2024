"""A camera's gamma from blurred tags, drawn by a renderer that shares nothing with it."""

import cv2
import numpy as np
import pytest
import tomli_w
from rich.console import Console

from agent.core.config import ConfigError, read_toml
from agent.core.ranging.camera_model import CameraFit
from agent.tools.camera_calibration import Photographs
from agent.tools.tags import calibrate_gamma, gamma_of_folder
from tests.perception.printed import WALL, photograph, tag_light, turned

CAMERA = CameraFit(width_px=480, height_px=400, f_px=1184.0, cx_px=239.5, cy_px=199.5, bend=0.39)
POSES = ((turned(0, 0, 3), (-0.06, -0.04, 0.68)), (turned(20, -10, 20), (0.05, 0.04, 0.62)))
BLURS_PX = (4.0, 5.0, 6.0, 6.5, 7.0)


@pytest.fixture(scope="module")
def light():
    out = np.full((CAMERA.height_px, CAMERA.width_px), WALL)
    for number, (rotation, middle_m) in enumerate(POSES):
        tag_light(CAMERA, number, rotation, middle_m, out)
    return out


@pytest.fixture
def taken(light, tmp_path):
    def take(gamma, blurs_px=BLURS_PX, noise=0.0, scale=1.0):
        for k, blur_px in enumerate(blurs_px):
            picture = photograph(light * scale, blur_px, noise=noise, gamma=gamma, seed=k)
            cv2.imwrite(str(tmp_path / f"{k}.png"), picture)
        return tmp_path

    return take


@pytest.mark.parametrize(
    ("gamma", "noise", "off"), [(1.0, 0.0, 0.05), (1.8, 0.0, 0.05), (2.6, 0.0, 0.06), (2.2, 0.02, 0.12)]
)
def test_gamma_is_found_whatever_the_blur(taken, gamma, noise, off):
    fit = gamma_of_folder(Photographs(taken(gamma, noise=noise)), lambda done, total: None)
    assert fit.gamma == pytest.approx(gamma, abs=off)
    assert fit.tags >= 8 and fit.pictures == 5
    assert 3.0 <= fit.blur_px[0] < fit.blur_px[1] < 9.0


def test_sharp_and_burnt_out_tags_say_nothing(taken):
    for folder in (taken(2.2, blurs_px=(0.0, 0.0)), taken(2.2, scale=1.5)):
        with pytest.raises(ConfigError, match="0 tags are blurred"):
            gamma_of_folder(Photographs(folder), lambda done, total: None)


def test_it_goes_into_the_camera_of_a_calibration_and_nowhere_else(taken, tmp_path):
    path = tmp_path / "r1.toml"
    with pytest.raises(ConfigError, match="has no table"):
        calibrate_gamma(taken(1.8), path, Console(quiet=True))
    path.write_text(tomli_w.dumps({"robot": "r1", "made": "", "source": "", "camera": {"f_px": 900.0}}))
    calibrate_gamma(taken(1.8), path, Console(quiet=True))
    after = read_toml(path)["camera"]
    assert after.pop("gamma") == pytest.approx(1.8, abs=0.05)
    assert after == {"f_px": 900.0}
    assert "gamma" not in (tmp_path / "r1.toml.before").read_text()
