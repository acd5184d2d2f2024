"""Depths of pictures that come with poses alone: a plane sweep over the whole range, then a finer one around it.

Such scenes have any unit, so they are brought to the size of a tank first: what cameras look at is then
DISTANCE_M away, and lengths in this house's modules mean what they say. `unit` brings them back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agent.process.command import Failed, Progress
from agent.reconstruction.camera import Floats
from agent.reconstruction.extract import Mesh
from agent.reconstruction.stack import stacked
from agent.reconstruction.stereo.neighbours import neighbours
from agent.reconstruction.stereo.plane_sweep import Range, plane_sweep
from agent.reconstruction.view import View

DISTANCE_M = 0.7
NEAR, FAR = 0.25, 5.0  # shares of that, between which things are looked for
STEPS = 2.0  # of the wide sweep, as sigma: what its depths are good for


def scale_of(views: Sequence[View]) -> float:
    """By what to multiply lengths. Raises Failed where cameras look at nothing together."""
    centre = looked_at(views)
    distances = [float((centre - view.position_m) @ view.rotation[:, 2]) for view in views]
    typical = float(np.median(distances))
    if not typical > 0.0:
        raise Failed("the cameras do not look at one scene: what is nearest to all their axes is behind them")
    return DISTANCE_M / typical


def looked_at(views: Sequence[View]) -> Floats:
    """The place (3,) that is nearest to the optical axes of all views, least squares."""
    normal, right = 1e-9 * np.eye(3), np.zeros(3)
    for view in views:
        axis = view.rotation[:, 2]
        across = np.eye(3) - np.outer(axis, axis)
        normal += across
        right += across @ view.position_m
    return np.asarray(np.linalg.solve(normal, right))


def scaled(views: Sequence[View], by: float) -> list[View]:
    """All lengths multiplied."""
    return [
        replace(
            view,
            camera=view.camera._replace(ahead_m=view.camera.ahead_m * by),
            position_m=view.position_m * by,
            depth_m=(view.depth_m * by).astype(np.float32),
            sigma_m=(view.sigma_m * by).astype(np.float32),
        )
        for view in views
    ]


def scaled_mesh(mesh: Mesh, by: float) -> Mesh:
    return mesh._replace(vertices_m=mesh.vertices_m * by, sigma_m=(mesh.sigma_m * by).astype(np.float32))


def with_depths(views: Sequence[View], progress: Progress) -> list[View]:
    """Views of a scene of this house's size, with depths where two neighbours have the same."""
    everywhere = Range(NEAR * DISTANCE_M, FAR * DISTANCE_M)
    guess = [replace(view, depth_m=np.full_like(view.depth_m, DISTANCE_M)) for view in views]
    near_by = neighbours(stacked(guess))
    found = plane_sweep(stacked(views), near_by, progress, everywhere)
    step = (1.0 / everywhere.near_m - 1.0 / everywhere.far_m) / everywhere.hypotheses
    result = []
    for n, view in enumerate(views):
        depth = found.depth_m[n, : view.camera.height, : view.camera.width]
        result.append(replace(view, depth_m=depth, sigma_m=(STEPS * step * depth**2).astype(np.float32)))
    return result
