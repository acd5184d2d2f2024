"""The firmware on pretended hardware: boots, armed and disarmed, and its cycles counted."""

from __future__ import annotations

import binascii
import json
import os
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from hw.firmware import failsafe
from tests.studies.board import counts, emulator, host, sources
from tests.studies.board.sources import BOARD, COMPUTER, Compiler
from tests.studies.board.tools import HERE, BoardError, Tools

HELLO, ASK, ARM, LOOK = 20, 24, 330, 345  # cycles: a greeting, its answer, 3 s of neutral pulses later the order
DISARMED, ARMED = range(120, 320), range(346, 546)  # that are counted
HEARD_EVERY = 5  # cycles: set-points at 20 Hz
# Which names collide in the interpreter's tables depends on the number each got when it was first seen, so that a new
# name anywhere moves everything by up to 1 %: so many unused names come first in one boot each, and the mean counts.
NUMBERINGS = (0, 2, 4, 8, 13, 21)
FAKES = 2000  # parts from here on are the pretended hardware's
GC_PART = 3999  # as in count.c
PRETENDED = ("b_state", "b_machine", "b_pyb", "b_time", "b_gc", "b_sys", "b_plan")
STANDS_FOR = {
    "machine": "b_machine",
    "pyb": "b_pyb",
    "stm": "b_pyb",
    "time": "b_time",
    "utime": "b_time",
    "gc": "b_gc",
    "sys": "b_sys",
}


@dataclass(frozen=True)
class Options:
    """What is measured."""

    firmware: Path  # the folder with main.py
    law: str = "observer"
    optimise: int = sources.SHIPPED
    gc_every: int = 1  # of the firmware's calls of gc.collect, every so manyth is carried out
    native: tuple[str, ...] = ()


@dataclass
class Run:
    """What came of it."""

    lines: list[str]
    log: counts.Log
    labels: dict[int, str]  # part -> name
    numbers: list[int]  # of the cycles counted
    buses: dict[int, tuple[int, int, int, int]]  # cycle -> ns of I2C, ADC, sent, idle
    sent: list[bytes]  # by the board
    set_point: int  # bytes of one
    compiled: int  # bytes of its .mpy files for the board
    bytecode: int  # the same with nothing in its native functions


def run(tools: Tools, options: Options) -> tuple[Run, host.Host]:
    """The mean of several boots that differ in nothing but the numbers of names."""
    texts = sources.with_native(sources.candidates(options.firmware), list(options.native))
    # One host each, whose frames begin at number 0: the same bytes, whichever boot is first.
    hosts = [host.Host(options.firmware) for _ in NUMBERINGS]
    kept = _kept(tools, options, host.Host(options.firmware), texts)
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        runs = list(pool.map(lambda h, n: _boot(tools, options, h, texts, kept, n), hosts, NUMBERINGS))
    runs[0].log = counts.mean_of([run.log for run in runs])
    return runs[0], hosts[0]


def _kept(tools: Tools, options: Options, speaks: host.Host, texts: dict[str, str]) -> dict[str, str]:
    """Those modules that are there in a dive: neither never imported nor dropped after boot. Found without counting, in
    less than a second."""
    script = _script(speaks, options, 0, '\nprint("IMPORTED", " ".join(sys.modules))\n')
    lines = _carry_out(tools, options, speaks, texts, script, None)[0]
    names = {"main", *next(line for line in reversed(lines) if line.startswith("IMPORTED ")).split()[1:]}
    return {name: text for name, text in texts.items() if name in names}


def _boot(
    tools: Tools, options: Options, speaks: host.Host, texts: dict[str, str], kept: dict[str, str], numbering: int
) -> Run:
    functions = sources.functions(kept)
    fakes = [f for f in sources.functions(_pretended()) if f.module != "b_plan"]
    rows = [(i, f) for i, f in enumerate(functions)] + [(FAKES + i, f) for i, f in enumerate(fakes)]
    parts = "".join(f"{i} {f.module} {f.owner or '-'} {f.name}\n" for i, f in rows)
    script = _script(speaks, options, numbering)
    lines, sent, counted = _carry_out(tools, options, speaks, texts, script, parts)
    assert counted is not None
    buses = {}
    for line in lines:
        if line.startswith("CYCLE "):
            number, i2c, adc, tx, idle = map(int, line.split()[1:])
            buses[number] = (i2c, adc, tx, idle)
    board = Compiler(tools.mpy_cross, BOARD, options.optimise)
    sizes = board.size(kept), board.size(sources.without_native(kept))
    size = len(speaks.set_point(host.BUSY))
    return Run(lines, counted, {i: f.label for i, f in rows}, list(buses), buses, sent, size, *sizes)


def _carry_out(
    tools: Tools, options: Options, speaks: host.Host, texts: dict[str, str], script: str, parts: str | None
) -> tuple[list[str], list[bytes], counts.Log | None]:
    """One boot with what the board has in its flash; the lines of the script, what the board sent, what was counted.

    parts: the table of functions; None: nothing is counted.
    """
    files = Compiler(tools.mpy_cross, COMPUTER, options.optimise).files(texts)
    for name, text in _pretended().items():
        files |= Compiler(tools.mpy_cross, COMPUTER, 0).module(name, text)
    saved = json.dumps({"law": options.law, "tare_pa": [106000.0] * 4, "wiring": failsafe.WIRING})
    files["flash.json"] = f"{saved}\n{binascii.crc32(saved.encode()):08x}\n".encode()
    files["parts.txt"] = (parts or "").encode()
    sent: list[bytes] = []

    def talk(line: str) -> str | None:
        word, _, rest = line.partition(" ")
        if word == "SENT":
            sent.append(bytes.fromhex(rest))
        elif word == "ASK":
            for name, fields in speaks.read(sent[-1]):
                if name == "HELLO_ACK":
                    return f"{ARM} {speaks.arm(fields['boot_id']).hex()}"
            raise BoardError("the firmware does not answer HELLO: it has to read and write a machine.UART")
        return None

    with tempfile.TemporaryDirectory() as folder:
        for name, data in files.items():
            (Path(folder) / name).write_bytes(data)
        log = None if parts is None else Path(folder) / "log"
        lines = emulator.run(tools, Path(folder), script, log, talk)
        return lines, sent, None if log is None else counts.read(log)


def _pretended() -> dict[str, str]:
    return {name: (HERE / "pretended" / (name + ".py")).read_text() for name in PRETENDED}


def _script(speaks: host.Host, options: Options, numbering: int, ending: str = "") -> str:
    hello = speaks.hello()
    neutral, busy = speaks.set_point(host.NEUTRAL), speaks.set_point(host.BUSY)
    last = ARMED.stop - 1
    plan = [
        [1, 0, 0, "free"],
        [HELLO, 0, 0, hello],
        [ASK, 0, 0, "ask"],
        [ASK + 1, HEARD_EVERY, ARM + 4, neutral],
        [ARM + 5, HEARD_EVERY, last, busy],
        [ARM - 2, 0, 0, "sent"],
        [LOOK, 0, 0, "sent"],
        [last - 30, 0, 0, "sent"],
        [last + 1, 0, 0, "done"],
    ]
    return f"""
for i in range({numbering}):
    hasattr(int, "unused%d" % i)
import sys
import gc
sys.path[:] = ['.']
import {", ".join(PRETENDED)}
b_state.every = {options.gc_every}
b_plan.rows.extend({plan!r})
b_plan.window = ({DISARMED.start}, {last})
_say, _modules = b_plan.say, {STANDS_FOR!r}
for _name in _modules:
    sys.modules[_name] = eval(_modules[_name])
gc.collect()
print("HEAP", gc.mem_free(), gc.mem_alloc())
exec(open("main_a.py").read())
b_plan.register("parts.txt", globals())
try:
    exec(open("main_b.py").read())
except b_plan.Done:
    pass
print("SENT", b_state.tx.hex()){ending}
"""
