"""`aucamp bridge mavlink` over real links, with pymavlink's own `mavutil` as the ground station."""

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

pytest.importorskip("pymavlink", reason="pip install 'aucamp[mavlink]'")
os.environ.setdefault("MAVLINK20", "1")  # mavutil looks for it when it is imported
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agent.clock import machine
from agent.core.codec import decode
from agent.core.config import Fleet, dump
from agent.core.messages import Order
from agent.ground.bridges import mavlink as bridge
from agent.ground.bridges.mavlink import Origin, run
from tests.network.conftest import unused_port
from tests.network.orders.answering import Loop
from tests.network.secured.parties import secure
from tests.waiting import until

CHAIN = {"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2",)}
PATIENCE_S = 30.0  # of the wall: a machine may be busy
QUIET_S = 1.0
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM


class Dive(NamedTuple):
    station: Any  # mavutil's
    robots: dict[str, Loop]

    def taken(self) -> list[tuple[str, str, str]]:
        """Robot, console and verb of every order that arrived."""
        return [
            (name, one.console, decode(one.payload, Order).verb)
            for name, robot in self.robots.items()
            for one in robot.taken
        ]

    def systems(self, seconds: float = PATIENCE_S, want: int = 3) -> set[int]:
        """Whose heart beats, as the ground station hears it, until there are so many."""
        found: set[int] = set()
        ends_s = time.monotonic() + seconds
        while len(found) < want and time.monotonic() < ends_s:
            if (beat := self.station.recv_match(type="HEARTBEAT", blocking=True, timeout=0.2)) is not None:
                found.add(beat.get_srcSystem())
        return found

    def ack(self, command: int, seconds: float = PATIENCE_S) -> tuple[int, int] | None:
        """System and result of the next acknowledgement of this command."""
        ends_s = time.monotonic() + seconds
        while (left_s := ends_s - time.monotonic()) > 0:
            one = self.station.recv_match(type="COMMAND_ACK", blocking=True, timeout=left_s)
            if one is not None and one.command == command:
                return one.get_srcSystem(), one.result
        return None


@pytest.fixture
def dive(make_fleet: Callable[..., Fleet], tmp_path: Path) -> Callable[..., Any]:
    @contextmanager
    def begin(console: str | None) -> Iterator[Dive]:
        """Three robots with certificates, a bridge and a ground station."""
        fleet, path = secure(make_fleet(CHAIN), tmp_path / "keys"), tmp_path / "fleet.toml"
        port, stop = unused_port(), threading.Event()
        path.write_text(dump(fleet))
        robots = {name: Loop(fleet, name, tmp_path / "keys") for name in fleet.robot}
        station = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255)
        loop = threading.Thread(
            target=run, args=(fleet, path, console, port, Origin(0.0, 0.0), stop, lambda line: None)
        )
        try:
            for robot in robots.values():
                robot.transport.__enter__()
                robot.start()
            loop.start()
            yield Dive(station, robots)
        finally:
            stop.set()
            loop.join()
            station.close()
            for robot in robots.values():
                robot.ends.set()
                robot.join()
                robot.transport.__exit__(None, None, None)

    return begin


def test_a_ground_station_sees_three_and_orders_the_one_that_it_means(dive) -> None:
    with dive("ann") as here:
        assert here.systems() == {1, 2, 3}
        here.station.target_system, here.station.target_component = 1, 1
        here.station.arducopter_arm()
        assert here.ack(ARM) == (1, mavlink.MAV_RESULT_ACCEPTED)
        here.station.target_system = 3
        here.station.mav_type = mavlink.MAV_TYPE_SUBMARINE
        here.station.set_mode_apm(9)
        assert here.ack(mavlink.MAV_CMD_DO_SET_MODE) == (3, mavlink.MAV_RESULT_ACCEPTED)
        assert here.taken() == [("r1", "ann", "arm"), ("r3", "ann", "surface")]

        here.station.target_system = 0
        here.station.arducopter_arm()
        assert here.ack(ARM)[1] == mavlink.MAV_RESULT_DENIED
        here.station.arducopter_disarm()
        until(lambda: [verb for _, _, verb in here.taken()].count("disarm") == 3, PATIENCE_S)
        assert [verb for _, _, verb in here.taken()].count("arm") == 1


def test_one_that_hangs_is_not_acknowledged_and_its_heart_stops(dive) -> None:
    with dive("ann") as here:
        assert here.systems() == {1, 2, 3}
        hung = here.robots["r2"]
        hung.works.clear()
        here.station.target_system, here.station.target_component = 2, 1
        here.station.arducopter_arm()
        assert here.ack(ARM, 2.5) is None
        hung.shows = False
        time.sleep(4.0)  # three seconds, and what was on the way
        while here.station.recv_match(blocking=False) is not None:
            pass
        assert here.systems(2.5) == {1, 3}


def test_what_a_ground_station_said_while_the_bridge_slept_is_dropped(dive, monkeypatch: pytest.MonkeyPatch) -> None:
    arrived, since_boot_s, slept_s = bridge._arrived, machine.since_boot_s, [0.0]

    def sleeps(link: socket.socket, stop: threading.Event) -> list[Any]:
        """Once, while an order comes."""
        messages = arrived(link, stop)
        if not slept_s[0] and any(one.get_type() == "COMMAND_LONG" for one in messages):
            slept_s[0] = 6.0
        return messages

    monkeypatch.setattr(bridge, "_arrived", sleeps)
    monkeypatch.setattr(machine, "since_boot_s", lambda: since_boot_s() + slept_s[0])
    with dive("ann") as here:
        assert here.systems() == {1, 2, 3}
        here.station.target_system, here.station.target_component = 1, 1
        here.station.arducopter_arm()
        until(lambda: slept_s[0] > 0.0)
        assert here.ack(ARM, QUIET_S) is None and here.taken() == []
        here.station.arducopter_disarm()
        assert here.ack(ARM) == (1, mavlink.MAV_RESULT_ACCEPTED)
        assert here.taken() == [("r1", "ann", "disarm")]


def test_who_looks_only_looks(dive) -> None:
    with dive(None) as here:
        assert here.systems() == {1, 2, 3}
        here.station.target_system, here.station.target_component = 1, 1
        here.station.arducopter_disarm()
        assert here.ack(ARM) == (1, mavlink.MAV_RESULT_DENIED)
        time.sleep(QUIET_S)
        assert here.taken() == []


def test_a_datagram_of_another_port_is_nobodys(dive) -> None:
    with dive("ann") as here, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        assert here.systems() == {1, 2, 3}
        port = next(iter(here.station.clients))
        arm = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1.0, *(0.0,) * 6).pack(mavlink.MAVLink(None, 255, 1))
        for _ in range(20):
            stranger.sendto(arm, port)
        time.sleep(QUIET_S)
        assert here.taken() == []
        here.station.write(arm)  # the very same bytes, from the port that it talks to
        assert here.ack(ARM) == (1, mavlink.MAV_RESULT_ACCEPTED)
