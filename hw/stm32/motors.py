"""Whether motors shall turn, by whoever started the agent and by orders; the module is told so, and told again.

A robot that surfaced since its host was silent is called back when the host is there again, but never one that somebody
has ordered up or stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Protocol

from agent.core.step_io import Motors as Ordered
from agent.core.step_io import Telemetry
from hw.firmware import wire
from hw.firmware.failsafe import SURFACE

AGAIN_NS = 500_000_000  # after this long a module that still does not do what was ordered is told again
GIVEN_UP = "to start them, put right what stopped them, and order: arm; or start this agent again with --arm"


class Module(Protocol):
    """The control module, as far as its motors go; nothing waits."""

    @property
    def wants_armed(self) -> bool: ...
    def arm(self) -> None: ...
    def disarm(self) -> None: ...
    def surface(self) -> None: ...


class Motors:
    """Of one robot."""

    def __init__(self, module: Module, arm: bool) -> None:
        """arm: as whoever started the agent wants it."""
        self._module = module
        self._wish: Ordered | Literal["never armed"] = "arm" if arm else "never armed"
        self._told_ns = 0

    def obey(self, ordered: Ordered, now_ns: int) -> None:
        """Do that from now on."""
        self._wish = ordered
        self._tell(now_ns)

    def feel(self, told: Sequence[Telemetry], now_ns: int) -> None:
        """Compare with what the module says, and tell it again."""
        if not told or now_ns - self._told_ns < AGAIN_NS:
            return
        newest = told[-1]
        turns_on = self._wish == "off" and newest.armed
        stays_down = self._wish == "surface" and newest.armed and newest.ladder < SURFACE
        if turns_on or stays_down or (self._wish == "arm" and surfacing_for_silence(newest)):
            self._tell(now_ns)

    def fault(self) -> str | None:
        """What to do where they are wanted, and the module has given up."""
        return GIVEN_UP if self._wish == "arm" and not self._module.wants_armed else None

    def _tell(self, now_ns: int) -> None:
        self._told_ns = now_ns
        match self._wish:
            case "off":
                self._module.disarm()
            case "surface":
                self._module.surface()
            case "arm":
                self._module.arm()


def surfacing_for_silence(telemetry: Telemetry) -> bool:
    """Whether the module, still armed, rises only because the host was silent for 3 s. The host is back now, and who
    armed it wants the dive to go on; a leak, a low battery or a bad sensor is for a person to judge."""
    own = wire.FLAG_LEAK | wire.FLAG_BATTERY | wire.FLAG_DEGRADED
    return telemetry.armed and telemetry.ladder == SURFACE and not telemetry.flags & own
