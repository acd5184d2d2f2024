"""Poses as a fleet would have them: each robot wrong as a whole, and each view a little by itself.

The same draws for the same seed; views that are held back are not touched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agent.reconstruction.poses.twist import moved_about
from agent.reconstruction.view import View, diagonal_prior, moved
from hw.twin.scene import generator

ROBOT_SIGMA = (np.radians(0.5), 3e-3)  # rad and m along each axis, about the middle of the robot's places
VIEW_SIGMA = (np.radians(0.08), 0.7e-3)


def noisy(views: Sequence[View], seed: int) -> list[View]:
    """The views where robots believe they were taken, with priors that say how much of that is to be believed."""
    rng, prior = generator(seed, "poses"), diagonal_prior(*ROBOT_SIGMA)
    robots = sorted({view.robot for view in views})
    centres = {robot: np.mean([view.position_m for view in views if view.robot == robot], axis=0) for robot in robots}
    errors = {robot: [rng.normal(0.0, sigma, 3) for sigma in ROBOT_SIGMA] for robot in robots}
    found = []
    for view in views:
        together = moved_about(view, centres[view.robot], *errors[view.robot])
        alone = moved(together, *(rng.normal(0.0, sigma, 3) for sigma in VIEW_SIGMA))
        found.append(replace(alone, pose_covariance=prior))
    return found
