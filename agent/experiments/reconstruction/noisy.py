"""Poses as wrong as a survey leaves them: an error that all views of a robot share, and a small one of each view."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agent.reconstruction.pose_evidence import moved_about
from agent.reconstruction.views import Floats, View, diagonal_prior, moved
from hw.twin.scene import generator

SHARED = (3e-3, math.radians(0.5))  # of a robot: m and rad, standard deviations along and about each axis
OWN = (0.7e-3, math.radians(0.08))  # of a view besides


def noisy(views: Sequence[View], seed: int) -> list[View]:
    """The same views as their robots would believe them to be; a robot turns about the middle of its views."""
    found = []
    for robot in sorted({view.robot for view in views}):
        rng = generator(seed, "reconstruction", "poses", robot)
        turn, shift = rng.normal(0.0, SHARED[1], 3), rng.normal(0.0, SHARED[0], 3)
        middle = np.mean([view.position_m for view in views if view.robot == robot], axis=0)
        found += [_off(view, turn, shift, middle, rng) for view in views if view.robot == robot]
    order = {view.key: n for n, view in enumerate(views)}
    return sorted(found, key=lambda view: order[view.key])


def _off(view: View, turn: Floats, shift: Floats, middle: Floats, rng: np.random.Generator) -> View:
    there = moved_about(view, middle, turn, shift)
    w, t = rng.normal(0.0, OWN[1], 3), rng.normal(0.0, OWN[0], 3)
    both = math.hypot(SHARED[1], OWN[1]), math.hypot(SHARED[0], OWN[0])
    return replace(moved(there, w, t), pose_covariance=diagonal_prior(*both))
