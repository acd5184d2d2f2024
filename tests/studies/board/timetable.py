"""From the costs of single cycles to a timetable: which cycles fit into their tick, and how many ticks are lost."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import mean

TICK_MS = 10.0
SET_POINT_MS = 50.0
SIMULATED_MS = 60000.0
FIRST_MS = 3.3  # a set-point comes at no round moment
SLACK_MS = 2.0  # within so much of a cycle's beginning it is still heard in that cycle


@dataclass(frozen=True)
class Cycle:
    """One that was run, in ms."""

    number: int
    heard: bool  # a set-point came in it
    work: float  # of the processor, without gc
    gc: float
    i2c: float  # with ADC
    sent: float  # UART, which the firmware waits for
    idle: float  # UART, waiting for more

    @property
    def total(self) -> float:
        return self.work + self.gc + self.i2c + self.sent + self.idle


@dataclass(frozen=True)
class Timetable:
    """What a minute looks like."""

    mean_ms: float  # of a cycle's work, all included
    worst_ms: float
    cycles_s: float
    lost: float  # share of ticks
    set_point_ms: float  # what hearing one takes, the wait for more included
    periods_ms: list[float]  # from one cycle to the next, a hundred of them


def timetable(cycles: Sequence[Cycle]) -> Timetable:
    """Repeat the measured cycles for a minute, with ticks of 10 ms and set-points every 50 ms.

    A cycle that takes longer than its tick is followed by the next at once. Set-points come as they come: what
    hearing one takes is the mean difference between cycles that send alike, with and without one.
    """
    hearing = hearing_ms(cycles)
    base = [cycle.total - (hearing if cycle.heard else 0.0) for cycle in cycles]
    at, tick, n, lost, busy, due = 0.0, 0, 0, 0, 0.0, FIRST_MS
    begins = []
    while at < SIMULATED_MS:
        now = int(at // TICK_MS)
        if now <= tick:
            now = tick + 1
            at = now * TICK_MS
        lost += now - tick - 1
        tick = now
        begins.append(at)
        takes = base[n % len(base)]
        n += 1
        if due <= at + SLACK_MS:
            takes += hearing
            while due <= at + SLACK_MS:
                due += SET_POINT_MS
        at += takes
        busy += takes
    periods = [round(b - a, 2) for a, b in pairwise(begins[100:201])]
    return Timetable(busy / n, max(base) + hearing, 1000.0 * n / SIMULATED_MS, lost / tick, hearing, periods)


def hearing_ms(cycles: Sequence[Cycle]) -> float:
    """What a set-point adds to a cycle."""
    groups: dict[float, tuple[list[float], list[float]]] = defaultdict(lambda: ([], []))
    for cycle in cycles:
        groups[round(cycle.sent, 2)][cycle.heard].append(cycle.work + cycle.idle)
    both = [(mean(heard) - mean(quiet), len(heard)) for quiet, heard in groups.values() if quiet and heard]
    return sum(x * n for x, n in both) / sum(n for _, n in both) if both else 0.0


def kinds(cycles: Sequence[Cycle]) -> dict[str, list[Cycle]]:
    """Cycles sorted by what they send, quiet ones first, and whether they hear."""
    by_sent = sorted({round(cycle.sent, 2) for cycle in cycles})
    out = {}
    for sent in by_sent:
        for heard in (False, True):
            group = [c for c in cycles if round(c.sent, 2) == sent and c.heard == heard]
            if group:
                name = f"sends {sent:.2f} ms" if sent else "sends nothing"
                out[name + (", hears" if heard else "")] = group
    return out
