"""A ground station without a socket, before a gateway. For tests that have seen that pymavlink is there."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agent.core.config import Fleet
from agent.core.messages import Answer
from agent.ground.bridges.mavlink import Gateway, Origin, Told
from agent.ground.console import Basis, Outcome
from tests.ground.bridges.states import START_NS

ARM, MODE, REQUEST = (
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_DO_SET_MODE,
    mavlink.MAV_CMD_REQUEST_MESSAGE,
)
ACCEPTED, DENIED, UNSUPPORTED = (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_UNSUPPORTED)
HERE = Origin(10.0, 20.0)


class Station:
    """A ground station without a socket; robots answer when the test says so."""

    def __init__(self, fleet: Fleet, orders: bool = True, first_system: int = 1) -> None:
        self.given: list[tuple[str, str, Callable[[Outcome], None]]] = []
        self.seen: list[Mapping[str, Basis]] = []  # by which States, of each order
        self.tell: Told | None = None  # of the newest order
        self.sent: list[bytes] = []
        self.gateway = Gateway(fleet, HERE, self.sent.append, self._give if orders else None, first_system)
        self._reader, self._writer = mavlink.MAVLink(None), mavlink.MAVLink(None, 255, 190)

    def _give(self, robots: Sequence[str], verb: str, seen: Mapping[str, Basis], everybody: bool, told: Told) -> None:
        assert everybody == (len(robots) > 1)
        self.given += [(robot, verb, partial(told, robot)) for robot in robots]
        self.seen.append(seen)
        self.tell = told

    def says(self, message: Any, system: int | None = None, now_ns: int = START_NS) -> None:
        """As it goes over the wire, to and fro. system: of another vehicle whose word a station passes on."""
        writer = self._writer if system is None else mavlink.MAVLink(None, system, 1)
        for heard in mavlink.MAVLink(None).parse_buffer(message.pack(writer)):
            self.gateway.heard(heard, now_ns, now_ns)

    def command(self, system: int, command: int, *values: float, component: int = 1) -> None:
        self.says(mavlink.MAVLink_command_long_message(system, component, command, 0, *(*values, *(0.0,) * 7)[:7]))

    def hears(self, kind: str = "") -> list[tuple[int, Any]]:
        """System and message, of those since the last call."""
        heard = [one for data in self.sent for one in self._reader.parse_buffer(data) or ()]
        self.sent.clear()
        assert all(one.get_type() != "BAD_DATA" for one in heard)
        return [(one.get_srcSystem(), one) for one in heard if one.get_type() == kind or not kind]

    def acks(self) -> list[tuple[int, int, int]]:
        return [(system, one.command, one.result) for system, one in self.hears("COMMAND_ACK")]

    def orders(self) -> list[tuple[str, str]]:
        return [(robot, verb) for robot, verb, _ in self.given]


def answer(robot: str, ok: bool = True, why: str = "") -> Outcome:
    return Outcome(Answer(robot=robot, console="ann", id=1, order="arm", ok=ok, why=why, arrived_ns=0, sent_ns=0))
