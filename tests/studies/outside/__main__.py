"""`python -m tests.studies.outside [JUDGE ...]` has outside programs judge the twin, and prints what they found."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

JUDGES = {"body": "mujoco auv-sim-bench", "optics": "mitsuba"}  # and what to install for each
ROOM = "tests.studies.outside"


def main() -> int:
    """All judges or the named ones; one whose program is not installed is told, and the rest goes on."""
    parser = argparse.ArgumentParser(prog=f"python -m {ROOM}", description=__doc__)
    parser.add_argument("judge", nargs="*", choices=[*JUDGES, []], help="all, if none is named")
    parser.add_argument("--quick", action="store_true", help="a small part of each")
    given = parser.parse_args()
    for name in given.judge or JUDGES:
        try:
            module = import_module(f"{ROOM}.{name}")
        except ImportError as error:
            sys.stdout.write(f"{name}: not judged ({error}): pip install {JUDGES[name]}\n")
            continue
        for one in module.judge(given.quick):
            mark = "agrees" if one.passes else "differs"
            sys.stdout.write(
                f"{mark:8} {one.quantity}: twin {one.twin:.4g}, {one.judge} {one.outside:.4g} {one.unit}\n"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
