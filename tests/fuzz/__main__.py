"""`make fuzz`: hostile bytes into whatever takes bytes from outside, until Ctrl-C or for --seconds.

    python -m tests.fuzz [kernel|steps|decoders|wire|firmware|recordings|all] [--count N] [--seed S] [--seconds T]
    python -m tests.fuzz decoders --only page --only fleet; python -m tests.fuzz --list

Parts take turns. What was broken is told once, made small, and kept in tests/fuzz/cases, which `make test` replays.
"""

from __future__ import annotations

import sys
import time
from random import SystemRandom
from typing import Annotated

import typer

from agent.core.config import Protocol
from tests.fuzz import parts

FOR_EVER_S = 10.0**9
TURN_S = 10.0  # of one part, then it is the next one's turn
TOLD_S = 60.0  # from one account of how far it is to the next
TURN = 4000  # inputs of a turn, at most


class Over(Exception):
    """The time is up."""


def main(
    part: Annotated[parts.Name, typer.Argument(help="what to fuzz")] = "all",
    count: Annotated[
        int, typer.Option(help="of each part: messages for each protocol, bytes for each decoder; 0: no end")
    ] = 0,
    seed: Annotated[int | None, typer.Option(help="the same seed gives the same inputs; else any")] = None,
    seconds: Annotated[float, typer.Option(help="0: until Ctrl-C, or until --count")] = 0.0,
    protocol: Annotated[Protocol | None, typer.Option(help="of the kernel; else all three")] = None,
    only: Annotated[list[str] | None, typer.Option(help="of the decoders: those whose names begin so")] = None,
    list_: Annotated[bool, typer.Option("--list", help="say which decoders there are, and what each reads")] = False,
    keep: Annotated[bool, typer.Option(help="new faults become cases")] = True,
) -> None:
    """Look for inputs that break something. Ends with 1 where one was found, with 2 for a name that is none."""
    if list_:
        for line in parts.told():
            say(line)
        return
    if wrong := parts.refused(part, only or ()):
        sys.stderr.write(f"fuzz: {wrong}\n")
        sys.exit(2)
    seed = SystemRandom().randrange(10**6) if seed is None else seed
    end_s = time.monotonic() + (seconds or FOR_EVER_S)
    say(f"seed {seed}")
    running = [each(seed, say, keep) for each in parts.chosen(part, protocol, tuple(only or ()))]
    told_s = time.monotonic()
    try:
        while due := [each for each in running if not count or each.done < count]:
            for each in due:
                if (now_s := time.monotonic()) >= end_s:
                    raise Over
                if now_s - told_s > TOLD_S:
                    told_s = now_s
                    say(f"so far: {', '.join(f'{each.name} {each.done}' for each in running)}")
                each.turn(min(TURN, count - each.done) if count else TURN, min(end_s, now_s + TURN_S))
    except (Over, KeyboardInterrupt):
        pass
    for each in running:
        say(f"{each.name}: {each.done} {each.of}, {each.rate():.0f} a second; {each.faults} faults")
    sys.exit(any(each.faults for each in running))


def say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    typer.run(main)
