"""Several fleets looked at by one process: what belongs to one is in its recording alone, and none ends another's."""

import contextlib
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import msgspec
import pytest

from agent.core.codec import decode
from agent.core.config import Access, ConfigError, Fleet, dump
from agent.core.messages import State
from agent.ground.new_fleet import make_all
from agent.ground.observe import at_once, keys_of, load_fleets, recordings_of
from agent.process.transport import Transport
from replay.files.log import info, read
from tests.places import ROOT
from tests.waiting import until

PAIR = {"r1": ("r2",), "r2": ("r1",)}


@pytest.fixture
def fleets(make_fleet, tmp_path: Path) -> dict[str, Fleet]:
    """Three fleets whose robots have the same names, in files; "west" has certificates."""
    made = {}
    for name in ("east", "west", "empty"):
        made[name] = msgspec.structs.replace(make_fleet(PAIR), fleet=name)
        if name == "west":
            made[name] = secured(made[name], tmp_path / "west_keys")
        (tmp_path / f"{name}.toml").write_text(dump(made[name]))
    return made


def test_each_fleet_has_a_recording_of_its_own(fleets, state, tmp_path: Path) -> None:
    files = [str(tmp_path / f"{name}.toml") for name in fleets]
    out = tmp_path / "dive"
    command = [sys.executable, "-m", "agent", "record", *files, "--out", str(out)]
    shown = 0
    with contextlib.ExitStack() as stack:
        piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        recorder = stack.enter_context(subprocess.Popen(command, cwd=ROOT, **piped))
        stack.callback(recorder.kill)
        robots = [
            (name, stack.enter_context(Transport(fleets[name], robot, time.time_ns, keys)), robot)
            for name, keys in (("east", None), ("west", tmp_path / "west_keys"))
            for robot in PAIR
        ]

        def enough() -> bool:
            nonlocal shown
            shown += 1
            for name, transport, robot in robots:
                transport.show(msgspec.structs.replace(state(robot, shown), fleet=name))
            time.sleep(0.02)
            return all(len(states(out / f"{name}.mcap.active")) > 40 for name in ("east", "west"))

        until(enough)
        recorder.send_signal(signal.SIGTERM)
        said, complained = recorder.communicate(timeout=60)
    assert recorder.returncode == 1, complained
    assert "nobody of fleet 'empty' was heard" in complained.splitlines()[-1]
    assert "Traceback" not in complained
    assert sorted(path.name for path in out.iterdir()) == ["east.mcap", "west.mcap"]
    for name, line in zip(("east", "west"), said.splitlines(), strict=True):
        assert line.startswith(f"fleet '{name}': recorded: ")
        about = info(out / f"{name}.mcap")
        assert about.complete and about.run["fleet"] == name
        assert about.attachments["fleet.toml"] == dump(fleets[name])
        keys = [channel for channel in about.channels if channel.startswith("/zenoh/")]
        assert keys and all(key.startswith(f"/zenoh/aucamp/{name}/") for key in keys)
        assert {decode(data, State).fleet for data in states(out / f"{name}.mcap")} == {name}


def secured(fleet: Fleet, keys: Path) -> Fleet:
    replace = msgspec.structs.replace
    robots = {name: replace(robot, listen=robot.listen.replace("tcp/", "tls/")) for name, robot in fleet.robot.items()}
    fleet = replace(fleet, robot=robots, access=Access(keys=keys.name))
    make_all(fleet, keys)
    return fleet


def test_one_folder_of_keys_is_not_that_of_several_fleets(fleets, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("AUCAMP_KEYS", str(tmp_path / "west_keys"))
    both = load_fleets([tmp_path / "east.toml", tmp_path / "west.toml"])
    with pytest.raises(ConfigError, match="AUCAMP_KEYS names the keys of one fleet"):
        keys_of(both, "recorder")
    alone = load_fleets([tmp_path / "west.toml"])
    assert keys_of(alone, "recorder") == {tmp_path / "west.toml": tmp_path / "west_keys"}
    monkeypatch.delenv("AUCAMP_KEYS")
    assert list(keys_of(both, "recorder").values()) == [None, tmp_path / "west_keys"]


def states(path: Path) -> list[bytes]:
    if not path.exists():
        return []
    return [item.data for item in read(path) if item.channel.startswith("/zenoh/") and "/state" in item.channel]


def test_two_fleets_of_one_name_are_refused(fleets, tmp_path: Path) -> None:
    copy = tmp_path / "copy.toml"
    copy.write_text((tmp_path / "east.toml").read_text())
    with pytest.raises(ConfigError, match=r"copy.toml: fleet 'east', as .*east.toml is"):
        load_fleets([tmp_path / "east.toml", tmp_path / "west.toml", copy])


def test_several_fleets_want_a_folder_and_nothing_is_overwritten(fleets, tmp_path: Path) -> None:
    both = [fleets["east"], fleets["west"]]
    with pytest.raises(ConfigError, match="give --out a folder"):
        recordings_of(both, tmp_path / "x.mcap")
    (tmp_path / "west.mcap").touch()
    with pytest.raises(ConfigError, match=r"west.mcap: is there already"):
        recordings_of(both, tmp_path)
    assert recordings_of(both[:1], tmp_path / "one.mcap") == {"east": tmp_path / "one.mcap"}


def test_one_that_cannot_go_on_ends_no_other() -> None:
    stop, lines = threading.Event(), []

    def bad(say) -> int:
        raise ConfigError("disk full")

    def good(say) -> int:
        until(lambda: lines)
        say("heard")
        stop.set()
        return 7

    assert at_once({"a": bad, "b": good}, stop, lines.append) == ({"b": 7}, ["fleet 'a': disk full"])
    assert lines == ["fleet 'a': disk full", "fleet 'b': heard"]


def test_what_nobody_expected_ends_all() -> None:
    stop = threading.Event()

    def broken(say) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        at_once({"a": broken, "b": lambda say: stop.wait(60.0)}, stop, print)
    assert stop.is_set()


def test_one_alone_is_as_it_always_was() -> None:
    lines = []
    assert at_once({"a": lambda say: say("here") or 3}, threading.Event(), lines.append) == ({"a": 3}, [])
    assert lines == ["here"]
