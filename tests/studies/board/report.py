"""The estimate as text for a terminal."""

from __future__ import annotations

import sys
from statistics import mean
from typing import Any

LIMIT_MS, TOLERANCE = 10.0, 0.07
SCARCE = 42000  # bytes free after boot: with 43400 a board got through its imports, with 38900 it did not


def report(result: dict[str, Any], least_ms: float) -> None:
    """Print it; least_ms: functions that take less in a cycle have no row."""
    for line in (*_parts(result, least_ms), *_kinds(result), "", *_memory(result), "", *_timetables(result)):
        sys.stdout.write(line + "\n")


def _parts(result: dict[str, Any], least_ms: float) -> list[str]:
    head = "part, without gc" if result["armed"] else "part, without gc (NOT armed)"
    lines = [f"{head:52}{'calls/cycle':>12}{'ms a call':>11}{'ms a cycle':>11}{'own':>8}{'bytes a call':>13}"]
    for row in result["parts"]:
        if row["ms_a_cycle"] < least_ms and row["ms_a_call"] < 10 * least_ms:
            continue
        taken = "" if row["bytes_a_call"] is None else f"{row['bytes_a_call']:.0f}"
        lines.append(
            f"{'  ' * row['depth'] + row['part']:52}{row['calls_a_cycle']:12.2f}{row['ms_a_call']:11.3f}"
            f"{row['ms_a_cycle']:11.3f}{row['own_ms_a_cycle']:8.3f}{taken:>13}"
        )
    rest = "sleep, loop, reading of ADC and pins, and what has no function of its own"
    return [*lines, f"{rest:86}{result['rest_ms_a_cycle']:.3f}", ""]


def _kinds(result: dict[str, Any]) -> list[str]:
    return [
        f"cycle, {name + ', ' + kind:44} work {row['work_ms']:6.2f} ms, worst {row['worst_ms']:6.2f}"
        for name, window in result["windows"].items()
        for kind, row in window["kinds"].items()
    ]


def _memory(result: dict[str, Any]) -> list[str]:
    taken = result["bytes_a_cycle"]
    free = f"free heap after boot {result['free_after_boot'] / 1000:.1f} kB"
    lines = [f"{free}; a cycle takes {min(taken)} to {max(taken)} bytes, {mean(taken):.0f} in the mean"]
    if result["free_after_boot"] < SCARCE:
        lines.append("with so little of it, in pieces, the board may end in a MemoryError while it imports")
    for name, window in result["windows"].items():
        if window["gc_ms"]:
            low, middle, high = window["gc_ms"]
            lines.append(f"gc.collect, {name}: {middle:.2f} ms ({low:.2f} to {high:.2f})")
    if result["heap_was_full"]:
        n = result["heap_was_full"]
        lines.append(f"the heap was full {n} times: the interpreter collected by itself, in mid-cycle")
    if result["collector_overflows"]:
        lines.append(
            "gc.collect takes twice as long as it has to, because the collector's stack of 64 overflows and it walks "
            "the heap again: some object has more than 60 others of its own (globals of a module, a long list)"
        )
    return lines


def _timetables(result: dict[str, Any]) -> list[str]:
    i2c = result["windows"]["disarmed"]["i2c_ms"]
    lines = [
        f"timetable (estimate, good to {100 * TOLERANCE:.0f} %), with {i2c:.2f} ms of I2C and ADC a cycle, UART as "
        "sent, set-points at 20 Hz:"
    ]
    for name, window in result["windows"].items():
        t = window["timetable"]
        lines.append(
            f"  {name:9} mean {t['mean_ms']:5.1f} ms  worst {t['worst_ms']:5.1f} ms  {t['cycles_s']:5.1f} cycles/s"
            f"  {100 * t['lost']:4.1f} % of ticks lost; a set-point takes {t['set_point_ms']:.2f} ms"
        )
        lines.append("            " + verdict(t["mean_ms"], t["worst_ms"]))
    if not result["armed"]:
        lines.append("  not armed. The board says: " + ("; ".join(result["board_says"]) or "nothing"))
    return lines


def verdict(mean_ms: float, worst_ms: float) -> str:
    """Whether cycles fit into their tick."""
    if worst_ms * (1 + TOLERANCE) <= LIMIT_MS:
        return f"keeps {LIMIT_MS:.0f} ms in every cycle"
    if worst_ms * (1 - TOLERANCE) <= LIMIT_MS:
        good = f"{100 * TOLERANCE:.0f} %"
        return f"cannot be told whether every cycle keeps {LIMIT_MS:.0f} ms: the estimate is good to {good}"
    if mean_ms <= LIMIT_MS * (1 - TOLERANCE):
        return f"keeps {LIMIT_MS:.0f} ms in the mean, not in the worst cycle"
    return f"does not keep {LIMIT_MS:.0f} ms"
