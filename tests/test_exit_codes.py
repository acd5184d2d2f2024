"""Exit codes: what runs until it is ended gives 0 when it is; see agent/__main__.py.

That Ctrl-C of a command that would have ended by itself gives 130 is seen in test_command_line.py.
"""

import importlib.util
import signal
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.__main__ import app, command_line
from agent.core.config import ConfigError, dump
from agent.core.ranging.camera_model import Calibration
from agent.demo.demo import demo_fleet
from agent.process import launch
from agent.process.command import Failed, new_recording, shipped_names, temporary_folder
from agent.process.launch import free_ports
from tests.known_lens import TWIN, TWIN_CAMERA

WITHOUT_VIEW = pytest.mark.skipif(not importlib.util.find_spec("foxglove"), reason="the extra `view` is not installed")

WITHOUT_MAVLINK = pytest.mark.skipif(
    not importlib.util.find_spec("pymavlink"), reason="the extra `mavlink` is not installed"
)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("agent", "fleet.toml", "--robot", "r1"), 0),
        (("twin", "fleet.toml"), 0),
        (("router", "fleet.toml", "--listen", "tcp/127.0.0.1:PORT"), 0),
        pytest.param(("view", "fleet.toml", "--port", "PORT"), 0, marks=WITHOUT_VIEW),
        pytest.param(("bridge", "mavlink", "fleet.toml"), 0, marks=WITHOUT_MAVLINK),
        (("record", "fleet.toml", "--out", "fleet.mcap"), 1),  # nothing was recorded
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_what_runs_until_it_is_ended_may_be_ended(
    arguments: tuple[str, ...], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with temporary_folder() as folder:
        fleet = demo_fleet(1, "evidence", 0.0, 0, False, folder)
        Path("fleet.toml").write_text(dump(fleet))
        Path("calibration").mkdir()
        known = Calibration(robot="r1", made="2026-01-01", source="a test", focus=TWIN, camera=TWIN_CAMERA)
        Path("calibration/r1.toml").write_text(dump(known))
        monkeypatch.setattr(launch, "_asked", [signal.SIGTERM])  # it came while the command was starting
        port = str(free_ports(1)[0])
        done = CliRunner().invoke(app, [argument.replace("PORT", port) for argument in arguments])
    assert done.exit_code == code, done.output
    assert done.exception is None or isinstance(done.exception, (SystemExit, Failed))
    assert {path.name for path in tmp_path.iterdir()} == {"fleet.toml", "calibration"}


@pytest.mark.parametrize("name", ["x.txt", "none/x", "."])
def test_a_recording_that_would_not_be_found_again_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"the name of a recording ends in .mcap; give --out such a name"):
        new_recording(tmp_path / name)
    (tmp_path / "x.mcap").touch()
    with pytest.raises(ConfigError, match="is there already"):
        new_recording(tmp_path / "x.mcap")
    assert new_recording(tmp_path / "y.mcap") == tmp_path / "y.mcap"


def test_what_ships_is_listed_from_the_folder() -> None:
    shown = CliRunner(env={"COLUMNS": "200"}).invoke(app, ["demo", "--help"]).output
    assert f"A fleet that ships ({', '.join(shipped_names())}), or a fleet file." in shown
    assert {"tank", "two_balls"} <= set(shipped_names())


def test_the_version_is_said() -> None:
    said = CliRunner().invoke(app, ["--version"])
    assert said.exit_code == 0 and said.output.startswith("aucamp 0.") and ", commit " in said.output


def test_a_flag_has_no_type_in_help(capsys: pytest.CaptureFixture[str]) -> None:
    for verb in ("demo", "agent"):
        command_line()(args=[verb, "--help"], prog_name="aucamp", standalone_mode=False)
    shown = capsys.readouterr().out
    assert "--secure" in shown and "--lossless" in shown and "<path>" in shown
    assert "<bool>" not in shown
