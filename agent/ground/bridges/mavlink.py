"""`aucamp bridge mavlink`: a fleet as vehicles of a ground station: messages, commands, parameters, and the socket to
one station on this machine with the threads in which orders wait.

MAVLink as it is used has no keys: who holds the port is believed. So it is a port of this machine, and a datagram from
any other does not reach us.
"""

from __future__ import annotations

import math
import socket
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from threading import Event
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agent.clock import machine
from agent.core.config import ConfigError, Fleet
from agent.core.messages import Level, LogLine, State
from agent.core.robot_view import robot_view
from agent.core.topics import LOG, STATE
from agent.core.verbs import URGENT
from agent.ground.bridges.outward import ALT_HOLD, SURFACING, Newest, Vehicle, held, numbered, own_word, taken, vehicle
from agent.ground.console import Basis, OrderConsole, Outcome
from agent.process.certificates import credentials
from agent.process.transport import LOOKER, Observer, fleet_clock

# --- a vehicle as messages ---
# A vehicle as messages of MAVLink. Pure; what is not known is marked as such, or left out. Source: common.xml.

EARTH_M = 6_378_137.0  # equatorial radius of WGS84
NONE16, MOST32 = 2**16 - 1, 2**32 - 1  # not known; the most that an uint32 says
MOST_M, MOST_DEG = 2e6, 214.0  # beyond, an int32 cannot say it in millimetres, in 1e-7 degrees
PRESSURE, CAMERA, MOTORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE,
    mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION,
    mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS,
)
SEVERITY: dict[Level, int] = {
    "info": mavlink.MAV_SEVERITY_INFO,
    "warning": mavlink.MAV_SEVERITY_WARNING,
    "error": mavlink.MAV_SEVERITY_ERROR,
}
TEXT_BYTES = 50  # of one STATUSTEXT
NO_FIX, FLAT, STATIC = mavlink.GPS_FIX_TYPE_NO_FIX, mavlink.GPS_FIX_TYPE_2D_FIX, mavlink.GPS_FIX_TYPE_STATIC


class Origin(NamedTuple):
    """Where on earth the tank's corner is said to be: ground stations want to draw a map."""

    latitude_deg: float
    longitude_deg: float

    def place(self, north_m: float | None, east_m: float | None) -> tuple[int, int] | None:
        """Latitude and longitude, 1e-7 degrees; None where they are not known, or too far away to be said."""
        if north_m is None or east_m is None:
            return None
        latitude = self.latitude_deg + math.degrees(north_m / EARTH_M)
        longitude = self.longitude_deg + math.degrees(east_m / EARTH_M / math.cos(math.radians(self.latitude_deg)))
        if max(abs(latitude), abs(longitude)) > MOST_DEG:
            return None
        return round(latitude * 1e7), round(longitude * 1e7)


def down_mm(v: Vehicle) -> int | None:
    """None where its depth is not known, or more than can be said."""
    return None if v.depth_m is None or abs(v.depth_m) > MOST_M else round(1000.0 * v.depth_m)


def heartbeat(v: Vehicle) -> Any:
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if v.armed else 0)
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_SUBMARINE, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base, v.mode, v.status, 3
    )


def each_second(v: Vehicle, origin: Origin) -> Iterator[Any]:
    """Beside the heartbeat: how its parts are, and how surely it knows where it is."""
    enabled = PRESSURE | CAMERA | (MOTORS if v.armed else 0)
    health = MOTORS | (PRESSURE if v.pressure_works else 0) | (CAMERA if v.camera_works else 0)
    parts = (PRESSURE | CAMERA | MOTORS, enabled, health)
    battery_mv = NONE16 if v.battery_v is None else 1000.0 * v.battery_v
    battery_mv = round(battery_mv) if 0.0 <= battery_mv < NONE16 else NONE16
    yield mavlink.MAVLink_sys_status_message(*parts, 0, battery_mv, -1, -1, 0, 0, 0, 0, 0, 0)
    if (place := origin.place(v.north_m, v.east_m)) is None:
        yield mavlink.MAVLink_gps_raw_int_message(0, NO_FIX, 0, 0, 0, NONE16, NONE16, NONE16, NONE16, 255)
        return
    fix = STATIC if v.place_sigma_m is None else mavlink.GPS_FIX_TYPE_3D_FIX
    down, sigma_mm = down_mm(v), 1000.0 * (v.place_sigma_m or 0.0)
    yield mavlink.MAVLink_gps_raw_int_message(
        v.boot_ms * 1000,
        FLAT if down is None else fix,
        *place,
        -(down or 0),
        NONE16,  # dilutions of precision, speed and course
        NONE16,
        NONE16,
        NONE16,
        255,  # satellites
        h_acc=round(sigma_mm) if 0.0 <= sigma_mm < MOST32 else MOST32,
    )


def each_state(v: Vehicle, origin: Origin) -> Iterator[Any]:
    """How it hangs, where it is. Rates are not known, and 0: these messages have no word for that."""
    if v.roll_rad is not None and v.pitch_rad is not None and v.yaw_rad is not None:
        yield mavlink.MAVLink_attitude_message(v.boot_ms, v.roll_rad, v.pitch_rad, v.yaw_rad, 0.0, 0.0, 0.0)
    if v.depth_m is None or (down := down_mm(v)) is None:
        return
    heading_deg = None if v.yaw_rad is None else math.degrees(v.yaw_rad) % 360.0
    if (place := origin.place(v.north_m, v.east_m)) is not None:
        heading = NONE16 if heading_deg is None else round(100.0 * heading_deg) % 36000
        yield mavlink.MAVLink_global_position_int_message(v.boot_ms, *place, -down, -down, 0, 0, 0, heading)
        yield mavlink.MAVLink_local_position_ned_message(v.boot_ms, v.north_m, v.east_m, v.depth_m, 0.0, 0.0, 0.0)
    if heading_deg is not None:
        yield mavlink.MAVLink_vfr_hud_message(0.0, 0.0, round(heading_deg) % 360, 0, -v.depth_m, 0.0)


def global_origin(origin: Origin) -> Any:
    return mavlink.MAVLink_gps_global_origin_message(*(round(1e7 * degrees) for degrees in origin), 0)


def version() -> Any:
    """What can be asked of us. No number of ArduSub's: it is none."""
    can = mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    none = (0,) * 8
    return mavlink.MAVLink_autopilot_version_message(can, 0, 0, 0, 0, none, none, none, 0, 0, 0)


def status_texts(level: Level, text: str, number: int) -> Iterator[Any]:
    """A line for people, in as many pieces as it needs; `number` tells the pieces of one line from another's."""
    line = text.encode("utf-8", errors="replace").replace(b"\0", b" ")
    pieces = [line[at : at + TEXT_BYTES] for at in range(0, len(line), TEXT_BYTES)]
    whole = len(pieces) == 1
    if pieces and len(pieces[-1]) == TEXT_BYTES and not whole:
        pieces.append(b"")  # the end of a line is a piece that is not full
    for index, piece in enumerate(pieces):
        yield mavlink.MAVLink_statustext_message(SEVERITY[level], piece, 0 if whole else number % NONE16 + 1, index)


# --- commands of a ground station ---
# What a ground station wants, as an order of ours, or why it is none. Pure.

EVERYBODY = 0  # as the target system: all
CUSTOM = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
MODES: dict[float, str] = {ALT_HOLD: "hold", SURFACING: "surface"}
COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
ORDERS = (*COMMANDS, "SET_MODE")


class Act(NamedTuple):
    """An order."""

    verb: str
    command: int  # what an acknowledgement is about


class No(NamedTuple):
    """What is done for nobody."""

    command: int
    result: int  # MAV_RESULT
    why: str


def asked(message: Any) -> Act | No:
    """Of a COMMAND_LONG, COMMAND_INT or SET_MODE: the order that it is, or why it is none."""
    number, verb = _read(message)
    if verb is None:
        return No(number, mavlink.MAV_RESULT_UNSUPPORTED, "there is no such command here")
    if not verb:
        return No(number, mavlink.MAV_RESULT_DENIED, "arm with 1, disarm with 0; modes are ALT_HOLD and SURFACE")
    if message.target_system == EVERYBODY and verb not in URGENT:
        return No(number, mavlink.MAV_RESULT_DENIED, f"{verb}: say which robot; all at once can disarm or surface")
    return Act(verb, number)


def _read(message: Any) -> tuple[int, str | None]:
    """Number of the command and verb of the order; None: no such command; empty: none with these values."""
    if message.get_type() == "SET_MODE":  # which ArduPilot acknowledges by the number of the message
        return mavlink.MAVLINK_MSG_ID_SET_MODE, _mode(message.base_mode, message.custom_mode)
    number: int = message.command
    if number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
        return number, {0.0: "disarm", 1.0: "arm"}.get(message.param1, "")
    if number == mavlink.MAV_CMD_DO_SET_MODE:
        return number, _mode(message.param1, message.param2)
    return number, None


def _mode(base: float, custom: float) -> str:
    known = 0 <= base < 256 and int(base) & CUSTOM  # floats, which may be no numbers
    return MODES.get(custom, "") if known else ""


# --- parameters ---
# A robot's parameters: a few facts of the fleet file, to be read. Pure.
#
# Ground stations ask for all of a vehicle's parameters before they call it connected. What is set here would have to
# hold over there: so nothing is, and a PARAM_SET is answered by the value that it has, which is how MAVLink says no.

Parameters = dict[str, float]


def parameters(fleet: Fleet, robot: str, system: int) -> Parameters:
    """By their names, 16 characters at most."""
    return {
        "SYSID_THISMAV": float(system),
        "AUC_HOLD_M": fleet.robot[robot].depth_m,  # as deep as its fleet file wants it, m
        "AUC_SURFACE_M": fleet.tank.surface_m,  # the water, m above the floor
    }


def answers(all_of_it: Parameters, message: Any) -> Iterator[Any]:
    """To a PARAM_REQUEST_LIST, PARAM_REQUEST_READ or PARAM_SET; nothing where there is none of that name or number."""
    names = list(all_of_it)
    match message.get_type():
        case "PARAM_REQUEST_LIST":
            wanted = names
        case "PARAM_REQUEST_READ" if message.param_index >= 0:
            wanted = names[message.param_index : message.param_index + 1]
        case _:
            wanted = [name for name in names if name == message.param_id]
    for name in wanted:
        yield mavlink.MAVLink_param_value_message(
            name.encode(), all_of_it[name], mavlink.MAV_PARAM_TYPE_REAL32, len(names), names.index(name)
        )


# --- gateway ---
# Between a fleet and a ground station: what each robot shows becomes its vehicle's messages, and commands orders.
#
# Each robot is a system of its own, by its place in the fleet file, from the first number on that it is given. Nothing
# here opens a socket or looks at a clock.

COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
BEAT_NS = 1_000_000_000
BEATS_AN_ORIGIN = 5
MOST_UNDER_WAY = 8  # orders to one robot that wait for an answer; and as many that are urgent
RETRY_NS = 20_000_000_000  # a ground station asks again within it, where no answer came
STALLED_S = 1.0  # a turn of the loop takes a tenth of that; this process was stopped, or its computer slept
READS = ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET")
TAKEN_NS = 5_000_000_000  # a stranger's heartbeat with a robot's number is minded for so long
UNFIT = "a value does not fit into it"
READ_ONLY = "this bridge only looks; to order, start it with --as NAME"

Told = Callable[[str, Outcome], None]
# Gives an order (robots, verb, by which State of each, whether to all that there are) and returns at once; what became
# of it at each robot is `Told` from any thread.
Give = Callable[[Sequence[str], str, Mapping[str, Basis], bool, Told], None]


class _Asked(NamedTuple):
    """An order that is under way, and who wants to hear of it."""

    robot: str
    act: Act
    system: int
    component: int


class Gateway:
    """`send` takes the bytes of one message; `give`: None where nobody may order.

    While somebody else says that it is a robot's system, that robot takes no orders but those that end something: a
    ground station cannot know which of the two it arms.
    """

    def __init__(
        self,
        fleet: Fleet,
        origin: Origin,
        send: Callable[[bytes], None],
        give: Give | None = None,
        first_system: int = 1,
    ) -> None:
        self.systems = numbered(fleet, first_system)
        self._taken_ns: dict[str, int] = {}  # when a stranger last said to be this robot
        self._fleet, self._origin, self._send, self._give = fleet, origin, send, give
        self._writers = {robot: mavlink.MAVLink(None, number, COMPONENT) for robot, number in self.systems.items()}
        self._parameters = {robot: parameters(fleet, robot, number) for robot, number in self.systems.items()}
        self._newest = Newest()
        self._under_way: list[_Asked] = []
        self._unanswered: dict[_Asked, tuple[Basis, int]] = {}  # by which State it was first asked, and when
        self._over: SimpleQueue[tuple[_Asked, str, Outcome]] = SimpleQueue()
        self._beat_ns: dict[str, int] = {}  # when each robot's heart beat last, and how often it has
        self._beats = dict.fromkeys(fleet.robot, 0)
        self._lines = 0
        self.dropped: Counter[tuple[str, str]] = Counter()  # robot and kind of what could not be packed

    def shown(self, message: State | LogLine, arrived_ns: int, wall_ns: int) -> None:
        """What a robot shows."""
        if message.robot not in self.systems:
            return
        if isinstance(message, LogLine):
            self._say(message.robot, message)
            return
        self._newest.take(message, arrived_ns, wall_ns)
        if self._newest.fresh(message.robot, arrived_ns, wall_ns) is not None:
            told = vehicle(robot_view(message, self._fleet))
            self._tell(message.robot, each_state(told, self._origin))

    def tick(self, now_ns: int, wall_ns: int) -> None:
        """Beat the heart of each robot that is alive, once a second, and tell what became of orders."""
        self._acknowledge()
        for robot in self.systems:
            before_ns = self._beat_ns.get(robot)
            if before_ns is not None and wall_ns - before_ns < BEAT_NS:
                continue
            if (state := self._newest.fresh(robot, now_ns, wall_ns)) is None:
                continue
            self._beat_ns[robot] = wall_ns
            told = vehicle(robot_view(state, self._fleet))
            self._tell(robot, (heartbeat(told), *each_second(told, self._origin)))
            if self._beats[robot] % BEATS_AN_ORIGIN == 0:
                self._tell(robot, (global_origin(self._origin),))
            self._beats[robot] += 1

    def heard(self, message: Any, now_ns: int, wall_ns: int) -> None:
        """One message of a ground station. What is for nobody here, or not understood, is passed over."""
        if message.get_type() == "HEARTBEAT":
            self._stranger(message, wall_ns)
            return
        kind, target = message.get_type(), getattr(message, "target_system", None)
        if getattr(message, "target_component", 0) not in (0, COMPONENT):
            return
        addressed = [robot for robot, system in self.systems.items() if target in (EVERYBODY, system)]
        number = _wants(message) if kind in COMMANDS else None
        sender = message.get_srcSystem(), message.get_srcComponent()
        if kind in ORDERS and number is None:
            self._order(addressed, message, target == EVERYBODY, wall_ns)
            return
        for robot in addressed:
            if number is not None:
                self._request(robot, message, number, now_ns, wall_ns)
            elif kind in READS:
                self._tell(robot, answers(self._parameters[robot], message))
            elif kind == "MISSION_REQUEST_LIST":
                kind_of = getattr(message, "mission_type", 0)
                self._tell(robot, (mavlink.MAVLink_mission_count_message(*sender, 0, kind_of),))
            elif kind in ("MISSION_COUNT", "MISSION_CLEAR_ALL"):
                no, kind_of = mavlink.MAV_MISSION_UNSUPPORTED, getattr(message, "mission_type", 0)
                self._tell(robot, (mavlink.MAVLink_mission_ack_message(*sender, no, kind_of),))

    def _stranger(self, message: Any, wall_ns: int) -> None:
        """A heartbeat, which none of ours is: nobody sends us what we sent."""
        for robot, system in self.systems.items():
            if message.get_srcSystem() == system:
                if not self._is_taken(robot, wall_ns):
                    self._warn(robot, f"another vehicle is system {system} too: no orders; see --first-system")
                self._taken_ns[robot] = wall_ns

    def _is_taken(self, robot: str, wall_ns: int) -> bool:
        since_ns = self._taken_ns.get(robot)
        return since_ns is not None and wall_ns - since_ns < TAKEN_NS

    def _order(self, robots: Sequence[str], message: Any, everybody: bool, wall_ns: int) -> None:
        """Give it to those of these robots that may have it."""
        sender, begun = (message.get_srcSystem(), message.get_srcComponent()), dict[str, _Asked]()
        act = asked(message)
        for robot in robots:
            what = self._allowed(robot, act, wall_ns)
            if isinstance(what, No):
                self._deny(robot, what, *sender)
            elif self._begin(one := _Asked(robot, what, *sender)):
                begun[robot] = one
        if not begun or self._give is None:
            return
        seen = {robot: basis for robot, one in begun.items() if (basis := self._basis(one, wall_ns)) is not None}
        some = next(iter(begun.values()))

        def told(robot: str, outcome: Outcome) -> None:
            self._over.put((begun.get(robot, some), robot, outcome))

        self._give(list(begun), some.act.verb, seen, everybody, told)

    def _allowed(self, robot: str, what: Act | No, wall_ns: int) -> Act | No:
        if isinstance(what, Act) and what.verb not in URGENT and self._is_taken(robot, wall_ns):
            why = f"another vehicle is system {self.systems[robot]} too; start a bridge with another --first-system"
            what = No(what.command, mavlink.MAV_RESULT_DENIED, why)
        if isinstance(what, Act) and self._give is None:
            what = No(what.command, mavlink.MAV_RESULT_DENIED, READ_ONLY)
        return what

    def _begin(self, one: _Asked) -> bool:
        """Whether it is to be given: a stop each time, what else is asked again while it waits has its answer on the
        way. What one robot leaves unanswered takes no other's place."""
        urgent, waits = one.act.verb in URGENT, one in self._under_way
        alike = sum(each.robot == one.robot and (each.act.verb in URGENT) is urgent for each in self._under_way)
        if waits and (not urgent or alike >= MOST_UNDER_WAY):
            return False
        if alike >= MOST_UNDER_WAY:
            self._warn(one.robot, f"{one.act.verb}: left out, {alike} orders wait for its answer")
            return False
        self._under_way.append(one)
        return True

    def _basis(self, one: _Asked, wall_ns: int) -> Basis | None:
        """By which State it was decided: the newest, but of an arming without an answer that is asked again the first
        one's, so that it undoes no stop that came between. A stop goes by none."""
        self._unanswered = {each: of for each, of in self._unanswered.items() if wall_ns - of[1] < RETRY_NS}
        state = self._newest.last(one.robot)
        if state is None or one.act.verb in URGENT:
            return None
        now = (state.incarnation, state.sent_ns), wall_ns
        return (self._unanswered.setdefault(one, now) if one.act.verb == "arm" else now)[0]

    def _acknowledge(self) -> None:
        """By what robots answered. One that did not gets no acknowledgement: nobody knows."""
        while not self._over.empty():  # nobody else takes from it
            one, robot, outcome = self._over.get_nowait()
            if robot != one.robot:  # which the fleet file lacks, or of which there are two
                if outcome.answer is None or not outcome.answer.ok:
                    self._warn(one.robot, f"{one.act.verb}: {robot}: {outcome.why}")
                continue
            self._under_way.remove(one)
            if outcome.answer is None:
                self._warn(one.robot, f"{one.act.verb}: {outcome.why}")
                continue
            self._unanswered.pop(one, None)
            if outcome.answer.ok:
                self._ack(one.robot, one.act.command, mavlink.MAV_RESULT_ACCEPTED, one.system, one.component)
            else:
                no = No(one.act.command, mavlink.MAV_RESULT_DENIED, f"{one.act.verb}: {outcome.answer.why}")
                self._deny(one.robot, no, one.system, one.component)

    def _request(self, robot: str, message: Any, number: int, now_ns: int, wall_ns: int) -> None:
        """A message that is wanted now: any of those that we send."""
        state = self._newest.fresh(robot, now_ns, wall_ns)
        can: list[Any] = [version(), global_origin(self._origin)]
        if state is not None:
            told = vehicle(robot_view(state, self._fleet))
            can += (heartbeat(told), *each_second(told, self._origin))
            can += each_state(told, self._origin)
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
        self._tell(robot, status_texts(line.level, line.text, self._lines))

    def _tell(self, robot: str, messages: Iterable[Any]) -> None:
        writer = self._writers[robot]
        for message in messages:
            try:
                data = message.pack(writer)
            except (struct.error, OverflowError):  # a number of the robot's that the field does not hold
                self.dropped[robot, message.get_type()] += 1
                if self.dropped[robot, message.get_type()] == 1:
                    self._warn(robot, f"{message.get_type()} left out: {UNFIT}")
                continue
            self._send(data)
            writer.seq = (writer.seq + 1) % 256


def _wants(message: Any) -> int | None:
    """The number of the message that is asked for; None: it is no such question."""
    if message.command == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
        return int(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    if message.command != mavlink.MAV_CMD_REQUEST_MESSAGE:
        return None
    return int(message.param1) if 0 <= message.param1 < 2**24 else -1


# --- the socket ---

HOST = "127.0.0.1"
PERIOD_S = 0.02  # between two looks at what robots have said
DATAGRAM = 2**16  # bytes
LISTEN_S = 1.2  # before the first word, where no ground station is there yet: vehicles say each second who they are


def run(
    fleet: Fleet,
    fleet_path: Path,
    console: str | None,
    port: int,
    origin: Origin,
    stop: Event,
    say: Callable[[str], None],
    first_system: int = 1,
) -> None:
    """Until `stop` is set. Raises ConfigError where this name may not look, or not order, and where another vehicle has
    the number of one of these."""
    name = console or LOOKER
    systems = numbered(fleet, first_system)
    keys, clock = credentials(fleet, name, fleet_path), fleet_clock(fleet)
    with ExitStack() as stack:
        stack.enter_context(held(port, systems))
        _listen(port, systems, stop)
        give = None
        if console is not None:
            give = stack.enter_context(_ordering(len(systems), stack.enter_context(OrderConsole(fleet, console, keys))))
        link = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        link.connect((HOST, port))
        link.settimeout(PERIOD_S)

        def send(data: bytes) -> None:
            with suppress(OSError):  # no ground station is there yet
                link.send(data)

        gateway = Gateway(fleet, origin, send, give, first_system)
        observer = stack.enter_context(Observer(fleet, clock.now_ns, (STATE, LOG), name, keys))
        said = ", ".join(f"{robot} is system {number}" for robot, number in systems.items())
        say(f"to udp://{HOST}:{port}, where a ground station of this machine listens: {said}; Ctrl-C ends it")
        turned_s = machine.since_boot_s()
        while not stop.is_set():
            messages, before_s, turned_s = _arrived(link, stop), turned_s, machine.since_boot_s()
            if turned_s - before_s > STALLED_S:  # nobody knows how old an order of that time is
                say(f"nothing was done for {turned_s - before_s:.1f} s; what a ground station said then is dropped")
                messages = _dropped(link)
            for message in messages:
                gateway.heard(message, clock.now_ns(), machine.monotonic_ns())
            for received in observer.drain():
                if isinstance(shown := own_word(received), State | LogLine):
                    gateway.shown(shown, received.arrived_ns, machine.monotonic_ns())
            gateway.tick(clock.now_ns(), machine.monotonic_ns())
        for (robot, kind), count in gateway.dropped.items():
            say(f"{robot}: {kind} left out {count} times: {UNFIT}")


def _listen(port: int, systems: dict[str, int], stop: Event) -> None:
    """Hear who is there, before anything is said. Raises ConfigError for a vehicle with the number of one of these.

    Where a ground station has the port, it alone hears them; if it passes heartbeats on, the gateway minds them.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        try:
            ear.bind((HOST, port))
        except OSError:
            return
        ear.settimeout(PERIOD_S)
        end_s = machine.monotonic_s() + LISTEN_S
        while machine.monotonic_s() < end_s and not stop.is_set():
            for message in _arrived(ear, stop):
                for robot, number in systems.items():
                    if message.get_type() == "HEARTBEAT" and message.get_srcSystem() == number:
                        raise ConfigError(taken(robot, number, "another vehicle", len(systems)))


def _arrived(link: socket.socket, stop: Event) -> list[Any]:
    """What the ground station has said within a period; what is broken in one datagram takes nothing of the next."""
    try:
        data = link.recv(DATAGRAM)
    except TimeoutError:
        return []
    except OSError:  # nobody listens there: the system has told the last datagram's sender
        machine.wait(stop, PERIOD_S)
        return []
    reader = mavlink.MAVLink(None)
    reader.robust_parsing = True
    return reader.parse_buffer(data) or []


def _dropped(link: socket.socket) -> list[Any]:
    """Nothing, and nothing waits any more."""
    with suppress(OSError):
        while True:
            link.recv(DATAGRAM, socket.MSG_DONTWAIT)
    return []


@contextmanager
def _ordering(robots: int, console: OrderConsole) -> Iterator[Give]:
    """Orders, each in a thread, since they wait for their answers, and none behind those to robots that are mute."""
    with ThreadPoolExecutor(2 * MOST_UNDER_WAY * robots) as threads:

        def give(to: Sequence[str], verb: str, seen: Mapping[str, Basis], everybody: bool, told: Told) -> None:
            def work() -> None:
                left = set(to)
                try:
                    for robot, outcome in console.orders(to, verb, everybody=everybody, seen=seen):
                        left.discard(robot)
                        told(robot, outcome)
                except Exception as error:  # noqa: BLE001 - what is under way has to end
                    for robot in left:
                        told(robot, Outcome(None, f"could not be given: {error}"))

            threads.submit(work)

        yield give
