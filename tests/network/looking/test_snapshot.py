"""The next picture of a robot that runs, and why there is none. On the wall, over real sessions."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import Fleet, dump
from agent.core.messages import Image, LogLine, State
from agent.ground import observe
from agent.ground.observe import hopeless, next_picture, target_table
from agent.process.command import Failed
from agent.process.transport import Transport

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
    assert "cannot be read (schema 1, ours is 2)" in hopeless(fleet, "r1", None, "schema 1, ours is 2")


def test_no_target_is_made_of_a_picture_that_is_none_of_the_camera(make_fleet: Fleets) -> None:
    fleet, path = make_fleet({"r1": ()}), Path("r1.jpg")
    with pytest.raises(Failed, match="raw frames"):
        target_table(fleet, "fish", path, replace(PICTURE, enhanced=True))
    with pytest.raises(Failed, match="full 640x480"):
        target_table(fleet, "fish", path, replace(PICTURE, width_px=320, height_px=240))
