"""A drawn scene, and what the blocks of a sweep truly see of it: a tank with things in it, and no frame is rendered.

Things are ellipsoids and boxes, turned any way, and a wall that stands aslant: what lies along the axes flatters a
grid of cells. It shares no code with the map that is judged by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import BlockPeaks, SweepPlan

Floats = NDArray[np.float64]
FAR_M = 1e9
SLOPE_ROUNDS = 10  # passes that take the bend out of a slope


class Body(NamedTuple):
    """One thing: a unit ball or a unit cube, stretched, turned and moved."""

    round: bool
    centre_m: Floats  # (3,)
    half_m: Floats  # (3,)
    turn: Floats  # (3, 3), world to body


class Scene(NamedTuple):
    size_m: Floats  # (3,) of the water
    bodies: tuple[Body, ...]


class Seen(NamedTuple):
    """What each block of a picture truly sees."""

    z_m: Floats  # (n,) depth along the optical axis from the pivot; inf: the surface
    points_m: Floats  # (n, 3)
    cos: Floats  # (n,) of the incidence


def draw_scene(size_m: tuple[float, float, float], seed: int, things: int = 5) -> Scene:
    """Things on the floor, in the middle half of the tank, and a plate that leans aslant."""
    rng, bodies = np.random.default_rng((seed, 77)), []
    length, breadth, _ = size_m
    for k in range(things):
        half = rng.uniform(0.03, 0.08, 3)
        centre = np.array([length * rng.uniform(0.3, 0.7), breadth * rng.uniform(0.3, 0.7), half[2] * 0.8])
        bodies.append(Body(k % 2 == 0, centre, half, _turned(rng.normal(size=3), rng.uniform(0.0, np.pi))))
    yaw = rng.uniform(0.0, np.pi)
    plate = np.array([0.18, 0.012, 0.10])
    centre = np.array([length * rng.uniform(0.4, 0.6), breadth * rng.uniform(0.4, 0.6), 0.09])
    lean = _turned(np.array([np.cos(yaw), np.sin(yaw), 0.0]), rng.uniform(-0.3, 0.3))
    bodies.append(Body(False, centre, plate, _turned(np.array([0.0, 0.0, 1.0]), -yaw) @ lean.T))
    return Scene(np.array(size_m), tuple(bodies))


def slopes(camera: CameraFit, side_px: int) -> Floats:
    """(n, 2) of the middles of all blocks, row by row."""
    cols, rows = camera.width_px // side_px, camera.height_px // side_px
    u, v = np.meshgrid((np.arange(cols) + 0.5) * side_px - 0.5, (np.arange(rows) + 0.5) * side_px - 0.5)
    seen = np.stack([(u.ravel() - camera.cx_px), (v.ravel() - camera.cy_px)], axis=1) / camera.f_px
    straight = seen.copy()
    for _ in range(SLOPE_ROUNDS):
        straight = seen / (1.0 + camera.bend * (straight**2).sum(axis=1, keepdims=True))
    return straight


def look(scene: Scene, at_m: Floats, rotation: Floats, camera: CameraFit, side_px: int) -> Seen:
    """at_m, rotation: the pivot in the world, and the turn from camera to world."""
    s = slopes(camera, side_px)
    ways = np.column_stack([s, np.ones(len(s))]) @ rotation.T
    start = at_m + rotation @ np.array([0.0, 0.0, camera.ahead_m])
    with np.errstate(divide="ignore", invalid="ignore"):
        out = np.where(ways > 0.0, (scene.size_m - start) / ways, np.where(ways < 0.0, -start / ways, FAR_M))
    face = out.argmin(axis=1)
    t, rows = out[np.arange(len(out)), face], np.arange(len(out))
    normals = np.zeros_like(ways)
    normals[rows, face] = -np.sign(ways[rows, face])
    open_above = (face == 2) & (ways[:, 2] > 0.0)
    for body in scene.bodies:
        hit, normal = _meet(body, start, ways)
        nearer = hit < t
        t, open_above = np.where(nearer, hit, t), open_above & ~nearer
        normals[nearer] = normal[nearer]
    cos = np.abs((ways * normals).sum(axis=1)) / np.linalg.norm(ways, axis=1)
    points = start + t[:, None] * ways
    z = np.where(open_above, np.inf, t + camera.ahead_m)
    return Seen(z, points, cos)


def _meet(body: Body, start: Floats, ways: Floats) -> tuple[Floats, Floats]:
    """How far along each ray it is met, and the surface's normal there."""
    p, d = (body.turn @ (start - body.centre_m)) / body.half_m, (ways @ body.turn.T) / body.half_m
    if body.round:
        dd, dp = (d * d).sum(axis=1), d @ p
        root = dp * dp - dd * (p @ p - 1.0)
        t = np.where(root > 0.0, (-dp - np.sqrt(np.maximum(root, 0.0))) / dd, FAR_M)
        own = (p + t[:, None] * d) / body.half_m
    else:
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (-1.0 - p) / d, (1.0 - p) / d
        near, far = np.minimum(a, b), np.maximum(a, b)
        axis = near.argmax(axis=1)
        t = near.max(axis=1)
        t = np.where(t < far.min(axis=1), t, FAR_M)
        own = np.eye(3)[axis]
    normal = own @ body.turn
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.where(t > 0.0, t, FAR_M), normal


def _turned(axis: Floats, angle: float) -> Floats:
    """Rodrigues."""
    x, y, z = axis / np.linalg.norm(axis)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k))


def found_in(
    plan: SweepPlan, camera: CameraFit, side: int, peaks: Sequence[tuple[int, float, float]], t_ns: int
) -> BlockPeaks:
    """What a robot is told of a sweep over whole frames, in blocks of `side` px, by peaks that were drawn."""
    return BlockPeaks(
        t_ns=t_ns,
        sweep=plan.sweep,
        focus=plan.focus[-1],
        block_px=side,
        cols=camera.width_px // side,
        rows=camera.height_px // side,
        peaks=tuple(peaks),
    )
