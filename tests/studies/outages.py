"""What a computer can do to a fleet that dives, done to real processes: `python -m tests.studies.outages [CASE ...]`.

Agents, twin and recorder are started as a user starts them, linked on loopback; behind each pty is the board's own
firmware. A case does something to them, several times, and says what came of it, a row for each thing that was done.
The exit code is 1 where a row failed. All that was started ends with the command, by Ctrl-C too.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rich.table import Table

from agent.process.command import terminal
from tests.studies import outage_cases
from tests.studies.outage_cases import Row

LONGEST = 2000  # characters of what is said of a failure
Case = Callable[[Path], Iterator[Row]]
CASES: dict[str, tuple[str, Case]] = {
    "serial": ("the tether is pulled and put back", outage_cases.serial),
    "clocks": ("the time of day jumps on one computer", outage_cases.clocks),
    "memory": ("an agent may not have the memory that it takes", outage_cases.memory),
    "kills": ("recorder, agent and twin are killed", outage_cases.kills),
}


def rows_of(name: str, case: Case) -> Iterator[Row]:
    """A case's rows; where it waits in vain, the last one says for what."""
    with tempfile.TemporaryDirectory(prefix=f"outage-{name}-") as folder:
        try:
            yield from case(Path(folder))
        except AssertionError as error:
            yield Row(name, 1, " ".join(str(error).split())[:LONGEST] or "went wrong", "none", False)


def main(arguments: Sequence[str]) -> int:
    asked = argparse.ArgumentParser(prog="python -m tests.studies.outages", description=__doc__)
    about = "; ".join(f"{name}: {what}" for name, (what, _) in CASES.items())
    asked.add_argument("case", nargs="*", help=f"{about}. All if none is named")
    given = asked.parse_args(arguments).case or list(CASES)
    if unknown := set(given) - set(CASES):
        asked.error(f"no such case: {', '.join(sorted(unknown))}")
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    os.environ.pop("RUST_BACKTRACE", None)  # a panic in Zenoh's threads is to look as it does elsewhere
    console, failed = terminal(), False
    for name in given:
        began_s = time.monotonic()
        table = Table("what", "times", "came of it", "bar", "", title=f"{name}: {CASES[name][0]}", title_justify="left")
        for row in rows_of(name, CASES[name][1]):
            table.add_row(row.what, str(row.times), row.figure, row.bar, "ok" if row.ok else "FAILED")
            failed |= not row.ok
        console.print(table, f"took {time.monotonic() - began_s:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
