"""MicroPython's Unix port, under qemu-x86_64 with our plugin that counts, or as it is."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

from tests.studies.board.elf import FUNCTION, symbols
from tests.studies.board.tools import HERE, BoardError, Tools

# What count.c looks at in a function of the interpreter: see there.
RUNS, LEAVES, COLLECTS, ALLOCATES, READS_TOTAL, STATE = 1, 2, 4, 8, 16, 32
FLAGS = {
    "fun_bc_call": RUNS | LEAVES,
    "fun_native_call": RUNS | LEAVES,
    "fun_viper_call": RUNS | LEAVES,
    "gc_collect": COLLECTS | LEAVES,
    "gc_collect_end": LEAVES,
    "gc_alloc": ALLOCATES,
    "gc_free": ALLOCATES,
    "gc_realloc": ALLOCATES,
    "m_free": ALLOCATES,
    "m_get_total_bytes_allocated": READS_TOTAL,
    "mp_state_ctx": STATE,
}
STATE_NAME = "mp_state_ctx"
HEAP_KB = 4000
PATIENCE_S = 300.0


def run(tools: Tools, folder: Path, script: str, log: Path | None, talk: Callable[[str], str | None]) -> list[str]:
    """Run `script` in `folder`; all lines that it prints. `talk` sees each and may give a line back.

    log: where the counts go; None: nothing is counted. Raises BoardError where the script breaks off.
    """
    (folder / "run.py").write_text(script)
    command = [*tools.micropython, "-X", f"heapsize={HEAP_KB}k", "run.py"]
    if log is not None:
        command = [*_counting(tools, folder, log), *command]
    process = subprocess.Popen(
        command,
        cwd=folder,
        env={"PYTHONHASHSEED": "0", "LC_ALL": "C", "HOME": "/"},  # no more: what is in it moves the stack
        text=True,
        bufsize=1,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    patience = threading.Timer(PATIENCE_S, process.kill)
    patience.start()
    lines = []
    with process:
        assert process.stdin and process.stdout and process.stderr
        for line in process.stdout:
            lines.append(line.rstrip("\n"))
            answer = talk(lines[-1])
            if answer is not None:
                process.stdin.write(answer + "\n")
                process.stdin.flush()
        trouble = process.stderr.read().strip()
    patience.cancel()
    if process.returncode < 0:
        raise BoardError("no end after five minutes: the firmware has to sleep in pyb.wfi or machine.idle")
    if process.returncode:
        raise BoardError("in the firmware: " + " | ".join(([*lines[-2:], *trouble.splitlines()])[-4:]))
    return lines


def _counting(tools: Tools, folder: Path, log: Path) -> list[str]:
    """The beginning of a command that counts what the rest of it does."""
    rows = [
        f"{symbol.offset:x} {symbol.size:x} {FLAGS.get(symbol.name, 0)} {symbol.name}\n"
        for symbol in symbols(tools.image)
        if symbol.kind == FUNCTION or symbol.name == STATE_NAME
    ]
    table = folder / "table"
    table.write_text(tools.image.name + "\n" + "".join(rows))
    plugin = f"{tools.plugin},table={table},log={log},heap={HERE / 'heap.txt'}"
    return [tools.qemu, "-cpu", "max", "-seed", "1", "-plugin", plugin]
