"""One view moved to where it fits a scene that stands still: Gauss and Newton's steps on tones and depths."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.poses.evidence import evidence
from agent.reconstruction.view import View, moved

Floats = NDArray[np.float64]

Look = Callable[[View], tuple[Floats, Floats]]  # linear light (h, w, 3) and depth (h, w) from a view; NaN in holes

CLIP = (10e-3, 8e-3)  # rad and m of one step
ROUNDS = 8


class Placed(NamedTuple):
    view: View
    costs: tuple[float, ...]  # before each round, and at the end


def place(view: View, look: Look, prior: Floats | None = None, rounds: int = ROUNDS) -> Placed:
    """The view where its picture fits; prior: information (6, 6) of its motion."""
    information = np.zeros((6, 6)) if prior is None else prior
    gone, costs, now = np.zeros(6), [], view
    for _ in range(rounds):
        found = evidence(now, *look(now))
        costs.append(found.cost)
        hessian = found.hessian + information + 1e-9 * np.eye(6)
        pull = found.pull - information @ gone
        xi = clipped(np.asarray(np.linalg.solve(hessian, pull), float), CLIP)
        gone, now = gone + xi, moved(now, xi[:3], xi[3:])
    costs.append(evidence(now, *look(now)).cost)
    return Placed(now, tuple(costs))


def clipped(xi: Floats, clip: tuple[float, float]) -> Floats:
    """A step (6,), shortened as a whole until it turns by clip[0] rad at most, and goes no farther than clip[1] m."""
    over = max(float(np.linalg.norm(xi[:3])) / clip[0], float(np.linalg.norm(xi[3:])) / clip[1], 1.0)
    return np.asarray(xi / over)
