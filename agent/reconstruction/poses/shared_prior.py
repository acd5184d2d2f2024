"""What is known of poses and of focus depths before pictures are compared: errors that a robot's views share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.reconstruction.camera import Floats
from agent.reconstruction.poses.corners import Corners
from agent.reconstruction.poses.twist import carried
from agent.reconstruction.view import View

VIEW_SIGMA = (np.radians(0.1), 1e-3)  # rad and m: what a view's pose has of its own, beside its robot
FOCUS_SHARED = 4e-3  # of z: what a lens' calibration makes all its depths wrong by together
LEAST_SIGMA = 1e-6  # rad and m: of a pose that claims to be known


def robots_of(views: Sequence[View]) -> list[list[int]]:
    """Which views are one robot's, between two of its starts."""
    names = sorted({(view.robot, view.incarnation) for view in views})
    return [[n for n, view in enumerate(views) if (view.robot, view.incarnation) == name] for name in names]


def information_of(views: Sequence[View]) -> Floats:
    """(6 n, 6 n) of (w, t) of all views: a robot's motion, which its views' covariances say as one, and VIEW_SIGMA."""
    total = np.zeros((6 * len(views), 6 * len(views)))
    own = np.diag([VIEW_SIGMA[0] ** 2] * 3 + [VIEW_SIGMA[1] ** 2] * 3)
    for group in robots_of(views):
        mine = [views[n] for n in group]
        centre = np.mean([view.position_m for view in mine], axis=0)
        carries = np.concatenate([carried(view, centre) for view in mine])
        covariance = carries @ np.linalg.inv(shared(mine, centre)) @ carries.T + np.kron(np.eye(len(mine)), own)
        at = (6 * np.array(group)[:, None] + np.arange(6)).ravel()
        total[np.ix_(at, at)] = np.linalg.inv(covariance)
    return total


def shared(views: Sequence[View], centre_m: Floats) -> Floats:
    """Information (6, 6) of a robot's motion about a centre: the mean of what its views say."""
    total = np.zeros((6, 6))
    for view in views:
        carry = carried(view, centre_m)
        total += carry.T @ np.linalg.inv(view.pose_covariance + LEAST_SIGMA**2 * np.eye(6)) @ carry
    return total / len(views)


def certainty_of(views: Sequence[View], corners: Corners) -> Floats:
    """(c,) information of corners' 1/z: so little that all of a robot's together know FOCUS_SHARED at best."""
    relative = (corners.depth_m / corners.sigma_m) ** 2
    for group in robots_of(views):
        mine = np.isin(corners.owner, group)
        relative[mine] /= max(1.0, float(relative[mine].sum()) * FOCUS_SHARED**2)
    return np.asarray(relative * corners.depth_m**2)
