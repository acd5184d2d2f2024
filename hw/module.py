"""The control module of a robot, whatever is behind it: the protocol that every backend keeps, what its flags say, the
switch for its motors, and when it is asked to arm. The table from an address to a backend is in `hw.stm32`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from types import TracebackType
from typing import Any, Literal, NamedTuple, Protocol, Self

from agent.core.step_io import Motors as Ordered
from agent.core.step_io import SetPoint, Telemetry
from hw.firmware import wire
from hw.firmware.failsafe import LATCHED, SURFACE

Tap = Callable[[bool, bytes], None]  # (whether from the module, bytes), called in the backend's thread
Level = Literal["info", "warning", "error"]


class StatusText(NamedTuple):
    """A line for people, from the module or about it."""

    level: Level
    text: str


class Module(Protocol):
    """What every backend offers. Every method returns at once, but for the end of the `with` block.

    A set-point is the heartbeat, 20 times a second or more: without it the module holds depth and level, and after 3 s
    it surfaces and switches its motors off by itself. Arming is a wish that the backend repeats while waiting can cure
    a refusal; it falls by itself where the module disarms. At the end of its `with` block motors are off; with an
    exception it lets the robot surface.
    """

    @property
    def wants_armed(self) -> bool: ...

    @property
    def faults(self) -> Mapping[str, str]:
        """What is wrong with it and with the way to it, and why it surfaces or has stopped: kind -> words."""

    def drain(self) -> tuple[Sequence[Telemetry], Sequence[StatusText]]:
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


# What its flags say is wrong: kind of fault, and words
FLAGGED = {
    wire.FLAG_LEAK: ("leak", "water at the probe; take the robot out, and open it"),
    wire.FLAG_KILLED: ("kill switch", "open, or it was since the motors were last armed"),
    wire.FLAG_BATTERY: ("battery low", "the robot surfaces, and does not arm; charge it"),
}

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


# --- arming ---

# Refusals that go away while the robot just waits; each other one needs a person to do something.
CURABLE = frozenset(
    {
        "no handshake",
        "sensors not all good",
        "sensors disagree",
        "set-point old",
        "ESC neutral for less than 3 s",
        "control cycle too slow",
    }
)

STAYS_LATCHED = "fault latched"
REBOOT = "look at the robot, then `aucamp board reboot`"


class Arming:
    """Whether the board is to be armed, whether it is, and when to ask it.

    It is asked again while waiting can cure a refusal, and given up for good when it cannot. A line that a method
    returns has to be said.
    """

    def __init__(self) -> None:
        self.wanted = False
        self.armed = False  # what the board said last
        self._ordered = False  # `want` was called and the board has not agreed yet
        self._due_ns = 0
        self._refusal = ""

    def want(self) -> None:
        """Ask as soon as the board can. One that is armed and surfaces is called back to work by the same order."""
        self.wanted = self._ordered = True
        self.begin()

    def begin(self) -> None:
        """Ask at once: after a new order, or on a new port."""
        self._due_ns = 0
        self._refusal = ""

    def due(self, now_ns: int) -> bool:
        """Whether it is time to send the order."""
        return self.wanted and (self._ordered or not self.armed) and now_ns >= self._due_ns

    def later(self, now_ns: int) -> None:
        """The order got no answer."""
        self._due_ns = now_ns + AGAIN_NS

    def answered(self, ok: bool, now_ns: int) -> None:
        self.armed = ok
        self._ordered = self._ordered and not ok
        self.later(now_ns)

    def seen(self, armed: bool) -> StatusText | None:
        """What telemetry shows. A board that disarms by itself is not armed again."""
        line = self.give_up("the board has disarmed") if self.armed and not armed else None
        self.armed = armed
        return line

    def refused(self, mask: int) -> StatusText | None:
        """Why, as the bits of wire.ARM_CHECKS; the same reason is told once."""
        why = [check for i, check in enumerate(wire.ARM_CHECKS) if mask >> i & 1]
        text, before = ", ".join(why), self._refusal
        self._refusal = text
        if not CURABLE.issuperset(why):
            remedy = REBOOT if STAYS_LATCHED in why else "put it right"
            return self.give_up(f"arming refused: {text}; {remedy}, then arm again")
        return StatusText("info", f"arming waits: {text}") if text != before else None

    def give_up(self, text: str) -> StatusText | None:
        """The board is not armed, and is not asked to arm until it is ordered again."""
        line = StatusText("error", text) if self.wanted else None
        self.wanted = self.armed = False
        return line
