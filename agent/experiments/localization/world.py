"""Robots around a target and what their cameras get wrong: the worlds of the localization experiment.

Lengths are metres, world frame. Two kinds of error: `random` is new in every sample and averages out, `systematic` is
drawn once per robot (survey, gimbal zero, focus scale) and does not.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Noise = Literal["iso", "aniso"]
Views = Literal["all", "paper", "relay"]

# The paper's tank: cameras 10 cm above the floor, the centre of a 14 cm ball on it.
TARGET_M = np.array([0.760, 0.560, 0.070])
THREE_M = np.array([[0.300, 0.250, 0.100], [1.250, 0.300, 0.100], [0.700, 1.050, 0.100]])
CAMERA_Z_M = 0.100
RANGE_M = (0.3, 0.9)  # of the robots when there are more than three

ISO_M = 0.005  # per axis
# A camera whose peak is found to 0.7 um of lens travel: the error along the ray grows with the range squared.
ALONG_PER_M = 0.0449  # sigma = this * (range - 15 mm)^2
ALONG_FROM_M = 0.015
LATERAL_RAD = math.radians(0.3)
PLACE_M = 0.002  # per axis
# What does not average out.
SCALE_ERROR = 0.01  # of the range, along the ray
ZERO_RAD = math.radians(0.3)
SURVEY_M = 0.001  # per axis

FIRST_VIEW = (0, 16, 28)  # iterations at which the paper's three robots find the target
OBSERVERS = (0, 4, 9)  # of ten, when the others only relay

CIRCLE_RADIUS_M = 0.3  # on which a moving target swims


class MonteCarloWorld(NamedTuple):
    """Where robots are and how well they see; covariances (N, 3, 3) in m^2."""

    camera_m: Array  # (N, 3)
    random_m2: Array
    systematic_m2: Array  # zero when the experiment has none


class Dive(NamedTuple):
    """What each camera would measure at each iteration of one dive."""

    sample_m: Array  # (T, N, 3)
    sees: NDArray[np.bool_]  # (T, N): whether it does


def draw_world(robots: int, noise: Noise, systematic: bool, rng: np.random.Generator) -> MonteCarloWorld:
    """The paper's scene for three robots; else ranges uniform in RANGE_M and any azimuth. noise: of each sample."""
    if robots == len(THREE_M):
        camera = THREE_M
    else:
        reach, azimuth = rng.uniform(*RANGE_M, robots), rng.uniform(0.0, 2.0 * math.pi, robots)
        flat = np.sqrt(reach**2 - (CAMERA_Z_M - TARGET_M[2]) ** 2)
        camera = np.column_stack(
            [TARGET_M[0] + flat * np.cos(azimuth), TARGET_M[1] + flat * np.sin(azimuth), np.full(robots, CAMERA_Z_M)]
        )
    ray = TARGET_M - camera
    reach = np.linalg.norm(ray, axis=1)
    along, eye = np.einsum("ni,nj->nij", ray, ray) / reach[:, None, None] ** 2, np.eye(3)

    def spread(along_m: Array, lateral_m: Array, each_m: float) -> Array:
        a2, l2 = along_m[:, None, None] ** 2, lateral_m[:, None, None] ** 2
        return np.asarray(a2 * along + l2 * (eye - along) + each_m**2 * eye)

    iso = np.tile(ISO_M**2 * eye, (robots, 1, 1))
    aniso = spread(ALONG_PER_M * (reach - ALONG_FROM_M) ** 2, LATERAL_RAD * reach, PLACE_M)
    fixed = spread(SCALE_ERROR * reach, ZERO_RAD * reach, SURVEY_M)
    return MonteCarloWorld(camera, iso if noise == "iso" else aniso, fixed if systematic else 0.0 * fixed)


def draw_dive(
    world: MonteCarloWorld,
    views: Views,
    outlier_m: float,
    iterations: int,
    rng: np.random.Generator,
    path_m: Array | None = None,
) -> Dive:
    """The samples of a whole dive. Robot 0 is wrong by a horizontal `outlier_m` that its covariance knows nothing of.

    path_m: (T, 3) of a target that moves; TARGET_M throughout without it.
    """
    robots = len(world.camera_m)
    truth = np.broadcast_to(TARGET_M, (iterations, 3)) if path_m is None else path_m
    random = np.einsum(
        "nij,tnj->tni", np.linalg.cholesky(world.random_m2), rng.standard_normal((iterations, robots, 3))
    )
    offset = np.einsum("nij,nj->ni", _root(world.systematic_m2), rng.standard_normal((robots, 3)))
    direction = rng.uniform(0.0, 2.0 * math.pi)
    offset[0] += outlier_m * np.array([math.cos(direction), math.sin(direction), 0.0])
    return Dive(truth[:, None] + random + offset, seen(views, robots, iterations))


def seen(views: Views, robots: int, iterations: int) -> NDArray[np.bool_]:
    """Who has the target in view when, (T, N). `paper`: from 0, 16 and 28. `relay`: robots 0, 4 and 9 alone."""
    if views == "paper":
        return np.arange(iterations)[:, None] >= np.array(FIRST_VIEW)[:robots]
    if views == "relay":
        return np.broadcast_to(np.isin(np.arange(robots), OBSERVERS), (iterations, robots))
    return np.ones((iterations, robots), dtype=bool)


def circle_m(speed_m_s: float, t_s: Array) -> Array:
    """Places of a target on a circle around TARGET_M at these times, (T,) -> (T, 3)."""
    angle = speed_m_s / CIRCLE_RADIUS_M * t_s
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(t_s))])
    return np.asarray(TARGET_M + CIRCLE_RADIUS_M * circle)


def _root(covariance: Array) -> Array:
    """A square root that also takes zero matrices."""
    value, vector = np.linalg.eigh(covariance)
    return np.asarray(vector * np.sqrt(np.maximum(value, 0.0))[:, None, :])
