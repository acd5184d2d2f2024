"""A fleet that mixes real devices and those of the twin has no one time: whoever would start it says so in one line."""

import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from agent.core.config import dump
from agent.core.ranging.camera_model import Calibration
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from tests.known_lens import CAMERA, PLAIN
from tests.places import ROOT


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """r2 has a real control module, all else is in the twin; r1 is ready to dive."""
    folder = tmp_path_factory.mktemp("mixed")
    fleet = load_fleet(shipped_fleet())
    robots = {**fleet.robot, "r2": msgspec.structs.replace(fleet.robot["r2"], serial="/dev/ttyACM0")}
    twin = msgspec.structs.replace(fleet.twin, dir=str(folder / "twin"))
    path = folder / "mixed.toml"
    path.write_text(dump(msgspec.structs.replace(fleet, robot=robots, twin=twin)))
    calibration = Calibration(robot="r1", made="2026-01-01", source="a test", focus=PLAIN, camera=CAMERA)
    (folder / fleet.robot["r1"].calibration).parent.mkdir()
    (folder / fleet.robot["r1"].calibration).write_text(dump(calibration))
    return path


TWO_WORLDS = "'robot.r2.serial' is a real device and 'robot.r1.serial' lives in the twin"


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("agent mixed.toml --robot r1", TWO_WORLDS),
        ("twin mixed.toml", TWO_WORLDS),
        ("record mixed.toml --out x.mcap", TWO_WORLDS),
        ("demo --fleet mixed.toml", "key 'robot.r2.serial': '/dev/ttyACM0' is not in the twin, where the demo dives"),
    ],
)
def test_it_is_refused(mixed: Path, command: str, said: str) -> None:
    before = {path.name for path in mixed.parent.iterdir()}
    done = subprocess.run(
        [sys.executable, "-m", "agent", *command.split()],
        cwd=mixed.parent,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert said in done.stderr
    assert {path.name for path in mixed.parent.iterdir()} == before


def test_its_file_can_be_read(mixed: Path) -> None:
    assert load_fleet(mixed).robot["r2"].serial == "/dev/ttyACM0"
