"""The firmware's functions by the place that they are called from, and what each takes there."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

from tests.studies.board import prices
from tests.studies.board.boots import FAKES, GC_PART, Run
from tests.studies.board.counts import Count

SLEEPS = ("b_pyb.wfi", "b_machine.idle")


@dataclass
class Node:
    """A function as called from one place: ms and bytes with all that it calls."""

    calls: float = 0
    own: float = 0.0
    total: float = 0.0
    size: float = 0
    worst: float = 0.0
    collects: bool = False
    calls_in: dict[int, float] = field(default_factory=dict)  # of one cycle
    children: dict[int, Node] = field(default_factory=dict)


def is_ours(run: Run, node: int) -> bool:
    """Whether it is the firmware's, and not the pretended hardware's."""
    return run.log.nodes.get(node, (0, -1))[1] < FAKES


def pretended(run: Run, window: dict[int, Count]) -> dict[int, dict[str, float]]:
    """Node -> calls of the pretended hardware, by name."""
    out: dict[int, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for node, count in window.items():
        parent, part = run.log.nodes.get(node, (0, -1))
        if FAKES <= part != GC_PART and run.log.nodes.get(parent, (0, -1))[1] < FAKES:
            out[parent][run.labels[part]] += count.calls
    return out


def tree(run: Run, wanted: range) -> tuple[Node, float, int]:
    """All functions by place; ms of those that contain the sleep, and of what has no function; how many cycles."""
    sleeping = set()
    for node, (_, part) in run.log.nodes.items():
        if run.labels.get(part) in SLEEPS:
            while node:
                sleeping.add(node)
                node = run.log.nodes[node][0]
    root, rest, seen = Node(), 0.0, 0
    for number, window in zip(run.numbers, run.log.windows, strict=True):
        if number in wanted:
            seen += 1
            rest += _add(run, root, sleeping, number, window)
    return root, rest, seen


def _add(run: Run, root: Node, sleeping: set[int], number: int, window: dict[int, Count]) -> float:
    """One cycle; returns the ms that have no place."""
    rest = 0.0
    calls = pretended(run, window)
    now: dict[int, tuple[Node, float]] = {}
    for node, count in window.items():
        place = [n for n in _line(run, node) if n not in sleeping]
        if not is_ours(run, node):
            if run.log.nodes[node][1] == GC_PART:
                for step in _walk(root, run, place[:-1]):
                    step.collects = True
            continue
        ms = prices.nanoseconds(count, calls.get(node, {})) / 1e6
        if not place:
            rest += ms
            continue
        way = _walk(root, run, place)
        way[-1].calls += count.calls
        way[-1].own += ms
        for step in way:
            step.total += ms
            step.size += 16 * (count.blocks - count.freed)
            before = now.get(id(step), (step, 0.0))[1]
            now[id(step)] = (step, before + ms)
        way[-1].calls_in[number] = way[-1].calls_in.get(number, 0) + count.calls
    for step, ms in now.values():
        n = step.calls_in.get(number, 0)
        step.worst = max(step.worst, ms / n if n else 0.0)
    return rest


def _line(run: Run, node: int) -> list[int]:
    line = []
    while node:
        line.append(node)
        node = run.log.nodes[node][0]
    return line[::-1]


def _walk(root: Node, run: Run, place: list[int]) -> list[Node]:
    way, at = [], root
    for node in place:
        part = run.log.nodes[node][1]
        if part >= FAKES:
            break
        at = at.children.setdefault(part, Node())
        way.append(at)
    return way


def rows(root: Node, run: Run, seen: int) -> list[dict[str, Any]]:
    """The tree in order, most expensive first."""
    out: list[dict[str, Any]] = []

    def walk(node: Node, depth: int) -> None:
        for part, child in sorted(node.children.items(), key=lambda item: -item[1].total):
            calls = max(1, child.calls)
            out.append(
                {
                    "depth": depth,
                    "part": run.labels[part],
                    "calls_a_cycle": child.calls / seen,
                    "ms_a_call": child.total / calls,
                    "worst_ms": child.worst,
                    "ms_a_cycle": child.total / seen,
                    "own_ms_a_cycle": child.own / seen,
                    "bytes_a_call": None if child.collects else child.size / calls,
                }
            )
            walk(child, depth + 1)

    walk(root, 0)
    return out
