"""The control module at the end of a serial port: the driver has the port's thread, the protocol the conversation; here
is the table from an address to it."""

from __future__ import annotations

from pathlib import Path

from agent.clock.clock import Clock
from agent.core.config import ConfigError
from hw.module import Module, Tap

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
