"""What agreement costs a robot: time of an iteration and bytes of a message, by number of neighbours."""

from __future__ import annotations

import time
from random import Random
from statistics import median
from typing import Any

from agent.core.codec import decode, encode
from agent.core.estimation.evidence import Evidence
from agent.core.estimation.evidence_table import Bounds
from agent.core.estimation.interface import EstimateCache, Estimator, Prior
from agent.core.estimation.protocols import Metropolis, Paper
from agent.core.messages import Epoch, Estimate
from tests.sample_messages import estimate

NEIGHBOURS = (3, 10, 50)
ITERATIONS = 12
SECOND_NS = 1_000_000_000
BUDGET_US = 10_000.0  # 1 % of an iteration of one second
DATAGRAM = 1400  # bytes that travel unbroken
COV = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)


def run() -> dict[str, dict[str, Any]]:
    """Medians: processor time of hearing all neighbours and ticking once, bytes of a message; each against `paper`.

    `paper` itself stands against what there is: 1 % of an iteration, and one datagram.
    """
    rows: dict[str, dict[str, Any]] = {}
    for neighbours in NEIGHBOURS:
        paper_us, paper_bytes = _measure("paper", neighbours)
        rows[f"paper_{neighbours}_neighbours_tick"] = _row(paper_us, "us", "1 % of an iteration", BUDGET_US)
        rows[f"paper_{neighbours}_neighbours_message"] = _row(paper_bytes, "bytes", "one datagram", DATAGRAM)
        for kind in ("metropolis", "evidence", "evidence_moving"):
            took_us, size = _measure(kind, neighbours)
            name = f"{kind}_{neighbours}_neighbours"
            rows[f"{name}_tick"] = _row(took_us, "us", "paper", paper_us)
            rows[f"{name}_message"] = _row(size, "bytes", "paper", paper_bytes)
    return rows


def _row(value: float, unit: str, against: str, by: float) -> dict[str, Any]:
    return {"value": value, "unit": unit, "against": f"{against} ({by:.4g} {unit})", "ratio": value / by}


def _measure(kind: str, neighbours: int) -> tuple[float, float]:
    """(us, bytes) of a robot in the middle of a star, which has as many origins as neighbours, and itself."""
    names, random = [f"r{k}" for k in range(neighbours + 1)], Random(1)
    robots = {name: _robot(kind, name, names) for name in names}
    me, *others = names
    box = EstimateCache("tank", me, "ball", tuple(others))
    boxes = {name: EstimateCache("tank", name, "ball", (me,)) for name in others}
    took_us, sizes, now_ns = [], [], SECOND_NS
    for seq in range(ITERATIONS):
        letters = [(name, decode(_say(robots[name], name, me, seq, now_ns, sizes), Estimate)) for name in others]
        priors = {name: Prior((0.7 + random.gauss(0, 0.01), 0.5, 0.1), COV, now_ns) for name in names}
        started = time.process_time()
        for name, letter in letters:
            robots[me].hear(box.put(name, letter, now_ns))
        robots[me].tick(priors[me], box, now_ns)
        took_us.append((time.process_time() - started) * 1e6)
        for name in others:
            letter = decode(_say(robots[me], me, name, seq, now_ns, sizes), Estimate)
            robots[name].hear(boxes[name].put(me, letter, now_ns))
            robots[name].tick(priors[name], boxes[name], now_ns)
        now_ns += SECOND_NS
    return median(took_us[2:]), median(sizes[len(sizes) // 2 :])


def _robot(kind: str, name: str, names: list[str]) -> Estimator:
    neighbours = tuple(n for n in names if n != name)
    if kind == "paper":
        return Paper(2 * SECOND_NS)
    if kind == "metropolis":
        return Metropolis(name, 2 * SECOND_NS, len(neighbours))
    bounds = Bounds(frozenset(names), (1.5, 1.2, 0.8), SECOND_NS)
    robot = Evidence(name, 1, neighbours, 2 * SECOND_NS, bounds)
    if kind == "evidence_moving":
        robot.begin(Epoch(1, True, "r0"), 0)
    return robot


def _say(robot: Estimator, src: str, dst: str, seq: int, now_ns: int, sizes: list[int]) -> bytes:
    word = estimate(src, dst, seq=seq, sent_ns=now_ns, t=robot.t, valid=robot.valid, **robot.say(dst, now_ns)._asdict())
    payload = encode(word)
    sizes.append(len(payload))
    return payload
