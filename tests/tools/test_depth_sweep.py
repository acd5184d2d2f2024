"""One sweep of the focus: in which order, on which grid, and where its blocks are sharpest."""

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.perception.depth_peaks import measure_growth
from agent.perception.depth_sweep import clarity_of, measure, sweep
from hw.camera.files import open_stack
from tests.tools.planes import FOCUS, Breathing, Lens, quiet, two_planes


def test_the_picture_is_sharp_everywhere(planes):
    sharp = sweep(open_stack(planes), 40, quiet).sharp
    for lens_position in (0.20, 0.40):  # each photograph is sharp on one side only
        photograph = two_planes(lens_position, 0.21, 0.388, 10.0)
        assert cv2.Laplacian(sharp, cv2.CV_64F).var() > 1.2 * cv2.Laplacian(photograph, cv2.CV_64F).var()


def test_a_camera_is_swept_upwards_and_its_own_report_counts(tmp_path):
    lens = Lens()
    taken = sweep(lens, 40, quiet)
    home, *visited = lens.visited
    assert home == 0 and visited == sorted(visited) and len(visited) == 30 and visited[-1] == 1022
    result = measure(taken, 40, FOCUS)
    step = 1023 / 29
    blocks = result.blocks
    assert np.abs(blocks.lens_position[:3, :3] - 400.4).max() < 0.1 * step
    assert np.abs(blocks.lens_position[:3, 3:] - 640.7).max() < 0.1 * step
    assert blocks.range_m[:3, :2] == pytest.approx(0.05 + 200.0 / 700.4, rel=0.01)
    assert result.range_on_parts()[:8, 8:11] == pytest.approx(0.05 + 200.0 / 700.4, rel=0.02)
    assert np.isnan(blocks.range_m[3]).all()


def test_the_grid_grows_with_the_picture():
    lens, images, lens_positions = Breathing(), [], np.linspace(1.0, 1022.0, 30).round()
    for lens_position in lens_positions:
        lens.lens_position = lens_position
        images.append(lens.read().image)
    assert measure_growth(images) == pytest.approx(0.05, abs=0.004)
    spread = [
        np.std(measure(clarity_of(images, lens_positions, 50, g), 50, None).blocks.lens_position) for g in (0.05, 0)
    ]
    assert spread[0] < 0.7 * spread[1]
    with pytest.raises(ConfigError, match=r"growth 0\.5"):
        sweep(lens, 50, quiet, 0.5)


def test_a_scene_without_texture_has_no_growth():
    assert measure_growth([np.full((200, 200), 90, np.uint8)] * 8) is None
