"""How well a camera's pose is known: what is unknown of the robot and of its gimbal, as a covariance of (w, t)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agent.reconstruction.camera import Floats

LEVEL_RAD = math.radians(0.3)  # roll and pitch by four pressure sensors 0.2 m apart
DEPTH_M = 1.5e-3  # by the same, with what waves leave


class Sigmas(NamedTuple):
    """Standard deviations of one robot."""

    place_m: float  # in x and in y
    yaw_rad: float
    gimbal_rad: float  # of pan and of tilt


def covariance_of(rotation: Floats, arm_m: Floats, sigmas: Sigmas) -> Floats:
    """(6, 6) of (w, t) along the camera's axes; rotation (3, 3) camera to world, arm (3,) body to camera, world axes.

    A turn of the body moves the camera on its arm; one of the gimbal does not.
    """
    turns = [(np.array([0.0, 0.0, 1.0]), sigmas.yaw_rad, True)]
    turns += [(axis, LEVEL_RAD, True) for axis in np.eye(3)[:2]]
    turns += [(axis, sigmas.gimbal_rad, False) for axis in (np.array([0.0, 0.0, 1.0]), rotation[:, 0])]
    shifts = [(axis, sigma) for axis, sigma in zip(np.eye(3), (sigmas.place_m, sigmas.place_m, DEPTH_M), strict=True)]
    total = np.zeros((6, 6))
    for axis, sigma, with_arm in turns:
        moved = np.cross(axis, arm_m) if with_arm else np.zeros(3)
        column = np.concatenate([rotation.T @ axis, rotation.T @ moved])
        total += sigma**2 * np.outer(column, column)
    for axis, sigma in shifts:
        column = np.concatenate([np.zeros(3), rotation.T @ axis])
        total += sigma**2 * np.outer(column, column)
    return total
