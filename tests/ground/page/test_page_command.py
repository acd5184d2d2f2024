"""What cannot be shown is said in one line, and nothing is left open."""

import socket
from pathlib import Path
from threading import Event

import pytest
from msgspec.structs import replace

from agent.core.config import ConfigError, dump
from agent.core.topics import STATE
from agent.ground.page.server import run
from tests.ground.page.shown import FLEET, NOW_NS, record, row, state
from tests.network.conftest import unused_port

pytest.importorskip("websockets", reason="the extra `page` is not installed")


def never(line: str) -> None:
    raise AssertionError(line)


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    record(tmp_path / "fleet.mcap", [(NOW_NS, row(state(), STATE, robot="r1", target="ball"))])
    return tmp_path


def fleet_elsewhere(folder: Path) -> Path:
    """The file of real robots that listen to the whole network, without keys."""
    robots = {
        name: replace(each, listen=each.listen.replace("127.0.0.1", "192.168.7.11"), serial=f"/dev/{name}", camera=name)
        for name, each in FLEET.robot.items()
    }
    path = folder / "fleet.toml"
    path.write_text(dump(replace(FLEET, robot=robots, target={"ball": FLEET.target["ball"]})), encoding="utf-8")
    return path


def test_nobody_orders_a_recording_about(recorded: Path) -> None:
    with pytest.raises(ConfigError, match="leave out --as"):
        run(recorded, "ann", unused_port(), recorded, Event(), never)


def test_a_port_that_is_taken_is_named(recorded: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(ConfigError, match="choose another with --port"):
            run(recorded, None, other.getsockname()[1], recorded, Event(), never)


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"gone\.mcap"):
        run(tmp_path / "gone.mcap", None, unused_port(), tmp_path, Event(), never)
    with pytest.raises(ConfigError, match=r"gone\.toml"):
        run(tmp_path / "gone.toml", None, unused_port(), tmp_path, Event(), never)


def test_who_may_not_order_gets_no_page(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="secure the fleet"):
        run(fleet_elsewhere(tmp_path), "ann", unused_port(), tmp_path, Event(), never)


def test_a_recording_is_served_until_it_is_ended(recorded: Path) -> None:
    stop, lines = Event(), []

    def said(line: str) -> None:
        lines.append(line)
        stop.set()

    run(recorded, None, port := unused_port(), recorded, stop, said)
    assert len(lines) == 1 and f"http://127.0.0.1:{port}/#" in lines[0]
