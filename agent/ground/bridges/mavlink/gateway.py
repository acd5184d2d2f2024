"""Between a fleet and a ground station: what each robot shows becomes its vehicle's messages, and commands orders.

Each robot is a system of its own, by its place in the fleet file, from 1 on. Nothing here opens a socket or looks at a
clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agent.core.config import ConfigError, Fleet
from agent.core.messages import LogLine, State
from agent.ground.bridges.mavlink import telling
from agent.ground.bridges.mavlink.asking import COMMANDS, EVERYBODY, ORDERS, Act, No, asked
from agent.ground.bridges.mavlink.parameters import answers, parameters
from agent.ground.bridges.mavlink.telling import Origin
from agent.ground.bridges.mavlink.vehicle import vehicle
from agent.ground.bridges.newest import Newest
from agent.ground.console import Outcome
from agent.robot.verbs import URGENT

MOST_SYSTEMS = 250  # ground stations are 255, and other programs about them 254 and so on
COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
BEAT_NS = 1_000_000_000
BEATS_AN_ORIGIN = 5
MOST_UNDER_WAY = 64  # orders that wait for an answer
READS = ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET")
READ_ONLY = "this bridge only looks; to order, start it with --as NAME"

Done = Callable[[Outcome], None]
# Gives an order to a robot and returns at once; `Done` is called with what became of it, from any thread.
Give = Callable[[str, str, Done], None]


class _Asked(NamedTuple):
    """An order that is under way, and who wants to hear of it."""

    robot: str
    act: Act
    system: int
    component: int


class Gateway:
    """`send` takes the bytes of one message; `give`: None where nobody may order."""

    def __init__(self, fleet: Fleet, origin: Origin, send: Callable[[bytes], None], give: Give | None = None) -> None:
        if len(fleet.robot) > MOST_SYSTEMS:
            raise ConfigError(f"fleet '{fleet.fleet}': MAVLink knows {MOST_SYSTEMS} vehicles at most")
        self.systems = {robot: number for number, robot in enumerate(fleet.robot, start=1)}
        self._fleet, self._origin, self._send, self._give = fleet, origin, send, give
        self._writers = {robot: mavlink.MAVLink(None, number, COMPONENT) for robot, number in self.systems.items()}
        self._parameters = {robot: parameters(fleet, robot, number) for robot, number in self.systems.items()}
        self._newest = Newest()
        self._under_way: list[_Asked] = []
        self._over: SimpleQueue[tuple[_Asked, Outcome]] = SimpleQueue()
        self._beat_ns: dict[str, int] = {}  # when each robot's heart beat last, and how often it has
        self._beats = dict.fromkeys(fleet.robot, 0)
        self._lines = 0

    def shown(self, message: State | LogLine, arrived_ns: int, wall_ns: int) -> None:
        """What a robot says to whoever looks."""
        if message.robot not in self.systems:
            return
        if isinstance(message, LogLine):
            self._say(message.robot, message)
            return
        self._newest.take(message, arrived_ns, wall_ns)
        if self._newest.fresh(message.robot, arrived_ns, wall_ns) is not None:
            told = vehicle(self._fleet.robot[message.robot], message)
            self._tell(message.robot, telling.each_state(told, self._origin))

    def tick(self, now_ns: int, wall_ns: int) -> None:
        """Beat the heart of whoever is alive, once a second, and tell what became of orders."""
        self._acknowledge()
        for robot in self.systems:
            before_ns = self._beat_ns.get(robot)
            if before_ns is not None and wall_ns - before_ns < BEAT_NS:
                continue
            if (state := self._newest.fresh(robot, now_ns, wall_ns)) is None:
                continue
            self._beat_ns[robot] = wall_ns
            told = vehicle(self._fleet.robot[robot], state)
            self._tell(robot, (telling.heartbeat(told), *telling.each_second(told, self._origin)))
            if self._beats[robot] % BEATS_AN_ORIGIN == 0:
                self._tell(robot, (telling.global_origin(self._origin),))
            self._beats[robot] += 1

    def heard(self, message: Any, now_ns: int, wall_ns: int) -> None:
        """One message of a ground station. What is for nobody here, or not understood, is passed over."""
        kind, target = message.get_type(), getattr(message, "target_system", None)
        if getattr(message, "target_component", 0) not in (0, COMPONENT):
            return
        for robot, system in self.systems.items():
            if target not in (EVERYBODY, system):
                continue
            if kind in COMMANDS and (number := _wants(message)) is not None:
                self._request(robot, message, number, now_ns, wall_ns)
            elif kind in ORDERS:
                self._order(robot, message)
            elif kind in READS:
                self._tell(robot, answers(self._parameters[robot], message))
            elif kind == "MISSION_REQUEST_LIST":
                sender = message.get_srcSystem(), message.get_srcComponent()
                kind_of = getattr(message, "mission_type", 0)
                self._tell(robot, (mavlink.MAVLink_mission_count_message(*sender, 0, kind_of),))

    def _order(self, robot: str, message: Any) -> None:
        what = asked(message)
        sender = message.get_srcSystem(), message.get_srcComponent()
        if isinstance(what, Act) and self._give is None:
            what = No(what.command, mavlink.MAV_RESULT_DENIED, READ_ONLY)
        if isinstance(what, No):
            self._deny(robot, what, *sender)
            return
        one = _Asked(robot, what, *sender)
        waits = one in self._under_way and what.verb not in URGENT  # asked again: its answer is on the way
        if self._give is None or waits or len(self._under_way) >= MOST_UNDER_WAY:
            return
        self._under_way.append(one)
        self._give(robot, what.verb, lambda outcome: self._over.put((one, outcome)))

    def _acknowledge(self) -> None:
        """By what robots answered. One that did not gets no acknowledgement: nobody knows."""
        while True:
            try:
                one, outcome = self._over.get_nowait()
            except Empty:
                return
            self._under_way.remove(one)
            if outcome.answer is None:
                self._warn(one.robot, f"{one.act.verb}: {outcome.why}")
            elif outcome.answer.ok:
                self._ack(one.robot, one.act.command, mavlink.MAV_RESULT_ACCEPTED, one.system, one.component)
            else:
                no = No(one.act.command, mavlink.MAV_RESULT_DENIED, f"{one.act.verb}: {outcome.answer.why}")
                self._deny(one.robot, no, one.system, one.component)

    def _request(self, robot: str, message: Any, number: int, now_ns: int, wall_ns: int) -> None:
        """A message that is wanted now: any of those that we send."""
        state = self._newest.fresh(robot, now_ns, wall_ns)
        can: list[Any] = [telling.version(), telling.global_origin(self._origin)]
        if state is not None:
            told = vehicle(self._fleet.robot[robot], state)
            can += (telling.heartbeat(told), *telling.each_second(told, self._origin))
            can += telling.each_state(told, self._origin)
        found = [each for each in can if each.get_msgId() == number]
        result = mavlink.MAV_RESULT_ACCEPTED if found else mavlink.MAV_RESULT_UNSUPPORTED
        self._ack(robot, message.command, result, message.get_srcSystem(), message.get_srcComponent())
        self._tell(robot, found)

    def _deny(self, robot: str, no: No, system: int, component: int) -> None:
        self._ack(robot, no.command, no.result, system, component)
        if no.result != mavlink.MAV_RESULT_UNSUPPORTED:  # which ground stations try in passing
            self._warn(robot, no.why)

    def _ack(self, robot: str, command: int, result: int, system: int, component: int) -> None:
        self._tell(robot, (mavlink.MAVLink_command_ack_message(command, result, 0, 0, system, component),))

    def _warn(self, robot: str, why: str) -> None:
        self._say(robot, LogLine(robot=robot, sent_ns=0, level="warning", text=why))

    def _say(self, robot: str, line: LogLine) -> None:
        self._lines += 1
        self._tell(robot, telling.status_texts(line.level, line.text, self._lines))

    def _tell(self, robot: str, messages: Iterable[Any]) -> None:
        writer = self._writers[robot]
        for message in messages:
            self._send(message.pack(writer))
            writer.seq = (writer.seq + 1) % 256


def _wants(message: Any) -> int | None:
    """The number of the message that is asked for; None: it is no such question."""
    if message.command == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
        return int(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    if message.command != mavlink.MAV_CMD_REQUEST_MESSAGE:
        return None
    return int(message.param1) if 0 <= message.param1 < 2**24 else -1
