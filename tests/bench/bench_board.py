"""What the firmware costs on an STM32F407: estimated from counted instructions, not timed (tests/bench/board)."""

from __future__ import annotations

import json
import sys
from statistics import mean
from typing import Any

from tests.bench.board import estimate
from tests.bench.board.boots import Options
from tests.bench.board.commands import FIRMWARE
from tests.bench.board.timetable import TICK_MS
from tests.bench.board.tools import MissingTool

MEAN_MS, WORST_MS = 6.0, 9.0  # as much as a cycle may take
BYTES = 256  # that a cycle may take in the mean
FREE_KB = 60.0  # that are to be left after boot


def run() -> dict[str, dict[str, Any]]:
    """Nothing where a tool is missing: rows of firmware_step are the proxy then."""
    options = Options(FIRMWARE)
    try:
        result = estimate.figures(estimate.measure(options), options)
    except MissingTool as missing:
        sys.stderr.write(f"no estimate for the chip: {missing}\n")
        return {}
    armed = result["windows"].get("armed")
    if armed is None:
        raise RuntimeError("the firmware never armed: this measures the wrong thing")
    table, of = armed["timetable"], f"of {TICK_MS:g} ms"
    taken, free_kb = mean(result["bytes_a_cycle"]), result["free_after_boot"] / 1000
    return {
        "board_cycle_mean": _row(table["mean_ms"], "ms", f"estimate; at most {MEAN_MS:g} {of}", MEAN_MS),
        "board_cycle_worst": _row(table["worst_ms"], "ms", f"estimate; at most {WORST_MS:g} {of}", WORST_MS),
        "board_ticks_lost": _row(100 * table["lost"], "%", "estimate; none", None),
        "board_cycle_bytes": _row(taken, "bytes", f"estimate; at most {BYTES}", BYTES),
        "board_heap_free": _row(free_kb, "kB", f"estimate; at least {FREE_KB:g}", FREE_KB),
    }


def _row(value: float, unit: str, against: str, bar: float | None) -> dict[str, Any]:
    return {"value": value, "unit": unit, "against": against, "ratio": None if bar is None else value / bar}


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
