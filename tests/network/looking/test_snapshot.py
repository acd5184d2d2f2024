"""The next picture of a robot that runs, and why there is none. On the wall, over real sessions."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.codec import decode
from agent.core.config import Access, ConfigError, Fleet, dump
from agent.core.messages import Image, LogLine, State
from agent.ground import observe
from agent.ground.new_fleet import make_all
from agent.ground.observe import at_once, hopeless, keys_of, load_fleets, next_picture, recordings_of, target_table
from agent.process.command import Failed
from agent.process.transport import Transport
from replay.files.log import info, read
from tests.killing import killed_after
from tests.places import ROOT
from tests.waiting import until

JPEG = b"\xff\xd8\xff whatever a camera gives"
PICTURE = Image(
    robot="r1", seq=1, sent_ns=2, t_ns=1, frame=7, width_px=640, height_px=480, enhanced=False, focus=412, jpeg=JPEG
)
Fleets = Callable[..., Fleet]
Shows = Callable[..., State]


@contextmanager
def showing(fleet: Fleet, *messages: State | LogLine | Image, robot: str = "r1") -> Iterator[None]:
    """A robot that shows these again and again."""
    stop = threading.Event()

    def show() -> None:
        while not stop.wait(0.02):
            for message in messages:
                link.show(message)

    with Transport(fleet, robot, time.time_ns) as link:
        thread = threading.Thread(target=show)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


def test_the_picture_is_written_as_it_came_and_never_over_another(make_fleet: Fleets, tmp_path: Path) -> None:
    fleet, path, out = make_fleet({"r1": ()}), tmp_path / "fleet.toml", tmp_path / "r1.jpg"
    path.write_text(dump(fleet))
    arguments = ["snapshot", str(path), "--robot", "r1", "--out", str(out), "--target", "fish"]
    with showing(fleet, PICTURE):
        done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert out.read_bytes() == JPEG
    said = done.output.splitlines()
    assert said[0].startswith(f"{out}: frame 7 of r1, 640x480 pixels") and "lens position 412, as the camera" in said[0]
    assert "[target.fish]" in said and 'picture = "r1.jpg"   # beside the fleet file' in said
    again = CliRunner().invoke(app, arguments)
    assert "is there already" in str(again.exception)


def test_who_is_not_heard_and_who_has_no_picture(
    make_fleet: Fleets, state: Shows, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(observe, "HEARD_S", 0.5)
    monkeypatch.setattr(observe, "PICTURE_S", 1.5)
    fleet = make_fleet({"r1": ("r2",), "r2": ("r1",)})
    with showing(fleet, state("r1")):
        with pytest.raises(Failed, match=r"^r2 is not heard at tcp/127.0.0.1:\d+: start its agent, or give the fleet"):
            next_picture(fleet, "r2")
        monkeypatch.setattr(observe, "HEARD_S", 60.0)
        with pytest.raises(Failed, match=r"showed no picture in 2 s: .* try again"):
            next_picture(fleet, "r1")


def test_why_no_picture_is_to_be_expected(make_fleet: Fleets, state: Shows) -> None:
    fleet = make_fleet({"r1": ()})
    dark = replace(fleet, link=replace(fleet.link, preview_hz=0.0))
    blind = replace(state("r1"), faults=("motors off", "no camera: unplugged"))
    assert hopeless(fleet, "r1", state("r1"), "") == ""
    assert "preview_hz is 0; set it, and start the agent again" in hopeless(dark, "r1", state("r1"), "")
    assert hopeless(fleet, "r1", blind, "") == "r1 is heard, but has no picture: no camera: unplugged"
    assert "cannot be read (schema 1, ours is 3)" in hopeless(fleet, "r1", None, "schema 1, ours is 3")


def test_no_target_is_made_of_a_picture_that_is_none_of_the_camera(make_fleet: Fleets) -> None:
    fleet, path = make_fleet({"r1": ()}), Path("r1.jpg")
    with pytest.raises(Failed, match="raw frames"):
        target_table(fleet, "fish", path, replace(PICTURE, enhanced=True))
    with pytest.raises(Failed, match="full 640x480"):
        target_table(fleet, "fish", path, replace(PICTURE, width_px=320, height_px=240))


def test_the_table_of_a_target_is_toml_whatever_the_picture_is_called(make_fleet: Fleets) -> None:
    table = target_table(make_fleet({"r1": ()}), "fish", Path('a"b\\.jpg'), PICTURE)
    told = tomllib.loads(table.replace("X, Y, WIDTH, HEIGHT", "1, 2, 3, 4"))
    assert told["target"]["fish"]["picture"] == 'a"b\\.jpg'


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("My stone", "--target My stone: a name is a small letter and up to 15 small letters"),
        ("ball", "--target ball: the fleet file has a target of that name"),
    ],
)
def test_a_name_that_the_fleet_file_cannot_take_is_refused_before_a_picture_is_taken(
    make_fleet: Fleets, tmp_path: Path, name: str, said: str
) -> None:
    fleet, out = tmp_path / "fleet.toml", tmp_path / "p.jpg"
    fleet.write_text(dump(make_fleet({"r1": ()})))
    called = ["snapshot", str(fleet), "--robot", "r1", "--out", str(out), "--target", name]
    assert str(CliRunner().invoke(app, called, standalone_mode=False).exception).startswith(said)
    assert not out.exists()


# --- messages page ---
# The Python of docs/messages.md runs as it stands there, but for the address.

PAGE = (ROOT / "docs" / "messages.md").read_text(encoding="utf-8")
HERE = "tcp/127.0.0.1:17401"  # in the page


def test_ten_lines_of_python_print_what_a_robot_knows(
    make_fleet: Callable[..., Fleet], state: Callable[..., State], tmp_path
) -> None:
    fleet, script, printed = make_fleet({"r1": ()}), tmp_path / "ten_lines.py", tmp_path / "printed"
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert HERE in block
    text = block.replace(HERE, fleet.robot["r1"].listen)
    assert len(text.strip().splitlines()) <= 11 and "agent" not in text
    script.write_text(text)
    with Transport(fleet, "r1", time.time_ns) as r1, printed.open("wb") as out:
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        process = subprocess.Popen([sys.executable, str(script)], stdout=out, stderr=out, env=environment, cwd=tmp_path)
        with killed_after({"ten lines": process}):

            def heard() -> bool:
                r1.show(state("r1"))
                return b"\n" in printed.read_bytes()

            until(heard)
    assert printed.read_text().splitlines()[0] == "r1 blind ball None"


# --- fleets at once ---
# Several fleets looked at by one process: what belongs to one is in its recording alone, and none ends another's.

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
