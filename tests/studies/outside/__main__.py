"""`python -m tests.studies.outside [JUDGE ...]` has outside programs judge the twin, and prints what they found."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import import_module

from tests.places import ROOT
from tests.studies.outside.finding import Finding, rows
from tests.studies.outside.network import Crossing

JUDGES = {  # and what each needs
    "body": "pip install mujoco auv-sim-bench",
    "optics": "pip install mitsuba",
    "network": "run it as root of a Linux machine with iproute2",
}
ROOM = "tests.studies.outside"
PAGE = ROOT / "docs" / "outside.md"
HEAD = {
    "body": "## Body, and the control law on it",
    "optics": "## Optics",
    "network": "## Networks",
}  # of the page, each before its table


def main() -> int:
    """All judges or the named ones; one whose program is not installed is told, and the rest goes on."""
    parser = argparse.ArgumentParser(prog=f"python -m {ROOM}", description=__doc__)
    parser.add_argument("judge", nargs="*", choices=[*JUDGES, []], help="all, if none is named")
    parser.add_argument("--quick", action="store_true", help="a small part of each")
    parser.add_argument("--write", action="store_true", help=f"put the tables into {PAGE.relative_to(ROOT)}")
    given = parser.parse_args()
    for name in given.judge or JUDGES:
        try:
            found = import_module(f"{ROOM}.{name}").judge(given.quick)
        except ImportError as error:
            sys.stdout.write(f"{name}: not judged ({error}): {JUDGES[name]}\n")
            continue
        lines = table(found)
        sys.stdout.write("\n".join(lines) + "\n")
        if given.write:
            PAGE.write_text(with_table(PAGE.read_text(), HEAD[name], lines))
    return 0


def table(found: Sequence[Finding | Crossing]) -> list[str]:
    """As Markdown."""
    columns = found[0].COLUMNS
    head = f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"
    cells = [one.row for one in found if isinstance(one, Crossing)] or rows(
        one for one in found if isinstance(one, Finding)
    )
    return [f"Judged on {datetime.now(UTC):%Y-%m-%d}.", "", *head, *(f"| {' | '.join(each)} |" for each in cells)]


def with_table(page: str, head: str, lines: Sequence[str]) -> str:
    """The page with the lines below a heading, up to the next heading, in place of what stands there."""
    before, _, rest = page.partition(f"{head}\n")
    _, mark, after = rest.partition("\n## ")
    return f"{before}{head}\n\n" + "\n".join(lines) + "\n" + mark + after


if __name__ == "__main__":
    sys.exit(main())
