"""What is known of poses and of focus depths before pictures are compared: errors that a robot's views share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.reconstruction.camera import Floats
from agent.reconstruction.poses.blocks import Sparse, matrix
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


def information_of(views: Sequence[View]) -> Sparse:
    """(6 (n + r), 6 (n + r)) of (w, t) of n views, and after them of their r robots.

    A robot's is what its views' covariances say as one; between that, carried over, and a view's own is VIEW_SIGMA.
    Views have to do with each other by their robot alone, so nearly all of it is empty.
    """
    own, groups = np.diag(np.repeat(np.array(VIEW_SIGMA) ** -2, 3)), robots_of(views)
    found = list[tuple[int, int, Floats]]()
    for robot, group in enumerate(groups, len(views)):
        mine = [views[n] for n in group]
        centre = np.mean([view.position_m for view in mine], axis=0)
        found.append((robot, robot, shared(mine, centre)))
        for n, view in zip(group, mine, strict=True):
            carry = carried(view, centre)
            between = -own @ carry
            found += [(n, n, own), (n, robot, between), (robot, n, between.T), (robot, robot, carry.T @ own @ carry)]
    return matrix(len(views) + len(groups), *zip(*found, strict=True))


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
