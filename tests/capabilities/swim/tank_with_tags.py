"""A tank with tags on walls and floor, and a robot that sees some of them: projected by scipy's rotations."""

import numpy as np
from scipy.spatial.transform import Rotation

from agent.capabilities.swim.landmarks import markers
from agent.capabilities.swim.projection import View
from agent.capabilities.swim.tag_fix import Map, Prior, Priors
from agent.core.config import Landmarks
from agent.core.step_io import SeenTag
from agent.experiments.navigation.basin import TAG_M, TANK, tags

TANK_M = TANK.size_m
VIEW = View(f_px=930.0, width_px=640, ahead_m=0.012, arm_m=(0.10, 0.01, -0.02), surface_m=TANK.surface_m)
HALF = (0.344, 0.258)  # slopes at the picture's edges
EDGE_SIGMA_PX, OFFSET_PX, BENT_PX, STRETCH = 0.08, 0.04, 0.15, 0.0012
DEPTH_M, LEVEL_DEG, GIMBAL_DEG = 0.0007, 0.1, 0.02
SIGMA_M, SIGMA_DEG = 0.0005, 0.1


def grid():
    """Tags of 8 cm every 25 cm, on all faces."""
    landmarks = Landmarks(size_m=TAG_M, sigma_m=SIGMA_M, sigma_deg=SIGMA_DEG, tag=tags())
    return Map(landmarks, markers(landmarks))


MAP = grid()
CORNERS_M = np.array([marker.corners_m for marker in MAP.markers.values()]).reshape(-1, 3)


def project(theta, points):
    """Slopes (n, 2) and depths (n,) of points (n, 3)."""
    x, y, psi, depth, roll, pitch, pan, tilt = theta
    body = Rotation.from_euler("ZYX", [psi, pitch, roll])
    pivot = np.array([x, y, VIEW.surface_m - depth]) + body.apply(VIEW.arm_m)
    gimbal = body * Rotation.from_euler("ZY", [pan, -tilt])
    ahead, left, up = gimbal.inv().apply(np.asarray(points) - pivot).T
    depths = ahead - VIEW.ahead_m
    return np.stack([-left, -up], axis=1) / depths[:, None], depths


def priors(theta, rng=None, level_deg=LEVEL_DEG):
    """What is known beforehand, drawn about the truth."""
    sigmas = (DEPTH_M, *np.radians([level_deg, level_deg, GIMBAL_DEG, GIMBAL_DEG]))
    errors = np.zeros(5) if rng is None else rng.standard_normal(5) * sigmas
    return Priors(*(Prior(float(v + e), float(s)) for v, e, s in zip(theta[3:], errors, sigmas, strict=True)))


def sight(theta, rng=None, most=5):
    """The largest tags that a camera at theta sees wholly; rng: with survey and corners as wrong as may be."""
    slopes, depths = project(theta, CORNERS_M)
    slopes, depths = slopes.reshape(-1, 4, 2), depths.reshape(-1, 4)
    sides = np.roll(slopes, -1, axis=1) - slopes
    size_px = VIEW.f_px * np.hypot(sides[..., 0], sides[..., 1]).min(axis=1)
    facing = sides[:, 0, 0] * sides[:, 1, 1] > sides[:, 0, 1] * sides[:, 1, 0]
    inside = np.all((depths > 0.15) & (depths < 1.5) & (np.abs(slopes) < HALF).all(axis=2), axis=1)
    chosen = np.flatnonzero(inside & facing & (size_px >= 20.0))
    chosen = chosen[np.argsort(-size_px[chosen], kind="stable")][:most]
    true, n = slopes[chosen], len(chosen)
    rho_px = VIEW.f_px * np.hypot(*true.mean(axis=1).T)
    if rng is not None and n:
        middles = CORNERS_M.reshape(-1, 4, 3)[chosen].mean(axis=1, keepdims=True)
        arms = CORNERS_M.reshape(-1, 4, 3)[chosen] - middles
        turned = arms + np.cross(np.radians(rng.normal(0.0, SIGMA_DEG, (n, 1, 3))), arms)
        there = middles + rng.normal(0.0, SIGMA_M, (n, 1, 3)) + turned
        true = project(theta, there.reshape(-1, 3))[0].reshape(-1, 4, 2)
        offset_px = OFFSET_PX + BENT_PX * (rho_px / (0.55 * VIEW.width_px)) ** 3
        noise_px = rng.normal(0.0, EDGE_SIGMA_PX, (n, 4, 2)) + rng.normal(size=(n, 1, 2)) * offset_px[:, None, None]
        about = true - true.mean(axis=1, keepdims=True)
        true = true + about * rng.normal(0.0, STRETCH, (n, 1, 1)) + noise_px / VIEW.f_px
    ids = list(MAP.markers)
    return [
        SeenTag(ids[k], tuple(map(tuple, corners.tolist())), float(size_px[k]), float(rho), True)
        for k, corners, rho in zip(chosen, true, rho_px, strict=True)
    ]


def somewhere(rng):
    """A theta in the tank from which anything may be seen."""
    x, y = rng.uniform([0.6, 0.6], [TANK_M[0] - 0.6, TANK_M[1] - 0.6])
    psi, pan = rng.uniform(-np.pi, np.pi), rng.uniform(-0.8, 0.8)
    roll, pitch = rng.normal(0.0, 0.02, 2)
    return tuple(map(float, (x, y, psi, rng.uniform(0.2, 0.4), roll, pitch, pan, rng.uniform(-0.6, 0.1))))
