"""Poses of all views from their pictures together: corners of each found in the others, then everything moved to fit.

Pictures are compared with pictures, not with a scene that was built from them: such a scene holds each view's own
error, and draws the view back to where it was. First corners are looked for as far away as poses may be wrong, then,
once they fit, close by. The common motion of everything stays what priors make of it (twist.between); its scale is what
places and focus depths say of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from agent.process.command import Progress
from agent.reconstruction.camera import Floats
from agent.reconstruction.poses.bundle import Loss, Prior, first_state, normal_of, step
from agent.reconstruction.poses.corners import Corners, corners
from agent.reconstruction.poses.matches import matched
from agent.reconstruction.poses.shared_prior import certainty_of, information_of
from agent.reconstruction.stack import Stack, stacked
from agent.reconstruction.view import View

REACH_SIGMAS, LEAST_REACH_PX, MOST_REACH_PX = 3.5, 8.0, 40.0
LEAST_SIGMA_PX = 0.5  # what one match is worth at best
TOGETHER = 6.0  # times the median of how far matches are off: those of a picture are wrong together, as its camera is
# Cauchy's scales in pixels, a step each: what is found far away may be wrong, but poses are, too.
SCALES_PX = ((8.0,) * 4 + (4.0,) * 3 + (2.0,) * 3 + (1.0,) * 3, (3.0,) * 3 + (1.0,) * 5)


class Refined(NamedTuple):
    views: list[View]
    matches: int  # corners found in other pictures, in the last round
    off_px: tuple[float, float]  # median of how far they are from where poses put them, before and after


def refine(views: Sequence[View], progress: Progress = lambda done, total: None) -> Refined:
    """Views in the same order, where they fit each other. progress counts views, once a round.

    Raises Failed where there is no view.
    """
    stack = stacked(views)
    found, robots = corners(stack), [(view.robot, view.incarnation) for view in views]
    prior = Prior(information_of(views), 1.0 / found.depth_m, certainty_of(views, found))
    state = start = first_state(stack, found, prior)
    total = len(SCALES_PX) * len(views)
    reach_px, sigma_px = _reach_px(views, stack, found), LEAST_SIGMA_PX
    for n, scales in enumerate(SCALES_PX):
        now = stack._replace(rotations=state.rotations, positions_m=state.positions_m)
        there = found._replace(depth_m=1.0 / state.inverse)
        seen = matched(now, there, robots, reach_px, partial(_part, progress, n * len(views), total))
        for scale in scales:
            state, off_px = step(stack, found, seen, prior, state, Loss(scale, sigma_px))
        reach_px, sigma_px = LEAST_REACH_PX, max(LEAST_SIGMA_PX, TOGETHER * _median(off_px))
    placed = [
        replace(view, rotation=rotation, position_m=position)
        for view, rotation, position in zip(views, state.rotations, state.positions_m, strict=True)
    ]
    last = Loss(1.0, sigma_px)
    before, after = (_median(normal_of(stack, found, seen, prior, one, last)[0].off_px) for one in (start, state))
    return Refined(placed, len(seen.other), (before, after))


def _part(progress: Progress, before: int, total: int, done: int, _: int) -> None:
    progress(before + done, total)


def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _reach_px(views: Sequence[View], stack: Stack, found: Corners) -> float:
    """How far from where it should be a corner may be in another picture, by what poses are said to be wrong by."""
    variance = np.array([np.diag(view.pose_covariance) for view in views]).reshape(-1, 2, 3).mean(axis=(0, 2))
    z = float(np.median(found.depth_m)) if len(found.depth_m) else 1.0
    sigma_px = float(stack.cameras[:, 0].max()) * np.sqrt(2.0 * (variance[0] + variance[1] / z**2))
    return float(np.clip(REACH_SIGMAS * sigma_px, LEAST_REACH_PX, MOST_REACH_PX))
