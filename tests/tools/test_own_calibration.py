"""An agent believes a calibration file only if it is that of its own camera."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from msgspec.structs import replace

from agent.core.config import ConfigError, Fleet, dump
from agent.core.ranging.camera_model import Calibration
from agent.process.agent_process import own_calibration
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from tests.known_lens import CAMERA, PLAIN

FLEET = load_fleet(shipped_fleet())
KNOWN = Calibration(robot="r1", made="2026-01-01", source="test", focus=PLAIN, camera=CAMERA)


def believed(tmp_path: Path, calibration: Calibration | dict[str, Any] | None, fleet: Fleet = FLEET) -> Calibration:
    file = tmp_path / fleet.robot["r1"].calibration
    file.parent.mkdir()
    if calibration is not None:
        file.write_text(tomli_w.dumps(calibration) if isinstance(calibration, dict) else dump(calibration))
    return own_calibration(fleet, "r1", tmp_path / "fleet.toml")


def test_ones_own_is_believed(tmp_path: Path) -> None:
    assert believed(tmp_path, KNOWN) == KNOWN


@pytest.mark.parametrize("table", ["focus", "camera"])
def test_a_table_that_is_missing_is_named_with_what_makes_it(tmp_path: Path, table: str) -> None:
    content = tomllib.loads(dump(KNOWN))
    del content[table]
    with pytest.raises(ConfigError, match=rf"r1\.toml: has no table \[{table}\]; add it by `aucamp calibrate {table}`"):
        believed(tmp_path, content)


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
