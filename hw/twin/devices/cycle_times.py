"""What a control cycle takes on the board, part by part: the twin's firmware is given no tick before it is over.

cycle_times.toml beside this file is estimated from counted instructions, by `python -m tests.bench board --write`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta, structs

from agent.core.config import Struct, convert, read_toml

TABLE = Path(__file__).with_suffix(".toml")

Microseconds = Annotated[float, Meta(ge=0)]


class CycleTimes(Struct, frozen=True, kw_only=True):
    """Of the law that ships. The fields stand in the order in which hal_unix counts."""

    armed_us: Microseconds  # a cycle that sends and hears nothing, with its I2C and ADC
    disarmed_us: Microseconds
    sent_frame_us: Microseconds  # on top of its bytes
    sent_byte_us: Microseconds  # with the UART, which the firmware waits for
    heard_byte_us: Microseconds
    collect_us: Microseconds  # a garbage collection
    heap_free_us: Microseconds  # looking how much memory is free

    def record(self) -> str:
        """For the environment of the firmware: whole nanoseconds."""
        return " ".join(str(round(1000.0 * us)) for us in structs.astuple(self))


class Table(Struct, frozen=True, kw_only=True):
    """The file."""

    firmware: str  # digest of the sources that it was made of
    times: CycleTimes


def read_table(path: Path = TABLE) -> Table:
    """Raises ConfigError."""
    return convert(read_toml(path), Table, path)


NO_TIME = CycleTimes(
    armed_us=0, disarmed_us=0, sent_frame_us=0, sent_byte_us=0, heard_byte_us=0, collect_us=0, heap_free_us=0
)
