"""Robots in the plane, with the kernel's filter and pilot and with fixes that are drawn."""

from dataclasses import dataclass

import numpy as np

from agent.capabilities.swim.behaviour import wanted_velocity, wrench
from agent.capabilities.swim.event_ring import EventRing, asked, fix
from agent.capabilities.swim.pose_filter import Drift, Hull, begin
from agent.experiments.navigation.basin import PlanarBody

Swimmer = PlanarBody
CYCLE_NS = 50_000_000
NOTHING = (0.0,) * 6


@dataclass
class Fixes:
    """How a robot is told where it is."""

    period_ns: int = 200_000_000
    delay_ns: int = 100_000_000
    sigma: tuple = (0.003, 0.003, 0.0035)
    blind: tuple = (0, 0)  # of every so many ns none for the last so many

    @property
    def covariance(self):
        a, b, c = (s * s for s in self.sigma)
        return a, 0.0, 0.0, b, 0.0, c


class Piloted:
    """A swimmer with the kernel's filter and pilot."""

    def __init__(self, swimmer, rng=None, fixes=None, believed=None, drift=None) -> None:
        self.swimmer, self.rng, self.fixes, self.hull = swimmer, rng, fixes or Fixes(), believed or Hull()
        pose = tuple(map(float, swimmer.at))
        self.ring = EventRing(begin(-1, pose, self.fixes.covariance), self.hull, drift or Drift())
        self.now_ns, self.pending = 0, []

    def cycle(self, reference, barrier=lambda belief, wanted: wanted, pull=(0.0, 0.0, 0.0)):
        """One step of the agent: 50 ms. reference: of the time and of the belief."""
        self.ring.advance(self.now_ns)
        while self.pending and self.pending[0][0] <= self.now_ns:
            self.ring.add(self.pending.pop(0)[1])
        belief = self.ring.at(self.now_ns)
        to = reference(self.now_ns * 1e-9, belief)
        u = wrench(belief, self.hull, to, barrier(belief, wanted_velocity(belief, to)))
        self.ring.add(asked(self.now_ns, u))
        self.swimmer.swim(u, CYCLE_NS * 1e-9, pull)
        self.now_ns += CYCLE_NS
        every, blind = self.fixes.blind
        seen = not every or self.now_ns % every < every - blind
        if self.now_ns % self.fixes.period_ns == 0 and seen:
            noise = self.rng.normal(0.0, self.fixes.sigma) if self.rng is not None else np.zeros(3)
            pose = tuple(map(float, self.swimmer.at + noise))
            event = fix(self.now_ns, pose, self.fixes.covariance, NOTHING)
            self.pending.append((self.now_ns + self.fixes.delay_ns, event))
        return belief, to
