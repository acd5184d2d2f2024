"""What the firmware costs on an STM32F407: all figures, in the form of --json."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from statistics import mean
from typing import Any, NamedTuple

from tests.studies.board import boots, prices, timetable, tools
from tests.studies.board.boots import ARMED, DISARMED, GC_PART, HEARD_EVERY, Options, Run
from tests.studies.board.counts import Count
from tests.studies.board.host import Host
from tests.studies.board.timetable import Cycle
from tests.studies.board.tree import is_ours, pretended, rows, tree

ARMED_PARTS = range(346, 406)  # cycles that the table of functions is made of
MARKED = 1000  # calls of gc_mark_subtree in a collection that does not have to walk the heap again


class Measured(NamedTuple):
    """The cycles of a run, by number."""

    run: Run
    cycles: dict[int, Cycle]
    sizes: dict[int, int]  # bytes that each takes
    full: float  # how often the heap was full
    overflows: bool  # the collector's stack
    used: float  # bytes of the board's heap after boot
    armed: bool  # after the order, and at the end
    complaints: list[str]
    firmware: Path


def measure(options: Options) -> Measured:
    """Run the firmware. Raises MissingTool, BoardError."""
    run, host = boots.run(tools.find_tools(), options)
    if len(run.numbers) < ARMED.stop - DISARMED.start:
        raise tools.BoardError("cycles are missing: the firmware has to sleep in pyb.wfi or machine.idle")
    heaps = [int(line.split()[2]) for line in run.lines if line.startswith("HEAP ")]
    used = prices.used_on_board(heaps[1] - heaps[0], run.compiled, run.bytecode)
    marked = [
        count.called.get("gc_mark_subtree", 0) / count.calls
        for window in run.log.windows
        for node, count in window.items()
        if run.log.nodes.get(node, (0, -1))[1] == GC_PART and count.calls
    ]
    overflows = bool(marked) and mean(marked) > MARKED
    cycles, sizes, full = _cycles(run, used, overflows)
    armed, complaints = _is_armed(run, host), _complaints(run, host)
    return Measured(run, cycles, sizes, full, overflows, used, armed, complaints, options.firmware)


def figures(measured: Measured, options: Options) -> dict[str, Any]:
    """All that is known of it."""
    run = measured.run
    armed_or_not = (("armed", ARMED), ("disarmed", DISARMED)) if measured.armed else (("disarmed", DISARMED),)
    result: dict[str, Any] = {
        "estimated": "from instructions counted under MicroPython's Unix port",
        "gc_every": options.gc_every,
        "optimised": options.optimise,
        "free_after_boot": round(prices.FREE_AT_START - measured.used - prices.MISSED),
        "armed": measured.armed,
        "board_says": measured.complaints,
        "bytes_a_cycle": [measured.sizes[n] for n in ARMED if n in measured.sizes],
        "heap_was_full": round(measured.full),
        "collector_overflows": measured.overflows,
        "windows": {name: _window(measured.cycles, window) for name, window in armed_or_not},
    }
    root, rest, seen = tree(run, ARMED_PARTS)
    result["parts"] = rows(root, run, seen)
    result["rest_ms_a_cycle"] = rest / seen
    own: dict[str, float] = defaultdict(float)
    for row in result["parts"]:
        own[row["part"]] += row["own_ms_a_cycle"]
    result["own_ms_a_cycle"] = _sorted(own, 4)
    done: dict[str, float] = defaultdict(float)
    for number, window in zip(run.numbers, run.log.windows, strict=True):
        if number in ARMED_PARTS:
            for node, count in window.items():
                if is_ours(run, node):
                    for name, ns in prices.by_group(count).items():
                        done[name] += ns / 1e6 / seen
    result["interpreter_ms_a_cycle"] = _sorted(done, 3)
    return result


def _window(cycles: Mapping[int, Cycle], window: range) -> dict[str, Any]:
    seen = [cycles[n] for n in window if n in cycles]
    collections = [cycle.gc for cycle in seen if cycle.gc]
    return {
        "timetable": asdict(timetable.timetable(seen)),
        "gc_ms": [min(collections), mean(collections), max(collections)] if collections else None,
        "i2c_ms": mean(cycle.i2c for cycle in seen),
        "kinds": {
            kind: {
                "share": len(group) / len(seen),
                "work_ms": mean(c.work for c in group),
                "worst_ms": max(c.work for c in group),
            }
            for kind, group in timetable.kinds(seen).items()
        },
    }


def _sorted(ms: Mapping[str, float], digits: int) -> dict[str, float]:
    return {name: round(value, digits) for name, value in sorted(ms.items(), key=lambda item: -item[1])}


def _cycles(run: Run, used: float, overflows: bool) -> tuple[dict[int, Cycle], dict[int, int], float]:
    """Number -> cycle; number -> bytes; how often the heap was full."""
    out: dict[int, Cycle] = {}
    sizes: dict[int, int] = {}
    garbage, full = 0, 0.0
    for number, window in zip(run.numbers, run.log.windows, strict=True):
        calls = pretended(run, window)
        ours = {node: count for node, count in window.items() if is_ours(run, node)}
        work = sum(prices.nanoseconds(count, calls.get(node, {})) for node, count in ours.items()) / 1e6
        sizes[number] = round(16 * sum(count.blocks - count.freed for count in ours.values()))
        garbage += sizes[number]
        at_full = sum(count.instructions.get("(full)", 0) for count in window.values())
        full += at_full
        gc = (collections_in(run, window) + at_full) * prices.gc_ms(used, garbage, overflows)
        if gc:
            garbage = 0
        i2c, adc, sent, idle = run.buses[number]
        heard = number % HEARD_EVERY == 0  # by the plan
        out[number] = Cycle(number, heard, work, gc, (i2c + adc) / 1e6, sent / 1e6, idle / 1e6)
    return out, sizes, full


def collections_in(run: Run, window: dict[int, Count]) -> float:
    """How often gc.collect was carried out in a cycle."""
    return sum(count.calls for node, count in window.items() if run.log.nodes.get(node, (0, -1))[1] == GC_PART)


def _is_armed(run: Run, host: Host) -> bool:
    """After the order and at the end, as telemetry says it."""
    states = [[fields["state"] for name, fields in host.read(data) if name == "TELEM"] for data in run.sent[2:]]
    return all(seen[-1] == 1 for seen in states if seen)


def _complaints(run: Run, host: Host) -> list[str]:
    return list(dict.fromkeys(line for data in run.sent for line in host.complaints(data)))
