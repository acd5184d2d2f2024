"""A swarm in virtual time: the agents' own estimators and mailboxes, a list instead of a network.

All tick, then all speak; what is not lost arrives at once, and a posterior that is read after it makes use of it.
Nothing is encoded: what the bytes do is the business of other tests, and this makes a thousand robots affordable.
Signatures are perfect ones that cost nothing (perfect_keys.py), where there are any.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random

from agent.core.config import Estimation, Fleet, Pose, Protocol, Robot, Tank, Target
from agent.core.estimation.interface import Estimator, Mailbox, Prior, Update
from agent.core.estimation.protocols import estimator
from agent.core.linear_algebra import upper
from agent.core.messages import Estimate, Symmetric
from agent.experiments.localization.graphs import Graph
from agent.experiments.localization.perfect_keys import perfect_signing, public_keys, verify
from agent.experiments.localization.world import Array

VALIDITY = 1.5  # iterations: the last round counts, the one before it does not
TARGET = "ball"


class Swarm:
    """One estimator per robot; `robots[i]` shows what robot i believes."""

    def __init__(
        self,
        protocol: Protocol,
        graph: Graph,
        loss: float,
        random: Random,
        iteration_s: float = 1.0,
        says: int = 1,
        *,
        liars: int = 1,
        clip: bool = False,
        signed: bool = False,
    ) -> None:
        """loss: share of messages that vanish, each on its own. says: how often all speak in an iteration.

        liars, clip: as in the fleet file. signed: evidence is signed by its origin.
        """
        self._fleet = fleet(protocol, graph, iteration_s, liars, clip)
        self._validity_ns = round(self._fleet.estimation.validity_s * 1e9)
        self._iteration_ns = round(iteration_s * 1e9)
        self._names = list(self._fleet.robot)
        self._loss, self._random, self._says = loss, random, says
        self._starts_ns = [0] * len(graph)
        self._signs = [perfect_signing(name) for name in self._names] if signed else None
        self._trusted = public_keys(self._names) if signed else None
        self._seq = 0
        self.tamper: Callable[[int, Estimate], Estimate] = lambda i, estimate: estimate  # what robot i says instead
        self.sides: tuple[frozenset[int], ...] = ()  # nothing passes from one to another
        self.graph = graph
        self.now_ns = self._iteration_ns
        self.robots: list[Estimator] = [self._fresh(i) for i in range(len(graph))]
        self._boxes = [self._mailbox(i) for i in range(len(graph))]

    def iterate(self, priors: Sequence[Prior | None]) -> list[Update]:
        """One iteration with what each robot measured in it. Afterwards all speak to their neighbours."""
        updates = self.tick(priors)
        for _ in range(self._says):
            self.speak()
        return updates

    def tick(self, priors: Sequence[Prior | None]) -> list[Update]:
        """What each robot measured, and its conclusion."""
        updates = []
        for robot, box, prior in zip(self.robots, self._boxes, priors, strict=True):
            robot.adopt(box.swarm_t(self.now_ns, self._validity_ns))
            updates.append(robot.tick(prior, box, self.now_ns))
        return updates

    def restart(self, i: int) -> None:
        """Robot i forgets everything and comes back as a new incarnation."""
        self._starts_ns[i] = self.now_ns
        self.robots[i], self._boxes[i] = self._fresh(i), self._mailbox(i)

    def distrust(self, i: int) -> None:
        """The key of robot i is taken away, everywhere."""
        assert self._trusted is not None
        del self._trusted[self._names[i]]
        for robot in self.robots:
            robot.trust(self._trusted)

    def speak(self) -> None:
        """All speak once to their neighbours; then time goes on to when the next one is due."""
        now_ns = self.now_ns
        self._seq += 1
        letters = []
        for i, near in enumerate(self.graph):
            for j in near:
                word = self.robots[i].say(self._names[j], now_ns)
                if self._random.random() < self._loss or any((i in side) != (j in side) for side in self.sides):
                    continue
                estimate = Estimate(
                    fleet=self._fleet.fleet,
                    src=self._names[i],
                    dst=self._names[j],
                    incarnation=self._starts_ns[i],
                    seq=self._seq,
                    sent_ns=now_ns,
                    target=TARGET,
                    t=self.robots[i].t,
                    valid=self.robots[i].valid,
                    **word._asdict(),
                )
                said = self.tamper(i, estimate)
                letters.append((j, said if self._signs is None else self._signs[i](said)))
        for j, estimate in letters:
            self.robots[j].hear(self._boxes[j].put(estimate.src, estimate, now_ns))
        self.now_ns += self._iteration_ns // self._says

    def _fresh(self, i: int) -> Estimator:
        robot = estimator(self._fleet, self._names[i], TARGET, self._starts_ns[i], verify)
        if self._trusted is not None:
            robot.trust(self._trusted)
        return robot

    def _mailbox(self, i: int) -> Mailbox:
        name = self._names[i]
        return Mailbox(self._fleet.fleet, name, TARGET, self._fleet.robot[name].neighbours)


def fleet(protocol: Protocol, graph: Graph, iteration_s: float, liars: int = 1, clip: bool = False) -> Fleet:
    """The fleet file that robots with this graph would have; their devices are never opened."""
    names = [f"r{i}" for i in range(len(graph))]
    return Fleet(
        fleet="lockstep",
        tank=Tank(),
        target={TARGET: Target(radius_m=0.07)},
        estimation=Estimation(
            protocol=protocol, iteration_s=iteration_s, validity_s=VALIDITY * iteration_s, liars=liars, clip=clip
        ),
        robot={
            name: Robot(
                neighbours=tuple(names[j] for j in near),
                listen="",
                serial="",
                camera="",
                pose=Pose(x_m=0.0, y_m=0.0, yaw_deg=0.0),
                calibration="",
            )
            for name, near in zip(names, graph, strict=True)
        },
    )


def prior(x_m: Array, random_m2: Symmetric, systematic_m2: Symmetric, now_ns: int) -> Prior:
    """A sample as the kernel takes it."""
    x, y, z = x_m.tolist()
    return Prior((x, y, z), random_m2, now_ns, systematic_m2)


def symmetric(covariances_m2: Array) -> list[Symmetric]:
    """(N, 3, 3) -> what each robot's priors carry."""
    return [upper(matrix) for matrix in covariances_m2]
