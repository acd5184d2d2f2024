"""What one robot's camera would tell of a fish that swims: the box around what it shows of itself, never rendered.

The body is the twin's, bent as it swims: seen from the side its box is three times as wide as head-on. So how far it is
by its size is wrong by half, and for as long as it keeps its side.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.core.config import Fleet
from agent.core.messages import Vector
from agent.core.ranging.camera_model import CameraFit, pixel
from agent.experiments.following.cases import LENGTH_M
from agent.experiments.navigation.drawn_ball import BALL_FARTHEST_M, BallPath, DrawnTarget
from hw.twin.creatures.shape import swimming
from hw.twin.creatures.swimmer import STRIDE, Attitude
from hw.twin.devices.camera_device import look
from hw.twin.history import RobotPose
from hw.twin.scene import Creature, generator

SHOWN = 1.0 / 3.0  # of its box in the picture, or it is not found (docs/experiments.md, Detection)
NEAREST_M = 0.1  # of its middle from the lens; nearer, it is a blur of colour
EDGE_PX = 2.0  # of its box: the detector's pixels are four of the picture's
AROUND_NS = 50_000_000  # its heading is the way that it swims in so long before and after

Array = NDArray[np.float64]


class DrawnFish(DrawnTarget):
    """A fish; path: of its middle. Nobody sweeps what swims."""

    def __init__(self, fleet: Fleet, name: str, camera: CameraFit, path: BallPath) -> None:
        super().__init__(fleet, path)
        self._rng, self._seed = generator(fleet.twin.seed, name, "drawn fish"), fleet.twin.seed
        self._way, self._camera, self._camera_m = path, camera, fleet.body.camera_m

    def _shows(self, pose: RobotPose, t_ns: int, at_m: Vector, lens_position: int | None) -> dict[str, Any] | None:
        seen = self._box(pose, t_ns, at_m)
        if seen is None:
            return None
        left, top, right, bottom = seen
        return {
            "centre_px": (0.5 * (left + right), 0.5 * (top + bottom)),
            "size_px": (right - left, bottom - top),
            "area_px": (right - left) * (bottom - top),
            "score": 1.0,
        }

    def _box(self, pose: RobotPose, t_ns: int, fish_m: Vector) -> tuple[float, float, float, float] | None:
        """Left, top, right and bottom, px, of what the picture shows; None: too little."""
        eye, _ = look(pose, self._camera_m)
        rotation = np.asarray(eye.rotation)
        x, y, z = ((np.array(fish_m) - np.asarray(eye.position_m)) @ rotation).tolist()
        if not z - self._camera.ahead_m > NEAREST_M or math.hypot(x, y, z) > BALL_FARTHEST_M:
            return None
        low, high = self._extent(t_ns, fish_m, np.asarray(eye.position_m), rotation)
        size = np.array([self._camera.width_px, self._camera.height_px], float)
        corners = [pixel(self._camera, (*slopes.tolist(), 1.0 + self._camera.ahead_m)) for slopes in (low, high)]
        edges = np.array(corners, float)
        whole = float(np.prod(edges[1] - edges[0]))
        edges = np.clip(edges + self._rng.normal(0.0, EDGE_PX, (2, 2)), 0.0, size)
        if float(np.prod(edges[1] - edges[0])) < SHOWN * whole or (edges[1] <= edges[0]).any():
            return None
        (left, top), (right, bottom) = edges.tolist()
        return left, top, right, bottom

    def _extent(self, t_ns: int, fish_m: Vector, eye_m: Array, rotation: Array) -> tuple[Array, Array]:
        """Slopes (right, down) of the least and the most that any part of it comes to."""
        then, soon = np.array(self._way(t_ns - AROUND_NS)), np.array(self._way(t_ns + AROUND_NS))
        way_m = soon - then
        speed_m_s = float(np.linalg.norm(way_m)) / (2e-9 * AROUND_NS)
        beat = 2.0 * math.pi * speed_m_s / (STRIDE * LENGTH_M) * t_ns * 1e-9
        attitude = Attitude(*fish_m, math.atan2(way_m[1], way_m[0]), 0.0, beat, 1.0)
        body = swimming(Creature(name="fish", length_m=LENGTH_M), attitude, self._seed)
        low, high = np.full(2, math.inf), np.full(2, -math.inf)
        for part in body.parts:
            x, y, z = (np.asarray(part.position_m) - eye_m) @ rotation
            depth_m = max(z - self._camera.ahead_m, 0.5 * NEAREST_M)
            axes = (np.asarray(part.rotation) * np.asarray(part.radii_m)).T @ rotation
            half = np.linalg.norm(axes[:, :2], axis=0)
            low = np.minimum(low, (np.array([x, y]) - half) / depth_m)
            high = np.maximum(high, (np.array([x, y]) + half) / depth_m)
        return low, high
