"""What the plugin counted: instructions by function of the interpreter, in each window, at each place of the firmware.

A window is a cycle. A node is a function of the firmware as called from one place; node 0 is the program itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Count:
    """What one node did in one window."""

    calls: float
    blocks: float  # of the heap, taken
    freed: float
    instructions: dict[str, float] = field(default_factory=dict)  # by function of the interpreter
    called: dict[str, float] = field(default_factory=dict)


@dataclass
class Log:
    """All windows, and where each node hangs: node -> (parent, part)."""

    nodes: dict[int, tuple[int, int]]
    windows: list[dict[int, Count]]

    def path(self, node: int) -> tuple[int, ...]:
        """The parts that lead there."""
        parts = []
        while node:
            node, part = self.nodes[node]
            parts.append(part)
        return tuple(reversed(parts))


def read(path: Path) -> Log:
    """The plugin's file; count.c says what is in it."""
    names: dict[int, str] = {}
    log = Log({}, [])
    with path.open() as file:
        for line in file:
            word, *rest = line.split()
            if word == "C":
                names[int(rest[0])] = rest[1]
            elif word == "N":
                node, parent, part = map(int, rest)
                log.nodes[node] = (parent, part)
            elif word == "E":
                log.windows.append({})
            elif word == "n":
                node, calls, blocks, freed = map(int, rest[:4])
                count = log.windows[-1][node] = Count(calls, blocks, freed)
                for pair in rest[4:]:
                    key, value = map(int, pair.split(":"))
                    if key >= 0:
                        count.instructions[names[key]] = value
                    else:
                        count.called[names[-key - 1]] = value
    return log


def mean_of(logs: Sequence[Log]) -> Log:
    """Several runs of the same as one."""
    out = Log(dict(logs[0].nodes), [{} for _ in logs[0].windows])
    at = {out.path(node): node for node in out.nodes} | {(): 0}
    share = 1.0 / len(logs)
    for log in logs:
        to = {0: 0}
        for node in sorted(log.nodes):
            path = log.path(node)
            if path not in at:
                at[path] = max(out.nodes) + 1
                out.nodes[at[path]] = (at[path[:-1]], path[-1])
            to[node] = at[path]
        for mean, window in zip(out.windows, log.windows, strict=True):
            for node, count in window.items():
                total = mean.setdefault(to[node], Count(0, 0, 0))
                total.calls += share * count.calls
                total.blocks += share * count.blocks
                total.freed += share * count.freed
                for sums, parts in ((total.instructions, count.instructions), (total.called, count.called)):
                    for name, n in parts.items():
                        sums[name] = sums.get(name, 0.0) + share * n
    return out
