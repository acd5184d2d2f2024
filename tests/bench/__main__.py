"""`make bench`: run every bench beside this file, print the table and write bench.json.

A bench is a file bench_*.py with `run() -> {name: {"value", "unit", "against", "ratio"}}`: medians, and a ratio against
a stated alternative of the same run, because machines are noisy.
"""

import importlib
import json
from pathlib import Path

from rich.console import Console
from rich.table import Table

HERE = Path(__file__).parent


def main() -> None:
    console, rows = Console(), {}
    for path in sorted(HERE.glob("bench_*.py")):
        with console.status(path.stem):
            rows.update(importlib.import_module(f"tests.bench.{path.stem}").run())
    table = Table()
    table.add_column("what", no_wrap=True)
    for column in ("value", "unit", "against", "ratio"):
        table.add_column(column, justify="right" if column in ("value", "ratio") else "left")
    for name, row in rows.items():
        ratio = "" if row.get("ratio") is None else f"{row['ratio']:.3g}"
        table.add_row(name, f"{row['value']:.4g}", row["unit"], row.get("against") or "", ratio)
    console.print(table)
    Path("bench.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
