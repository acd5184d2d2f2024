"""`make bench`: run every bench below this folder, or those that are named, print the table and write bench.json.

`python -m tests.bench recording replay` runs bench_recording.py and bench_replay.py; of all other benches bench.json
keeps the rows it has. `python -m tests.bench board` prints what the firmware costs on the chip, function by function;
--help says what else it can.

A bench is a file bench_*.py with `run() -> {name: {"value", "unit", "against", "ratio"}}`: medians, and a ratio against
a stated alternative of the same run, because machines are noisy.
"""

import importlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.bench.board import commands as board

HERE = Path(__file__).parent
OUT = Path("bench.json")
WIDE = 200  # columns of a table that goes into a file: no cell is cut or folded


def main(names: Sequence[str]) -> int:
    if names[:1] == ["board"]:
        return board.main(names[1:])
    files = sorted(HERE.rglob("bench_*.py"), key=lambda path: path.stem)
    known = {path.stem.removeprefix("bench_"): module_of(path) for path in files}
    if strangers := [name for name in names if name not in known]:
        sys.stderr.write(f"no such bench: {', '.join(strangers)}; choose {', '.join(known)}\n")
        return 2
    console = Console(width=None if sys.stdout.isatty() else WIDE)
    rows: dict[str, dict] = {}
    try:
        for name in names or known:
            with console.status(name):
                rows.update(importlib.import_module(known[name]).run())
    finally:  # a bench that fails does not take the others' figures with it
        console.print(table(rows))
        kept = json.loads(OUT.read_text(encoding="utf-8")) if names and OUT.exists() else {}
        OUT.write_text(json.dumps({**kept, **rows}, indent=1) + "\n", encoding="utf-8")
    return 0


def module_of(path: Path) -> str:
    return ".".join(("tests", "bench", *path.relative_to(HERE).with_suffix("").parts))


def table(rows: dict[str, dict]) -> Table:
    shown = Table()
    shown.add_column("what", no_wrap=True)
    for column in ("value", "unit", "against", "ratio"):
        number = column in ("value", "ratio")
        shown.add_column(column, justify="right" if number else "left", no_wrap=number)
    for name, row in rows.items():
        ratio = "" if row.get("ratio") is None else f"{row['ratio']:.3g}"
        shown.add_row(name, f"{row['value']:.4g}", row["unit"], row.get("against") or "", ratio)
    return shown


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
