"""An agent believes a calibration file only if it is that of its own camera."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from msgspec.structs import replace

from agent.core.config import ConfigError, Coverage, Fleet, Lighting, Ranging, WaterOptics, dump
from agent.core.ranging.camera_model import Calibration, load_focus
from agent.process.agent_process import own_calibration
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from agent.robot.step import Agent
from tests.known_lens import CAMERA, PLAIN

FLEET = load_fleet(shipped_fleet())
KNOWN = Calibration(robot="r1", made="2026-01-01", source="test", focus=PLAIN, camera=CAMERA)
NIGHT = Lighting(water=WaterOptics(absorption_per_m=(0.1, 0.1, 0.1), scattering_per_m=(0.1, 0.1, 0.1)))


def believed(tmp_path: Path, calibration: Calibration | dict[str, Any] | None, fleet: Fleet = FLEET) -> Calibration:
    file = tmp_path / fleet.robot["r1"].calibration
    file.parent.mkdir()
    if calibration is not None:
        file.write_text(tomli_w.dumps(calibration) if isinstance(calibration, dict) else dump(calibration))
    return own_calibration(fleet, "r1", tmp_path / "fleet.toml")


def test_ones_own_is_believed(tmp_path: Path) -> None:
    assert believed(tmp_path, KNOWN) == KNOWN


def test_a_table_that_is_missing_is_named_with_what_makes_it(tmp_path: Path) -> None:
    content = tomllib.loads(dump(KNOWN))
    del content["camera"]
    with pytest.raises(ConfigError, match=r"r1\.toml: has no table \[camera\]; add it by `aucamp calibrate camera`"):
        believed(tmp_path, content)


def test_a_focus_that_is_fixed_needs_no_table_but_for_what_sweeps(tmp_path: Path) -> None:
    fixed = replace(KNOWN, focus=None)
    assert believed(tmp_path, fixed) == fixed
    with pytest.raises(ConfigError, match=r"r1\.toml: has no table \[focus\].* sweeps the lens; .*calibrate focus"):
        load_focus(tmp_path / FLEET.robot["r1"].calibration)
    for asked, what in (("coverage", Coverage()), ("lighting", NIGHT), ("ranging", Ranging(cues="focus"))):
        with pytest.raises(ConfigError, match=rf"{asked}.* needs a lens that sweeps, and the camera of r1") as caught:
            Agent(replace(FLEET, **{asked: what}), "r1", fixed, 7)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("calibration", "fleet", "says"),
    [
        (None, FLEET, "make it with: aucamp calibrate run .*fleet.toml --robot r1"),
        (replace(KNOWN, robot="r2"), FLEET, "key 'robot': made for 'r2', not 'r1'"),
        (KNOWN, replace(FLEET, camera=replace(FLEET.camera, width_px=1280)), "640x480, .* has 1280x480"),
    ],
)
def test_another_is_one_line(tmp_path: Path, calibration: Calibration | None, fleet: Fleet, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        believed(tmp_path, calibration, fleet)
    assert "\n" not in str(caught.value)
