"""How fast news spreads in large swarms, in virtual time: the tables of agents, a list instead of a network.

Each robot steps 20 times a second, at moments of its own as processes do, measures once a second, and speaks as
`Targets.say` has it: to all in a round, and between two rounds at once where there is news. What is said is there at
the listener's next step. Nothing is concluded: how much a robot knows is counted in samples.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from random import Random
from typing import NamedTuple

import numpy as np

from agent.core.codec import encode
from agent.core.config import Link
from agent.core.estimation.evidence import ENTRIES, StaticTarget
from agent.core.estimation.evidence_table import Bounds
from agent.core.estimation.fuse import NONE
from agent.core.estimation.interface import Prior
from agent.core.estimation.modes import Me
from agent.core.messages import Epoch, Gossip
from agent.core.target_state import BETWEEN_NS
from agent.core.topics import next_due_ns
from agent.core.trust import Authority
from agent.experiments.claim import Row
from agent.experiments.localization.lockstep import Graph, graph
from agent.process.agent_process import STEP_NS
from tests.sample_messages import estimate

SECOND_NS = 1_000_000_000
ROUND_NS = round(SECOND_NS / Link().send_hz)
START_NS = 10 * SECOND_NS
COV = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
SIZED = 40  # every so many messages one is encoded


def spread(links: Graph, seed: int, seconds: float, between: bool = True) -> Row:
    """Until all know a sample of all, s; how wrong robots are after `seconds` in times of the bound; traffic of a link.

    A robot that knows n of all N samples, which are alike, has sqrt(N / n) times the error of one that knows all.
    """
    swarm = Swarm(links, seed, between)
    all_s = next((now_s for now_s in swarm.until(seconds) if not swarm.ignorant), None)
    for _ in swarm.until(seconds):
        pass
    known = [sum(entry.count for entry in robot.entries) for robot in swarm.robots]
    directed = sum(map(len, links))
    return {
        "all_s": math.inf if all_s is None else all_s,
        "bound": math.sqrt(float(np.mean(sum(swarm.samples) / np.array(known)))),
        "messages_hz": swarm.messages / directed / seconds,
        "kb_s": 1e-3 * float(np.mean(swarm.sizes)) * swarm.messages / directed / seconds,
        "most_kb": 1e-3 * max(swarm.sizes),
    }


class Heard(NamedTuple):
    src: str
    gossip: Gossip
    at_ns: int


class Robot(StaticTarget):
    """Its table, and when it spoke."""

    def __init__(self, name: str, near: tuple[str, ...], bounds: Bounds, links: frozenset[tuple[str, str]]) -> None:
        me = Me((name, START_NS), near, bounds, ENTRIES, NONE, Authority(near), ("tank", "ball"), links=links)
        super().__init__(me, Epoch())
        self.name, self.near, self.post = name, near, list[Heard]()
        self.told_ns = dict.fromkeys(near, 0)

    @property
    def entries(self):
        return self._table.entries.values()


class Swarm:
    def __init__(self, links: Graph, seed: int, between: bool) -> None:
        random, names = Random(seed), [f"r{i}" for i in range(len(links))]
        bounds = Bounds(frozenset(names), (1.5, 1.2, 0.8), SECOND_NS)
        pairs = frozenset((names[i], names[j]) for i, near in enumerate(links) for j in near)
        self._between = between
        self.robots = [
            Robot(name, tuple(names[j] for j in near), bounds, pairs) for name, near in zip(names, links, strict=True)
        ]
        self._by_name = {robot.name: robot for robot in self.robots}
        self._steps = [(START_NS + random.randrange(STEP_NS), i) for i in range(len(links))]
        self._measures_ns = [START_NS + random.randrange(SECOND_NS) for _ in links]
        self._round_ns = [START_NS + random.randrange(ROUND_NS) for _ in links]
        self.samples = [0] * len(links)
        self.ignorant = set(range(len(links)))  # robots that lack some robot's samples
        self.messages, self.sizes = 0, list[int]()
        heapq.heapify(self._steps)

    def until(self, seconds: float) -> Iterator[float]:
        """Step by step: the time."""
        while self._steps[0][0] < START_NS + round(seconds * SECOND_NS):
            now_ns, i = self._steps[0]
            heapq.heapreplace(self._steps, (now_ns + STEP_NS, i))
            self._step(i, now_ns)
            yield (now_ns - START_NS) / SECOND_NS

    def _step(self, i: int, now_ns: int) -> None:
        robot = self.robots[i]
        post, robot.post = robot.post, []
        for heard in post:
            assert robot.hear(heard.src, heard.gossip, heard.at_ns, None) == []
        if len(robot.entries) == len(self.robots):
            self.ignorant.discard(i)
        if now_ns >= self._measures_ns[i]:
            self._measures_ns[i] += SECOND_NS
            self.samples[i] += 1
            robot.add(self.samples[i], Prior((0.7, 0.5, 0.1), COV, now_ns), now_ns)
        in_round = now_ns >= self._round_ns[i]
        if in_round:
            self._round_ns[i] = next_due_ns(self._round_ns[i], ROUND_NS, now_ns)
        for to in robot.near:
            if in_round:
                self._say(robot, to, robot.say(to, now_ns), now_ns)
            elif self._between and now_ns - robot.told_ns[to] >= BETWEEN_NS and robot.news(to):
                self._say(robot, to, robot.say(to, now_ns, between=True), now_ns)

    def _say(self, robot: Robot, to: str, gossip: Gossip, now_ns: int) -> None:
        robot.told_ns[to] = now_ns
        self.messages += 1
        if self.messages % SIZED == 0:
            about = {"x_m": (0.7, 0.5, 0.1), "cov_m2": COV, "echo": (now_ns, STEP_NS), "common": "0123456789abcdef"}
            self.sizes.append(len(encode(estimate(robot.name, to, sent_ns=now_ns, gossip=gossip, **about))))
        self._by_name[to].post.append(Heard(robot.name, gossip, now_ns))


def nearest(robots: int, near: int, seed: int) -> Graph:
    """Robots anywhere in a square, each linked with its so many nearest."""
    place = np.random.default_rng(seed).random((robots, 2))
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)
    np.fill_diagonal(apart, math.inf)
    pairs = {(i, int(j)) for i, row in enumerate(np.argsort(apart, axis=1)[:, :near]) for j in row}
    pairs |= {(j, i) for i, j in pairs}
    return tuple(tuple(sorted(j for i, j in pairs if i == robot)) for robot in range(robots))


def row_of(case: str, seed: int) -> Row:
    """Of one of the three swarms."""
    if case == "line":
        return spread(graph("line", 300), seed, 10.0)
    if case == "ring":
        return spread(graph("ring", 100), seed, 10.0)
    return spread(nearest(1000, 6, seed=7), seed, 4.0)
