"""How much of the kernel the golden logs enter: `python -m tests.golden.coverage [--missing]`.

Today's kernel replays every golden log, today's vision sees the golden frames, and the golden fleet files and heads
of pictures are read, as the golden tests do it, while coverage.py notes the lines that are entered. What counts are
lines within functions: those of a module or a class run when it is imported, and would say nothing. One row a folder,
for the files that lie directly in it. Exits with 1 if a folder is below LEAST. `--missing` also prints, file by file,
the functions' lines that no log enters, the longest list first.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import coverage

from agent.perception.vision import rerun_vision
from replay.check.reexecute import open_boxes, reexecute
from replay.check.vision_check import check_vision
from tests.golden import fleet_files, picture_heads
from tests.golden.make import SEEN
from tests.places import GOLDEN, ROOT

KERNEL = ("agent/core", "agent/capabilities", "agent/robot")  # with all folders below
LEAST = 80.0  # % of the lines of each folder's functions


class Entered(NamedTuple):
    """Of one file."""

    path: Path
    lines: frozenset[int]  # executable ones within functions
    missed: frozenset[int]  # those of them that no log enters

    @property
    def percent(self) -> float:
        return percent([self])


def main() -> int:
    parser = argparse.ArgumentParser(description="how much of the kernel the golden logs enter")
    parser.add_argument("--missing", action="store_true", help="print the lines that no golden log enters")
    arguments = parser.parse_args()
    folders: dict[str, list[Entered]] = defaultdict(list)
    for each in entered():
        folders[str(each.path.parent.relative_to(ROOT))].append(each)
    if arguments.missing:
        files = (each for found in folders.values() for each in found if each.missed)
        for each in sorted(files, key=lambda each: -len(each.missed)):
            print(f"{each.percent:5.1f} %  {each.path.relative_to(ROOT)}: {spans(each.missed, each.lines)}")
    width = max(map(len, folders))
    print(f"{'folder':{width}} {'function lines':>15} {'entered':>8} {'%':>6}")
    for folder, found in sorted(folders.items()):
        print(row(folder, found, width))
    print(row("all", [each for found in folders.values() for each in found], width))
    low = [folder for folder, found in sorted(folders.items()) if percent(found) < LEAST]
    if low:
        print(f"below {LEAST:g} %: {', '.join(low)}; add a golden log that enters what --missing lists")
    return 1 if low else 0


def entered() -> list[Entered]:
    """Each file of the kernel that has functions, after all golden logs."""
    measure = coverage.Coverage(data_file=None, include=[f"{ROOT / folder}/*" for folder in KERNEL], config_file=False)
    cases = sorted({file.parent for file in GOLDEN.rglob("*.mcap*")})
    with measure.collect():
        for box in open_boxes(cases):
            reexecute(box)
        check_vision([GOLDEN / SEEN], rerun_vision)
        fleet_files.lines()
        picture_heads.read()
    found = []
    for path in sorted(path for folder in KERNEL for path in (ROOT / folder).rglob("*.py")):
        _, statements, _, missed, _ = measure.analysis2(str(path))
        lines = frozenset(statements) & frozenset(within_functions(ast.parse(path.read_text())))
        if lines:
            found.append(Entered(path, lines, lines & frozenset(missed)))
    return found


def within_functions(tree: ast.AST) -> Iterator[int]:
    """Numbers of the lines of all functions' bodies."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield from range(node.body[0].lineno, (node.end_lineno or node.body[-1].lineno) + 1)


def percent(found: list[Entered]) -> float:
    lines = sum(len(each.lines) for each in found)
    return 100.0 * (1.0 - sum(len(each.missed) for each in found) / lines)


def row(folder: str, found: list[Entered], width: int) -> str:
    lines, missed = (sum(map(len, column)) for column in zip(*((e.lines, e.missed) for e in found), strict=True))
    return f"{folder:{width}} {lines:15} {lines - missed:8} {percent(found):6.1f}"


def spans(missed: frozenset[int], lines: frozenset[int]) -> str:
    """Lines as "12, 20-24": a span holds no line that is entered."""
    found: list[tuple[int, int]] = []
    for line in sorted(missed):
        if found and not any(found[-1][1] < other < line for other in lines):
            found[-1] = found[-1][0], line
        else:
            found.append((line, line))
    return ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in found)


if __name__ == "__main__":
    sys.exit(main())
