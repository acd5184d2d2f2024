"""`python -m tests.studies.board` prints what the firmware costs on an STM32F407, estimated on this computer."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.studies.board import estimate, imposed, sources
from tests.studies.board.boots import Options
from tests.studies.board.report import report
from tests.studies.board.tools import FIRMWARE, BoardError, MissingTool


def main(words: Sequence[str]) -> int:
    """Print the table; where tools are missing, say which."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.board", description=__doc__)
    parser.add_argument("--firmware", type=Path, default=FIRMWARE, metavar="DIR", help="folder with main.py")
    parser.add_argument("--law", default="observer", choices=("observer", "pid", "pi"))
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    parser.add_argument("--write", action="store_true", help="make them the times that the twin goes by")
    parser.add_argument("--least", type=float, default=0.03, metavar="MS", help="no row for what takes less a cycle")
    parser.add_argument(
        "-O", type=int, dest="optimise", default=sources.SHIPPED, choices=range(4), help="of mpy-cross; 3 is what ships"
    )
    parser.add_argument("--gc-every", type=int, default=1, metavar="N", help="carry out every Nth call of gc.collect")
    parser.add_argument("--native", nargs="+", default=[], metavar="NAME", help="with @micropython.native: thrust.*")
    given = parser.parse_args(words)
    options = Options(given.firmware.resolve(), given.law, given.optimise, given.gc_every, tuple(given.native))
    try:
        measured = estimate.measure(options)
    except (MissingTool, BoardError, ImportError, SyntaxError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    result = estimate.figures(measured, options)
    report(result, given.least)
    if given.write:
        sys.stdout.write(f"\n{imposed.write(measured)}\n")
    elif hint := imposed.hint(options.firmware):
        sys.stdout.write(f"\n{hint}\n")
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
