"""The control module of a robot, whatever is behind it: the protocol that every backend keeps, the table from an
address to a backend, and the switch for its motors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Protocol, Self

from agent.clock.clock import Clock
from agent.core.config import ConfigError
from agent.core.step_io import Motors as Ordered
from agent.core.step_io import SetPoint, Telemetry
from hw.firmware import wire
from hw.firmware.failsafe import LATCHED, SURFACE

Tap = Callable[[bool, bytes], None]  # (whether from the module, bytes), called in the backend's thread
Line = tuple[Literal["info", "warning", "error"], str]  # for people


class Module(Protocol):
    """What every backend offers. Every method returns at once, but for the end of the `with` block.

    A set-point is the heartbeat, 20 times a second or more: without it the module holds depth and level, and after 3 s
    it surfaces and switches its motors off by itself. Arming is a wish that the backend repeats while waiting can cure
    a refusal; it falls by itself where the module disarms. At the end of its `with` block motors are off; with an
    exception it lets the robot surface.
    """

    @property
    def wants_armed(self) -> bool: ...

    def drain(self) -> tuple[Sequence[Telemetry], Sequence[Line]]:
        """What came since the last call, oldest first. Telemetry's flags are those of hw.firmware.wire, its ladder the
        levels of hw.firmware.failsafe. Raises RuntimeError where the backend has died."""

    def send(self, set_point: SetPoint, now_ns: int) -> None:
        """Hand over a set-point; without a connection it is forgotten."""

    def arm(self) -> None: ...

    def surface(self) -> None:
        """Go up, until an order to arm calls the robot back."""

    def disarm(self) -> None:
        """Motors off, and no wish to arm any more."""

    def emergency_stop(self) -> None:
        """Motors off, whatever becomes of this host, until a person arms."""

    def tare(self) -> Future[Any]:
        """Take the pressures of now for those at the surface; refused with motors on."""

    def __enter__(self) -> Self: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


# --- address -> backend ---

SCHEMES = {"twin": "ROBOT", "stm32": "/dev/ttyACM0"}  # scheme -> what follows it; a bare path is an stm32's


def open_module(url: str, twin_dir: Path, clock: Clock, tap: Tap | None = None, part: str = "") -> Module:
    """The backend that `url` names, for a `with` block: SCHEME:PLACE, see SCHEMES, or the path of a serial port.

    clock: stamps telemetry, and waits for the backend's thread as `part`; tap: sees the bytes of both directions.
    Raises ConfigError for an address that no backend serves. A port that is missing is looked for until it is there.
    """
    # Imported when asked for: a vehicle needs no libraries of one that it is not.
    from hw.stm32.driver import Stm32

    return Stm32(serial_port(url, twin_dir), clock, tap=tap, part=part)


def serial_port(url: str, twin_dir: Path) -> str:
    """The path of the serial port that an address stands for; a twin's is a pty. Raises ConfigError."""
    scheme, place = known_scheme(url)
    return str(twin_dir / f"{place}.serial") if scheme == "twin" else place


def known_scheme(url: str) -> tuple[str, str]:
    """SCHEME and PLACE of an address. Raises ConfigError for one that no backend serves."""
    scheme, colon, place = url.partition(":")
    if not colon or "/" in scheme:  # a path, which may have colons behind
        return "stm32", url
    if scheme not in SCHEMES or not place:
        known = ", ".join(f"{name}:{what}" for name, what in SCHEMES.items())
        raise ConfigError(f"serial = '{url}': no such kind of control module; write a serial port's path, or {known}")
    return scheme, place


# --- motors ---

AGAIN_NS = 500_000_000  # after this long a module that still does not do what was ordered is told again
ARM_WITHIN_NS = 15_000_000_000  # of the order; later nobody who ordered expects motors to start
GIVEN_UP = "to start them, put right what stopped them, and order: arm; or start this agent again with --arm"
FOUND_ON = "this agent was started without --arm and found them on: the robot surfaces; to call it back, order: arm"

Wish = Ordered | Literal["never armed", "given up", "found on"]


class Motors:
    """Whether the motors of one robot turn, by the agent's start and by orders; the module is told so, and told again
    until it says that it does so.

    A stop is latched in the module: whatever becomes of this agent, only a person's order to arm undoes it.
    A robot that surfaced because its host was silent is called back when the host is there again, but never a robot
    that was ordered up or stopped. An order to arm that comes to nothing in time is over: who then pushes home a plug
    has a hand there. One that is armed though nobody asked this agent for motors is sent up.
    """

    def __init__(self, module: Module, arm: bool) -> None:
        """arm: whether the agent was started with --arm, which waits for as long as it takes."""
        self._module = module
        self._wish: Wish = "arm" if arm else "never armed"
        self._told_ns = self._heard_ns = 0
        self._until_ns: int | None = None  # of an order to arm that the module has not obeyed yet

    def obey(self, ordered: Ordered, now_ns: int) -> None:
        """Do that from now on. A tare is done once, and refused by the module where its motors are on."""
        if ordered == "tare":
            self._module.tare()
            return
        self._until_ns = now_ns + ARM_WITHIN_NS if ordered == "arm" else None
        self._wish_for(ordered, now_ns)

    def feel(self, told: Sequence[Telemetry], now_ns: int) -> None:
        """Compare with what the module says, and tell it again."""
        newest = told[-1] if told else None
        if newest is not None:
            self._heard_ns = now_ns
            if newest.armed:
                self._until_ns = None
                if self._wish == "never armed":
                    self._wish_for("found on", now_ns)
        if self._until_ns is not None and now_ns > self._until_ns:
            self._until_ns = None
            self._wish_for("given up", now_ns)
        if now_ns - self._told_ns >= AGAIN_NS and self._undone(newest, now_ns):
            self._tell(now_ns)

    def fault(self) -> str | None:
        """What to do where they are wanted and the module has given up, or where they were on and nobody wants them."""
        if self._wish == "found on":
            return FOUND_ON
        given_up = self._wish == "given up" or (self._wish == "arm" and not self._module.wants_armed)
        return GIVEN_UP if given_up else None

    def _undone(self, newest: Telemetry | None, now_ns: int) -> bool:
        """Whether the module does not do what is wanted; one that says nothing may not have heard of it."""
        if newest is None:
            return self._wish in ("off", "surface", "found on") and now_ns - self._heard_ns >= AGAIN_NS
        match self._wish:
            case "off":
                return bool(newest.ladder != LATCHED)
            case "surface" | "found on":
                return newest.armed and newest.ladder < SURFACE
            case "arm":
                return surfacing_for_silence(newest)
            case _:
                return False

    def _wish_for(self, wish: Wish, now_ns: int) -> None:
        self._wish = wish
        self._tell(now_ns)

    def _tell(self, now_ns: int) -> None:
        self._told_ns = now_ns
        match self._wish:
            case "off":
                self._module.emergency_stop()
            case "surface" | "found on":
                self._module.surface()
            case "arm":
                self._module.arm()
            case "given up":
                self._module.disarm()


def surfacing_for_silence(telemetry: Telemetry) -> bool:
    """Whether the module, still armed, rises only because the host was silent for 3 s. The host is back now, and the
    order to arm still holds; a leak, a low battery or whatever else the board found is for a person to judge."""
    own = wire.FLAG_LEAK | wire.FLAG_BATTERY | wire.FLAG_DEGRADED | wire.FLAG_FOUND
    return telemetry.armed and telemetry.ladder == SURFACE and not telemetry.flags & own
