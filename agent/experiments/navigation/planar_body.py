"""A robot in the plane, in steps of 5 ms: the kernel's own form of the equations, with constants of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.capabilities.swim.pose_filter import Hull

Array = NDArray[np.float64]

STEP_S = 0.005
RING_M = 0.17  # from the centre to the outside of the thruster ring
WITHIN = {"drag": 2.0, "turn": 2.0, "mass": 1.15}  # a drawn body's constants are these times larger or smaller at most


@dataclass
class PlanarBody:
    """A body; its constants are its own, and the kernel need not know them."""

    at: Array  # x, y (m), psi (rad)
    hull: Hull
    speed: Array  # in the world: m/s, m/s, rad/s
    force: Array  # acting, body frame: N ahead, N left, N m

    @classmethod
    def resting(cls, at: ArrayLike, hull: Hull | None = None) -> PlanarBody:
        return cls(np.array(at, float), hull or Hull(), np.zeros(3), np.zeros(3))

    def swim(self, asked_for: ArrayLike, seconds: float, pull: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Move on. asked_for: N, N, N m in the body's frame; pull: from outside, N, N, N m in the world."""
        hull = self.hull
        for _ in range(round(seconds / STEP_S)):
            self.force += (np.asarray(asked_for) - self.force) * (STEP_S / hull.lag_s)
            c, s = np.cos(self.at[2]), np.sin(self.at[2])
            ahead, left, moment = self.force
            push = np.array([c * ahead - s * left, s * ahead + c * left, moment])
            v = np.hypot(self.speed[0], self.speed[1])
            linear = hull.drag + hull.drag2 * v
            drag = [linear, linear, hull.turn_drag + hull.turn_drag2 * abs(self.speed[2])]
            inertia = [hull.mass_kg, hull.mass_kg, hull.inertia_kgm2]
            self.speed += STEP_S * (push + pull - drag * self.speed) / inertia
            self.at += STEP_S * self.speed

    def stay_in(self, length_m: float, breadth_m: float) -> None:
        """A wall of the tank stops the thruster ring that has come to it."""
        for k, side_m in enumerate((length_m, breadth_m)):
            if not RING_M <= self.at[k] <= side_m - RING_M:
                self.at[k] = np.clip(self.at[k], RING_M, side_m - RING_M)
                self.speed[k] = 0.0


def drawn_hull(rng: np.random.Generator) -> Hull:
    """A body that differs from what the kernel believes by as much as the twin's do."""
    usual = Hull()
    about = {name: factor ** rng.uniform(-1.0, 1.0, 2) for name, factor in WITHIN.items()}
    return Hull(
        mass_kg=usual.mass_kg * about["mass"][0],
        drag=usual.drag * about["drag"][0],
        drag2=usual.drag2 * about["drag"][1],
        inertia_kgm2=usual.inertia_kgm2 * about["mass"][1],
        turn_drag=usual.turn_drag * about["turn"][0],
        turn_drag2=usual.turn_drag2 * about["turn"][1],
        lag_s=usual.lag_s,
    )
