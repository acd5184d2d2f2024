"""Which views a view is compared with: those that look at the same places from not too far and not too near."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Floats, project, unproject
from agent.reconstruction.reach import ball, cone, meets
from agent.reconstruction.stack import Stack, camera_at

MOST = 6
ANGLE_DEG, SPREAD_DEG = 14.0, 14.0  # between two sight lines: less has no depth in it, more looks different
LEAST_DEG, LEAST_SCORE = 3.0, 0.02
SAMPLE_PX = 16  # one known pixel of each square of so many stands for it


class Neighbours(NamedTuple):
    """Best first; -1: none any more."""

    of: NDArray[np.int64]  # (n, MOST)


def neighbours(stack: Stack) -> Neighbours:
    """score = share of a view's places that are inside the other's picture x exp(-((angle - 14) / 14)^2)."""
    count = len(stack.cameras)
    of = np.full((count, MOST), -1, np.int64)
    pictures = np.array([cone(camera_at(stack, n), stack.rotations[n], stack.positions_m[n]) for n in range(count)])
    for n in range(count):
        points = _places(stack, n)
        if not len(points):
            continue
        scores = np.zeros(count)
        for other in np.flatnonzero(meets(pictures, *ball(points))).tolist():
            if other != n:
                scores[other] = _score(stack, n, other, points)
        best = np.argsort(-scores, kind="stable")[:MOST]
        best = best[scores[best] > LEAST_SCORE]
        of[n, : len(best)] = best
    return Neighbours(of)


def _places(stack: Stack, n: int) -> Floats:
    """World places (m, 3) of some of its known pixels."""
    step = SAMPLE_PX
    depth = stack.depth_m[n, step // 2 :: step, step // 2 :: step].astype(np.float64)
    rows, cols = np.nonzero(np.isfinite(depth))
    pixels = np.stack([cols, rows], axis=-1).astype(np.float64) * step + step // 2
    points = unproject(camera_at(stack, n), pixels, depth[rows, cols])
    return np.asarray(points @ stack.rotations[n].T + stack.positions_m[n])


def _score(stack: Stack, n: int, other: int, points: Floats) -> float:
    camera, there = camera_at(stack, other), (points - stack.positions_m[other]) @ stack.rotations[other]
    pixels = project(camera, there)
    with np.errstate(invalid="ignore"):
        inside = ((pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5)).all(axis=-1)
    if not inside.any():
        return 0.0
    a, b = (points[inside] - stack.positions_m[k] for k in (n, other))
    cosine = (a * b).sum(axis=-1) / np.maximum(np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1), 1e-12)
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).mean())
    if angle < LEAST_DEG:
        return 0.0
    return float(inside.mean()) * float(np.exp(-(((angle - ANGLE_DEG) / SPREAD_DEG) ** 2)))
