"""From a fleet into another network of Zenoh, and never back: which messages are a robot's own, which are recent
enough, a State as a vehicle, and the numbers of vehicles.

That network is a second session, by their router on this machine. It knows no rules of ours: any process that reaches
it could say anything, so nothing is heard there.
"""

from __future__ import annotations

import errno
import math
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Event
from typing import NamedTuple, Protocol

from msgspec import UNSET

from agent.clock import machine
from agent.core.codec import Refusal
from agent.core.config import ConfigError, Fleet
from agent.core.messages import Message, State
from agent.core.robot_view import RobotView, in_own_name
from agent.core.status import FAILSAFE
from agent.core.topics import Topic
from agent.process.certificates import credentials
from agent.process.transport import LOOKER, Observer, Received, fleet_clock
from hw.firmware.failsafe import SURFACE
from router_config.session import Session
from router_config.settings import client_config

# --- messages in a robot's own name ---
# What a robot says in its own name.


def own_word(received: Received) -> Message | None:
    """The message; None for what cannot be read, and for what says that it is of another than its key does."""
    with suppress(Refusal):
        message: Message = in_own_name(received.topic, received.chunks, received.payload)
        return message
    return None


# --- into another network ---

PERIOD_S = 0.02  # between two looks at what robots have said
WORLD = "world"  # name of the world frame, there: it is like ours (robot_view)


class Foreign(NamedTuple):
    """A message of theirs."""

    key: str
    payload: bytes
    attachment: bytes = b""


class Language(Protocol):
    """Pure: what it is given decides what it says."""

    rows: tuple[Topic, ...]  # of ours, which it has words for

    def tokens(self, session: str) -> Iterable[str]:
        """What is announced, by the id of the session over there. Called before all else."""

    def said(self, message: Message, now_ns: int) -> Iterable[Foreign]:
        """What a robot has said, in that language; `now_ns`: since the Unix epoch."""


def run(
    fleet: Fleet,
    fleet_path: Path,
    name: str | None,
    port: int,
    language: Language,
    stop: Event,
    say: Callable[[str], None],
) -> None:
    """Until `stop` is set. Raises ConfigError where this name may not look, or no router is there."""
    keys, clock = credentials(fleet, name or LOOKER, fleet_path), fleet_clock(fleet)
    router = f"tcp/127.0.0.1:{port}"
    with ExitStack() as stack:
        session = stack.enter_context(Session(client_config(router), f"no router at {router}, or it turns us away"))
        for token in language.tokens(session.id):
            session.announce(token)
        observer = stack.enter_context(Observer(fleet, clock.now_ns, language.rows, name or LOOKER, keys, once=True))
        say(f"to the router at {router}: {', '.join(fleet.robot)}; Ctrl-C ends it")
        while not machine.wait(stop, PERIOD_S):
            for received in observer.drain():
                if (message := own_word(received)) is not None:
                    for theirs in language.said(message, machine.unix_ns()):
                        session.put_foreign(*theirs)


# --- newest states ---
# What each robot said last, and whether that is recent enough to be passed on as what is so now.

STALE_NS = 3_000_000_000  # robots refuse orders by an older State, too
DRIFT = 1e-4  # s in a second: how fast two computers' clocks may go apart


class _Heard(NamedTuple):
    state: State
    arrived_ns: int  # by the fleet's clock as it is here
    wall_ns: int  # by this machine's
    least_ns: int  # least delay so far, which stands for none: clocks of robots and of this computer may differ


class Newest:
    """The newest State of each robot, whichever target it is about."""

    def __init__(self) -> None:
        self._heard: dict[str, _Heard] = {}

    def take(self, state: State, arrived_ns: int, wall_ns: int) -> None:
        """`arrived_ns`: by the clock of the fleet; `wall_ns`: by that of this machine, which goes on where the fleet's
        stands."""
        least_ns = arrived_ns - state.sent_ns
        before = self._heard.get(state.robot)
        if before is not None and before.state.incarnation == state.incarnation:
            drifted_ns = before.least_ns + round(DRIFT * (arrived_ns - before.arrived_ns))
            least_ns = min(least_ns, drifted_ns)
        self._heard[state.robot] = _Heard(state, arrived_ns, wall_ns, least_ns)

    def last(self, robot: str) -> State | None:
        """However old it is."""
        heard = self._heard.get(robot)
        return None if heard is None else heard.state

    def fresh(self, robot: str, now_ns: int, wall_ns: int) -> State | None:
        """What it said last; None where that is older than three seconds by either clock, as in the burst that a link
        delivers after an outage."""
        heard = self._heard.get(robot)
        if heard is None:
            return None
        age_ns = now_ns - heard.state.sent_ns - heard.least_ns
        return heard.state if max(age_ns, wall_ns - heard.wall_ns) <= STALE_NS else None


# --- a robot as a vehicle ---
# A robot's State as a vehicle: north, east, down, and the words of ArduSub. Pure, and without MAVLink's library.
#
# North is y of the world frame, east is x, down is from the surface. Heading counts clockwise from north. Roll is as
# ours; pitch is not: ours is positive with the bow down.

# Custom modes of ArduSub. Source: ArduPilot, ArduSub/mode.h.
ALT_HOLD, GUIDED, SURFACING = 2, 4, 9
# MAV_STATE. Source: MAVLink, common.xml.
STANDBY, ACTIVE, CRITICAL, EMERGENCY, POWEROFF = 3, 4, 5, 6, 7


class Vehicle(NamedTuple):
    """What a ground station is told of a robot. None: nobody knows, and nothing is sent that would have to say."""

    boot_ms: int  # since the agent's start
    armed: bool  # also where nobody knows, for a person about to reach into the water
    mode: int
    status: int
    north_m: float | None
    east_m: float | None
    place_sigma_m: float | None  # of what swims; None of what is moored: it was surveyed
    depth_m: float | None
    roll_rad: float | None
    pitch_rad: float | None
    yaw_rad: float | None  # clockwise from north, -pi to pi
    battery_v: float | None
    pressure_works: bool
    camera_works: bool


def vehicle(view: RobotView) -> Vehicle:
    state, where = view.said, view.body
    surfaces = f"{FAILSAFE} {SURFACE}" in state.faults or any(
        each.endswith(": surface") for each in state.ordered or ()
    )
    return Vehicle(
        boot_ms=max(0, state.sent_ns - state.incarnation) // 1_000_000 % 2**32,
        armed=state.armed is not False,
        mode=SURFACING if surfaces else _mode(state),
        status=_status(state, surfaces),
        north_m=where.y_m if where else None,
        east_m=where.x_m if where else None,
        place_sigma_m=state.whereabouts.place_sigma_m if state.whereabouts else None,
        depth_m=state.depth_m,
        roll_rad=None if state.roll_deg is None else math.radians(state.roll_deg),
        pitch_rad=None if state.pitch_deg is None else -math.radians(state.pitch_deg),
        yaw_rad=math.remainder(math.radians(90.0 - where.yaw_deg), math.tau) if where else None,
        battery_v=None if state.battery_v is UNSET else state.battery_v,
        pressure_works=state.armed is not None and state.depth_m is not None,
        camera_works=not view.blind,
    )


def _mode(state: State) -> int:
    """Guided: a robot that swims and does more than to hold its place."""
    return GUIDED if state.behaviour and state.behaviour != "hold" else ALT_HOLD


def _status(state: State, surfaces: bool) -> int:
    if state.mode in ("failed", "stopped"):
        return EMERGENCY if state.mode == "failed" else POWEROFF
    if surfaces or state.mode == "degraded" or state.armed is None:
        return CRITICAL
    return ACTIVE if state.armed else STANDBY


# --- numbers of vehicles ---

MOST_SYSTEMS = 250  # ground stations are 255, and other programs about them 254 and so on


def numbered(fleet: Fleet, first_system: int) -> dict[str, int]:
    """The system of each robot. Raises ConfigError where there are not so many."""
    last = first_system + len(fleet.robot) - 1
    if last > MOST_SYSTEMS:
        text = f"fleet '{fleet.fleet}': MAVLink knows vehicles up to {MOST_SYSTEMS}, and the last robot would be {last}"
        raise ConfigError(f"{text}; give a smaller --first-system")
    return {robot: number for number, robot in enumerate(fleet.robot, start=first_system)}


@contextmanager
def held(port: int, systems: dict[str, int]) -> Iterator[None]:
    """Hold the numbers of these vehicles at this port against other bridges of this machine, for as long as they live.

    By names of Linux's abstract sockets, which the kernel takes back from who dies. Raises ConfigError.
    """
    with ExitStack() as stack:
        for robot, number in systems.items():
            name = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            try:
                name.bind(f"\0aucamp mavlink {port} {number}")
            except OSError as error:
                if error.errno == errno.EADDRINUSE:
                    raise ConfigError(taken(robot, number, "another bridge of this machine", len(systems))) from None
        yield


def taken(robot: str, number: int, whose: str, many: int) -> str:
    """What is said where somebody has a robot's number already; many: robots of the fleet."""
    other = number + many if number + 2 * many - 1 <= MOST_SYSTEMS else 1
    return (
        f"{robot} would be system {number}, which {whose} has, and a ground station would take the two for one; "
        f"give another --first-system, such as {other}"
    )
