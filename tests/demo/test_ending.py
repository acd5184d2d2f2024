"""What is said while cameras are calibrated, and when a run does not come to its end."""

import io
from pathlib import Path

import pytest
from rich.console import Console

import agent.demo.demo
from agent.core.config import ConfigError
from agent.demo.demo import calibrate, demo_fleet, keeping, with_access
from agent.demo.display import how_to_look, program
from agent.process.command import Failed


class FakeCrew:
    """Its processes are done when they are waited for."""

    def __init__(self) -> None:
        self.started: list[str] = []
        self.most_at_once = self.running = 0

    def start(self, name: str, *arguments: str) -> None:
        self.started.append(name)
        self.running += 1
        self.most_at_once = max(self.most_at_once, self.running)

    def finish_one(self, timeout_s: float) -> None:
        self.running -= 1


def test_calibration_says_how_many_are_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Spinner:
        def __enter__(self):
            return said.append

        def __exit__(self, *_):
            pass

    said: list[str] = []
    monkeypatch.setattr(agent.demo.demo, "with_spinner", lambda console, what: Spinner())
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    crew = FakeCrew()
    calibrate(demo_fleet(5, "evidence", 0.0, 0, False, tmp_path), tmp_path / "fleet.toml", crew, Console())
    assert crew.started == [f"calibrate_r{k}" for k in (1, 2, 3, 4, 5)]
    assert (crew.most_at_once, crew.running) == (2, 0)
    assert [words.partition("(")[2] for words in said] == [f"{done} of 5 done)" for done in range(5)]


@pytest.mark.parametrize("ending", [KeyboardInterrupt(), SystemExit(143), Failed("r1 ended by itself")])
def test_who_ends_a_run_is_told_where_its_files_are(ending: BaseException) -> None:
    out = io.StringIO()
    with pytest.raises(type(ending)) as caught, keeping(Path("runs/one"), Console(file=out)):
        raise ending
    words = str(caught.value) if isinstance(ending, Failed) else out.getvalue()
    assert words.strip().endswith("; what there is of this run is in runs/one")


def test_bad_input_is_said_as_it_is() -> None:
    with pytest.raises(ConfigError, match=r"^bad$"), keeping(Path("runs/one"), Console(file=io.StringIO())):
        raise ConfigError("bad")


def test_how_to_look_is_ready_to_paste(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = demo_fleet(2, "evidence", 0.0, 0, False, tmp_path)
    _, console, view, router = how_to_look(fleet, Path("runs/my run/fleet.toml"))
    assert f"--mode client --connect {fleet.robot['r1'].listen} subscribe -k 'aucamp/**' " in console
    assert console.endswith("--decoder aucamp --line '{key} {value}'")
    assert view.endswith("aucamp view 'runs/my run/fleet.toml'")
    assert router.endswith("aucamp router 'runs/my run/fleet.toml'")
    monkeypatch.setattr("sys.executable", "/nowhere/python")
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    words, *_ = how_to_look(fleet, Path("fleet.toml"))
    assert words.endswith("(first: pip install zenoh-cli foxglove-sdk)")


def test_how_to_look_at_a_secured_demo_names_its_keys(tmp_path: Path) -> None:
    keys = tmp_path / "its keys"
    fleet = with_access(demo_fleet(2, "evidence", 0.0, 0, False, tmp_path), (), secure=True)
    assert fleet.secured and fleet.access.consoles == ("ann",)
    _, console, view, router = how_to_look(fleet, Path("fleet.toml"), keys)
    assert f"--config '{keys}/zenoh-cli.json5' --connect tls/127.0.0.1:" in console
    assert view.strip().startswith(f"AUCAMP_KEYS='{keys}' ") and router.strip().startswith(f"AUCAMP_KEYS='{keys}' ")
    plain = with_access(demo_fleet(2, "evidence", 0.0, 0, False, tmp_path), ("bob",), secure=False)
    assert not plain.secured and plain.access.consoles == ("bob",)
    assert not any("keys" in line for line in how_to_look(plain, Path("fleet.toml"), keys))


def test_a_program_is_named_as_a_shell_here_finds_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bin_ = tmp_path / ".venv" / "bin"
    bin_.mkdir(parents=True)
    (bin_ / "aucamp").write_text("#!/bin/sh\n")
    (bin_ / "aucamp").chmod(0o755)
    monkeypatch.setattr("sys.executable", str(bin_ / "python"))
    monkeypatch.setenv("PATH", "/usr/bin")
    monkeypatch.chdir(tmp_path)
    assert program("aucamp") == ".venv/bin/aucamp"
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert program("aucamp") == str(bin_ / "aucamp")
    assert program("zenoh") == str(bin_ / "zenoh"), "where pip would put it"
    (tmp_path / "elsewhere" / "zenoh").symlink_to(bin_ / "aucamp")
    monkeypatch.setenv("PATH", str(tmp_path / "elsewhere"))
    assert program("zenoh") == "zenoh", "not ours, but there"
    monkeypatch.setenv("PATH", str(bin_))
    assert program("aucamp") == "aucamp"
