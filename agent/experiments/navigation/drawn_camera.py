"""What a robot's camera would tell it of the basin: tags and points of floor and walls projected, never rendered.

The tags hang where the twin's survey errors put them (hw.twin.landmarks), the camera looks from where the twin's
gimbal carries it. Corners err as tag_noise.py has measured it on rendered frames; points that are followed, as
docs/landmarks.md has it. Tags without edges are left out. Nothing is hidden by anything, and no motion blurs anything.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.swim.projection import BENT_PX, EDGE_AT, EDGE_PX, OFFSET_PX, STRETCH
from agent.core.config import Fleet
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import Flow, SeenTag, SeenTags
from agent.experiments.navigation.basin import TANK
from agent.perception.flow import MOST, STILL_PX, has_settled, is_due
from agent.perception.tags import module_px
from hw.twin.devices.camera_device import look
from hw.twin.history import RobotPose
from hw.twin.landmarks import true_tags
from hw.twin.scene import generator

Array = NDArray[np.float64]

NARROWEST_PX = 3.0  # of a tag's modules: nine of ten in rendered frames have edges from there on, else one of ten
STEEPEST = 0.35  # cosine between a tag's normal and the way to it: 70 degrees
NEAREST_M, FARTHEST_M = 0.15, 2.2  # in rendered frames of tap water some tags are read at 2.3 m
POINTS_M2 = 600.0  # points worth following, on floor and walls
FOLLOWED_PX = 0.17  # half of them are within 0.2 px of where they should be
TURNS = ((-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))  # corners of a tag, right and up, clockwise as seen


class DrawnCamera:
    """One robot's; `expose` in the order of time."""

    def __init__(self, fleet: Fleet, name: str, camera: CameraFit) -> None:
        seed = fleet.twin.seed
        hung = true_tags(fleet.landmarks, seed)
        self._ids = [tag.id for tag in hung]
        arms = np.array([[(right, up, 0.0) for right, up in TURNS]])
        sizes = np.array([tag.size_m for tag in hung])[:, None, None]
        axes, self._middles = np.array([tag.rotation for tag in hung]), np.array([tag.position_m for tag in hung])
        self._corners = self._middles[:, None] + 0.5 * sizes * np.einsum("nij,mkj->nki", axes, arms)
        self._out = axes[:, :, 2]
        self._points = points_of_planes(generator(seed, "points"))
        self._camera, self._camera_m = camera, fleet.body.camera_m
        self._rng = generator(seed, name, "drawn camera")
        self._frames = 0
        self._key: tuple[int, Array, Array] | None = None  # exposure, numbers of points, slopes then
        self._before: tuple[Array, NDArray[np.bool_]] | None = None  # slopes of all points, and which were seen
        self._moved_ns = 0  # when the picture last moved

    def expose(self, pose: RobotPose, t_ns: int) -> tuple[SeenTags, Flow | None]:
        """A frame from there, the lens at rest."""
        self._frames += 1
        eye, _ = look(pose, self._camera_m)
        at, axes = np.asarray(eye.position_m), np.asarray(eye.rotation)
        return SeenTags(t_ns=t_ns, frame=self._frames, tags=self._tags(at, axes)), self._flow(at, axes, t_ns)

    def interrupt(self) -> None:
        """The lens moves: what was followed is lost."""
        self._key = self._before = None

    def _tags(self, at: Array, axes: Array) -> tuple[SeenTag, ...]:
        slopes, depths = self._project(self._corners.reshape(-1, 3), at, axes)
        slopes, depths = slopes.reshape(-1, 4, 2), depths.reshape(-1, 4)
        f_px = self._camera.f_px
        way = at - self._middles
        facing = np.sum(way * self._out, axis=1) / np.linalg.norm(way, axis=1)
        size_px = f_px * np.linalg.norm(np.roll(slopes, -1, axis=1) - slopes, axis=2).min(axis=1)
        seen = self._inside(slopes, depths).all(axis=1) & (facing > STEEPEST)
        found = []
        for k in np.flatnonzero(seen):
            if module_px(f_px * slopes[k]) < NARROWEST_PX:
                continue
            corners, rho_px = slopes[k], f_px * float(np.hypot(*slopes[k].mean(axis=0)))
            offset_px = OFFSET_PX + BENT_PX * (rho_px / (EDGE_AT * self._camera.width_px)) ** 3
            off_px = self._rng.normal(0.0, EDGE_PX, (4, 2)) + self._rng.normal(0.0, offset_px, 2)
            larger = self._rng.normal(0.0, STRETCH) * (corners - corners.mean(axis=0))
            told = (corners + larger + off_px / f_px).tolist()
            a, b, c, d = ((x, y) for x, y in told)
            found.append(SeenTag(self._ids[k], (a, b, c, d), float(size_px[k]), rho_px, True))
        return tuple(found)

    def _flow(self, at: Array, axes: Array, t_ns: int) -> Flow | None:
        """Points of the key frame that are still in the picture; a new one where that is due."""
        slopes, depths = self._project(self._points, at, axes)
        here = self._inside(slopes, depths)
        told = None
        self._heed(slopes, here, t_ns)
        if self._key is not None:
            since_ns, numbers, then = self._key
            left = here[numbers]
            kept = np.flatnonzero(left)[:MOST]
            now = slopes[numbers[kept]] + self._rng.normal(0.0, FOLLOWED_PX / self._camera.f_px, (len(kept), 2))
            pairs = np.hstack([then[kept], now]).tolist()
            told = Flow(t_ns=t_ns, since_ns=since_ns, pairs=tuple((a, b, c, d) for a, b, c, d in pairs))
            if has_settled(since_ns, t_ns, self._moved_ns) or is_due(since_ns, t_ns, left):
                self._key = None
        if self._key is None:
            numbers = self._rng.permutation(np.flatnonzero(here))
            self._key = t_ns, numbers, slopes[numbers]
        return told if told is not None and told.pairs else None

    def _heed(self, slopes: Array, here: NDArray[np.bool_], t_ns: int) -> None:
        """Take note of whether the picture moved since the frame before."""
        if self._before is not None:
            both = here & self._before[1]
            steps_px = self._camera.f_px * np.linalg.norm(slopes[both] - self._before[0][both], axis=1)
            if not len(steps_px) or np.median(steps_px) > STILL_PX:
                self._moved_ns = t_ns
        self._before = slopes, here

    def _project(self, points_m: Array, at: Array, axes: Array) -> tuple[Array, Array]:
        """Slopes (n, 2) and depths (n,) of points (n, 3)."""
        x, y, z = ((points_m - at) @ axes).T
        depths = z - self._camera.ahead_m
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.stack([x, y], axis=1) / depths[:, None], depths

    def _inside(self, slopes: Array, depths: Array) -> NDArray[np.bool_]:
        half = np.array([self._camera.width_px, self._camera.height_px]) / (2.0 * self._camera.f_px)
        near = (depths > NEAREST_M) & (depths < FARTHEST_M)
        return np.asarray(near & (np.abs(slopes) < half).all(axis=-1))


def points_of_planes(rng: np.random.Generator) -> Array:
    """Points (n, 3) all over the floor and the walls, as far as they are wet."""
    length_m, breadth_m, _ = TANK.size_m
    sides = (length_m, breadth_m, TANK.surface_m)
    found = []
    for axis, level_m in ((2, 0.0), (0, 0.0), (0, length_m), (1, 0.0), (1, breadth_m)):
        area_m2 = np.prod([side for k, side in enumerate(sides) if k != axis])
        points = rng.uniform(0.0, sides, (round(POINTS_M2 * float(area_m2)), 3))
        points[:, axis] = level_m
        found.append(points)
    return np.concatenate(found)
