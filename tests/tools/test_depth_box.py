"""The range of one thing in a box: one clear peak or a reason, in a picture that grows as well."""

import json
import math
import sys

import numpy as np
import pytest
from msgspec.structs import replace

from agent.__main__ import main
from agent.core.config import ConfigError, dump
from agent.perception.depth_peaks import BoxRange, box_clarity, box_range
from agent.perception.tracking.appearance import Box
from agent.tools.depth_map import run
from tests.tools.planes import CALIBRATION, FOCUS, Breathing

REFUSALS = {"20,115,80,40": "no texture", "70,10,100,80": "no single peak"}


def test_the_thing_in_a_box_has_one_range(planes, tmp_path):
    focus = replace(FOCUS, b_m=0.1, rho0=0.0, covariance=(1e-6, 0.0, 0.0, 0.0, 0.0, 0.0), noise=0.002)
    (tmp_path / "r1.toml").write_text(dump(replace(CALIBRATION, focus=focus)))
    said = run(str(planes), tmp_path / "map.png", 40, tmp_path / "r1.toml", box="140,20,80,60")
    found = json.loads((tmp_path / "map.json").read_text())
    assert found["box_px"] == [140, 20, 80, 60]
    assert found["position"] == pytest.approx(0.388, abs=0.1 * 0.05) and 0.0 < found["sigma"] < 0.01
    assert found["quality"] > 0.95
    assert found["range_m"] == pytest.approx(0.05 + 0.1 / found["position"])
    slope = 0.1 / found["position"] ** 2  # dh/drho
    assert found["range_sigma_m"] == pytest.approx(math.hypot(slope * max(found["sigma"], 0.002), 1e-3))
    assert said.splitlines()[-1].startswith(f"in the box: {found['range_m']:.4f} m +- ")
    assert "map.json" in said.splitlines()[0]


def test_a_box_keeps_its_piece_of_a_picture_that_grows():
    lens, lens_positions = Breathing(), np.linspace(1.0, 1022.0, 30).round()
    images = []
    for lens_position in lens_positions:
        lens.lens_position = lens_position
        images.append(lens.read().image)
    boxes = [Box(x, x, side, side) for x in (10.0, 190.0) for side in (60.0, 100.0)]
    spread = []
    for size in (0.95 + 0.05 * lens_positions / 1023, np.ones(30)):
        found = [box_range(lens_positions, box_clarity(images, size, box), box, None) for box in boxes]
        assert all(isinstance(one, BoxRange) and one.range_m is None for one in found)
        spread.append(np.ptp([one.lens_position for one in found]))
    assert spread[0] < 0.5 * spread[1]


@pytest.mark.parametrize("box", REFUSALS)
def test_a_thing_without_one_clear_peak_is_refused_in_a_line(planes, tmp_path, box, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["aucamp", "depth-map", str(planes), "--block", "40", "--box", box])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err.strip().splitlines()
    assert ended.value.code == 1 and said[-1].startswith(f"aucamp: box {box}: ") and REFUSALS[box] in said[-1]
    assert (tmp_path / "depth.png").exists() and not (tmp_path / "depth.json").exists()


@pytest.mark.parametrize(
    ("box", "expected"),
    [
        ("200,10,80,40", "240x160"),
        ("10,10,0,40", "at least 8 pixels"),
        ("1,2,3", "four numbers"),
        ("a", "four numbers"),
    ],
)
def test_a_box_that_cannot_be(planes, tmp_path, box, expected):
    with pytest.raises(ConfigError, match=expected) as caught:
        run(str(planes), tmp_path / "map.png", 40, None, box=box)
    assert "\n" not in str(caught.value) and not (tmp_path / "map.png").exists()
