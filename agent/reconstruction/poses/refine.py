"""Poses of all views from their pictures and depths together: robots first, then each view by itself.

A round builds surface and colours from where cameras are believed to be, and moves each robot, with all of its views,
to where its pictures fit better what all robots saw; priors hold what pictures cannot tell. Early rounds look at
blurred pictures, which a few pixels cannot lead astray. The common motion of everything stays what the priors make of
it: see twist.between.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.poses.evidence import Normal, evidence
from agent.reconstruction.poses.twist import carried, moved_about
from agent.reconstruction.view import View, moved

Floats = NDArray[np.float64]

Look = Callable[[View], tuple[Floats, Floats]]  # linear light (h, w, 3) and depth (h, w) from a view; NaN in holes
Build = Callable[[Sequence[View]], Look]  # what the scene looks like, made of views as they stand

BLURS_PX = (2.0, 1.5, 1.0, 0.7, 0.0, 0.0, 0.0, 0.0)  # of the rounds of robots; the sharp ones gain a point of F each
STEPS = 2  # of Gauss-Newton in a round
ROBOT_CLIP = (8e-3, 6e-3)  # rad and m of one step
VIEW_SIGMA = (np.radians(0.1), 1e-3)  # rad and m: what a view has of its own, beside its robot
VIEW_CLIP = (10e-3, 8e-3)
PLACE_ROUNDS = 8  # of placing one view in a scene that stands
LEAST_SIGMA = 1e-6  # rad and m: of a prior that claims to know everything


class Refined(NamedTuple):
    views: list[View]
    costs: tuple[float, ...]  # of pictures and depths before each round, and at the end


def refine(views: Sequence[View], build: Build, done: Callable[[int, int], None] = lambda done, total: None) -> Refined:
    """Views in the same order, where they fit each other. done(rounds, in all) is called after each.

    A robot's prior is what its views' covariances say, taken as one: they share what is wrong. Its last round gives
    each view a motion of its own, of VIEW_SIGMA.
    """
    now, total = list(views), len(BLURS_PX) + 1
    robots = sorted({(view.robot, view.incarnation) for view in views})
    groups = [[n for n, view in enumerate(views) if (view.robot, view.incarnation) == robot] for robot in robots]
    centres = [np.mean([views[n].position_m for n in group], axis=0) for group in groups]
    priors = [_prior([views[n] for n in group], centre) for group, centre in zip(groups, centres, strict=True)]
    gone = [np.zeros(6) for _ in groups]
    costs = []
    for n, blur_px in enumerate(BLURS_PX):
        look = build(now)
        for step in range(STEPS):
            cost = 0.0
            for g, (group, centre) in enumerate(zip(groups, centres, strict=True)):
                found = [_of_robot(now[k], look, blur_px, centre) for k in group]
                cost += sum(one.cost for one in found)
                hessian = sum((one.hessian for one in found), priors[g].copy())
                pull = sum((one.pull for one in found), -priors[g] @ gone[g])
                xi = clipped(np.asarray(np.linalg.solve(hessian, pull), float), ROBOT_CLIP)
                gone[g] = gone[g] + xi
                for k in group:
                    now[k] = moved_about(now[k], centre, xi[:3], xi[3:])
            if step == 0:
                costs.append(cost)
        done(n + 1, total)
    look, own = build(now), _diagonal(VIEW_SIGMA)
    placed = [place(view, look, own, STEPS) for view in now]
    costs.append(sum(one.costs[0] for one in placed))
    costs.append(sum(one.costs[-1] for one in placed))
    done(total, total)
    return Refined([one.views[0] for one in placed], tuple(costs))


def place(view: View, look: Look, prior: Floats | None = None, rounds: int = PLACE_ROUNDS) -> Refined:
    """One view moved to where it fits a scene that stands still; prior: information (6, 6) of its own motion."""
    information = np.zeros((6, 6)) if prior is None else prior
    gone, costs, now = np.zeros(6), [], view
    for _ in range(rounds):
        found = evidence(now, *look(now))
        costs.append(found.cost)
        hessian = found.hessian + information + 1e-9 * np.eye(6)
        pull = found.pull - information @ gone
        xi = clipped(np.asarray(np.linalg.solve(hessian, pull), float), VIEW_CLIP)
        gone, now = gone + xi, moved(now, xi[:3], xi[3:])
    costs.append(evidence(now, *look(now)).cost)
    return Refined([now], tuple(costs))


def clipped(xi: Floats, clip: tuple[float, float]) -> Floats:
    """A step (6,), shortened as a whole until it turns by clip[0] rad at most, and goes no farther than clip[1] m."""
    over = max(float(np.linalg.norm(xi[:3])) / clip[0], float(np.linalg.norm(xi[3:])) / clip[1], 1.0)
    return np.asarray(xi / over)


def _of_robot(view: View, look: Look, blur_px: float, centre_m: Floats) -> Normal:
    found, carry = evidence(view, *look(view), blur_px), carried(view, centre_m)
    return Normal(carry.T @ found.hessian @ carry, carry.T @ found.pull, found.cost)


def _prior(views: Sequence[View], centre_m: Floats) -> Floats:
    """Information (6, 6) of a robot's motion: the mean of what its views say."""
    total = np.zeros((6, 6))
    for view in views:
        carry = carried(view, centre_m)
        covariance = view.pose_covariance + LEAST_SIGMA**2 * np.eye(6)
        total += carry.T @ np.linalg.inv(covariance) @ carry
    return total / len(views)


def _diagonal(sigma: tuple[float, float]) -> Floats:
    return np.diag([sigma[0] ** -2] * 3 + [sigma[1] ** -2] * 3)
