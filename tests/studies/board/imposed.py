"""The table of times that the twin's firmware is held to: the measured cycles, taken apart."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from agent.core.config import ConfigError, dump
from hw.twin.board import TABLE, CycleTimes, Table, read_table
from tests.studies.board import prices, sources
from tests.studies.board.boots import ARMED, DISARMED
from tests.studies.board.estimate import Measured, collections_in
from tests.studies.board.tools import BoardError
from tests.studies.board.tree import pretended

WRITE = "b_machine.UART.write"
FITTED = ("armed_us", "disarmed_us", "sent_frame_us", "sent_byte_us", "heard_byte_us")


class Parts(NamedTuple):
    """What there was of each thing in a cycle, and what the cycle took in us without gc and UART."""

    armed: float
    disarmed: float
    frames: float
    sent_bytes: float
    heard_bytes: float
    took_us: float


def times(measured: Measured) -> tuple[CycleTimes, float]:
    """Least squares over all cycles; the largest difference between a cycle and what the table makes of it, in us."""
    if not measured.armed:
        raise BoardError("the firmware did not arm: nothing is written")
    run = measured.run
    rows = []
    gc_ms, collections, uart_ns, sent = 0.0, 0.0, 0.0, 0.0
    for number, window in zip(run.numbers, run.log.windows, strict=True):
        if number not in ARMED and number not in DISARMED:
            continue
        cycle = measured.cycles[number]
        calls = pretended(run, window)
        look_ns = prices.LOOK_NS * sum(count.called.get("gc_info", 0.0) for count in window.values())
        tx_ns = run.buses[number][2]
        rows.append(
            Parts(
                number in ARMED,
                number in DISARMED,
                sum(made.get(WRITE, 0.0) for made in calls.values()),
                round(tx_ns / prices.UART_BYTE_NS),
                run.set_point if cycle.heard else 0,
                1000.0 * (cycle.work + cycle.i2c + cycle.idle) - look_ns / 1000.0,
            )
        )
        gc_ms += cycle.gc
        collections += collections_in(run, window)
        uart_ns, sent = uart_ns + tx_ns, sent + rows[-1].sent_bytes
    table = np.array(rows)
    fitted, worst_us = _least_squares(table[:, :-1], table[:, -1])
    found = dict(zip(FITTED, fitted.tolist(), strict=True))
    found["sent_byte_us"] += uart_ns / sent / 1000.0
    found["collect_us"] = 1000.0 * gc_ms / collections if collections else 0.0
    found["heap_free_us"] = prices.LOOK_NS / 1000.0
    return CycleTimes(**{name: round(us, 2) for name, us in found.items()}), worst_us


def _least_squares(parts: np.ndarray, took_us: np.ndarray) -> tuple[np.ndarray, float]:
    """No part takes less than nothing: one that comes out so is left out. Also the largest residual."""
    kept = list(range(parts.shape[1]))
    while True:
        found = np.linalg.lstsq(parts[:, kept], took_us, rcond=None)[0]
        if found.min() >= 0:
            break
        del kept[int(found.argmin())]
    whole = np.zeros(parts.shape[1])
    whole[kept] = found
    return whole, float(np.abs(parts @ whole - took_us).max())


def write(measured: Measured, path: Path = TABLE) -> str:
    """Write the table; a line that says how well it fits."""
    found, worst_us = times(measured)
    path.write_text(
        "# What a control cycle takes on the STM32F407, estimated: python -m tests.studies.board --write\n"
        + dump(Table(firmware=sources.digest(measured.firmware), times=found)),
        encoding="utf-8",
    )
    shown = ", ".join(f"{name} {us}" for name, us in msgspec.structs.asdict(found).items())
    return f"written to {path.name}: {shown}; no cycle differs by more than {worst_us:.0f} us"


def hint(firmware: Path) -> str:
    """What to do where the table was made of another firmware; empty if nothing."""
    try:
        same = read_table().firmware == sources.digest(firmware)
    except ConfigError as error:
        return str(error)
    return "" if same else f"{TABLE.name} was made of another firmware: python -m tests.studies.board --write"
