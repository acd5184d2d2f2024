"""One keyframe of a reconstruction: where a camera was, what it saw, and how far away that is.

World = rotation @ p + position, p in the camera frame of camera.py. A small correction of a pose is (w, t): rotation
R <- R exp([w]x), position T <- T + R t; w in rad and t in metres, both along the camera's axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Camera, Floats, pixel_grid, project, unproject


@dataclass(frozen=True, eq=False)
class View:
    """Arrays are not copied; nobody writes into them.

    Views of one (robot, incarnation) share what is wrong with where that robot believes to be.
    """

    robot: str
    incarnation: str
    seq: int  # of the sweep; the three together name a keyframe
    camera: Camera
    rotation: Floats  # (3, 3) camera to world
    position_m: Floats  # (3,) of the gimbal's pivot in the world
    pose_covariance: Floats  # (6, 6) of (w, t), rad and m: all that is not known of the pose
    picture: NDArray[np.float32]  # (height, width, 3) red green blue, linear light, 1 at the sensor's limit
    depth_m: NDArray[np.float32]  # (height, width) along the axis from the pivot; NaN: unknown
    sigma_m: NDArray[np.float32]  # (height, width) standard deviation of that; NaN: unknown

    @property
    def key(self) -> tuple[str, str, int]:
        return self.robot, self.incarnation, self.seq


def diagonal_prior(angle_rad: float, place_m: float) -> Floats:
    """(6, 6) covariance of (w, t) with the same standard deviation along each axis."""
    return np.diag([angle_rad**2] * 3 + [place_m**2] * 3)


def to_world(view: View, points_m: Floats) -> Floats:
    """Points of the camera frame (..., 3) in the world."""
    return points_m @ view.rotation.T + view.position_m


def to_camera(view: View, points_m: Floats) -> Floats:
    """Points of the world (..., 3) in the camera frame."""
    return (points_m - view.position_m) @ view.rotation


def see(view: View, points_m: Floats) -> tuple[Floats, Floats]:
    """Points of the world (..., 3) -> pixels (..., 2), NaN where they are behind the camera, and depths (...)."""
    there = to_camera(view, points_m)
    return project(view.camera, there), there[..., 2]


def surface_points(view: View) -> Floats:
    """Where in the world each pixel's depth is, (height, width, 3); NaN where it is unknown."""
    return to_world(view, unproject(view.camera, pixel_grid(view.camera), view.depth_m.astype(float)))


def moved(view: View, w_rad: Floats, t_m: Floats) -> View:
    """The view with its pose corrected by (w, t), each (3,)."""
    return replace(
        view, rotation=view.rotation @ rotation_of(w_rad), position_m=view.position_m + view.rotation @ np.asarray(t_m)
    )


def rotation_of(w_rad: Floats) -> Floats:
    """exp([w]x), (3, 3): Rodrigues' formula."""
    x, y, z = w_rad
    angle = float(np.sqrt(x * x + y * y + z * z))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)
