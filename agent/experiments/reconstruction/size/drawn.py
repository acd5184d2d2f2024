"""Keyframes of the basin: pictures by the twin's painter, depths drawn about what its ray caster says.

Nothing is swept. A block's depth is the mean of what it truly sees, by 1/z, with the error of the lens position that
focus would say it has, and goes through the calibration and `focus_map` as a sweep's does. A block has none that sees
two depths or what is out of reach; of the others some have no texture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.focus import lens_position, phase_sigma
from agent.experiments.choices import Sensor
from agent.experiments.navigation.drawn_ball import FOCUS
from agent.experiments.reconstruction.intrinsics import camera_of
from agent.experiments.reconstruction.render import EXACT, rotation_of_view
from agent.experiments.reconstruction.size.basin import Stop, basin, stops, tank
from agent.experiments.sweeps import WATER_INDEX
from agent.perception.depth_peaks import GridPeaks, Reason
from agent.perception.depth_sweep import DepthMap
from agent.reconstruction.views import BLOCKS_ACROSS, MOST_SPREAD, Camera, FocusMap, View, focus_map, linear, reduction
from hw.twin.optics.lens import Lens, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.view import Eye
from hw.twin.scene import Scene, generator

SENSOR: Sensor = "crop_1280"
SHARP_M = 1.0  # where the lens is focused: at what it looks at
NEAREST_M, FARTHEST_M = 0.15, 1.6  # what a sweep reaches
SHOWS = 0.9  # of the blocks have texture enough for a peak
Floats = NDArray[np.float64]


def drawn_views(seed: int, count: int, step: Callable[[], None]) -> Iterator[View]:
    """The first `count` keyframes of one basin, one after the other; step: after each."""
    scene, cameras = basin(seed), dict[str, BasinCamera]()
    for tick, stop in enumerate(stops(seed, count)):
        if stop.robot not in cameras:
            cameras[stop.robot] = BasinCamera(scene, seed, stop.robot)
        yield cameras[stop.robot].view(stop, tick)
        step()


class BasinCamera:
    """One robot's camera, whose pixels are as large as those that pictures are reduced to."""

    def __init__(self, scene: Scene, seed: int, robot: str) -> None:
        whole = draw_lens(SENSOR, generator(seed, robot, "lens"))
        times = reduction(whole.width)
        self._times, self._block = times, whole.width // BLOCKS_ACROSS // 2 * 2
        self._full = whole.width, whole.height
        lens = coarser(whole, times)
        self._image_m = lens.image_m(WATER_INDEX / SHARP_M)
        fit = camera_of(lens, (self._image_m - lens.at_rest_m) / lens.per_position_m)
        self.gamma = fit.gamma
        self.camera = Camera(fit.f_px, fit.cx_px, fit.cy_px, fit.bend, fit.ahead_m, fit.width_px, fit.height_px)
        self._rng = generator(seed, robot, "drawn depths")
        self._painter = Painter(scene, tank(), WATER_INDEX, lens, seed, robot)
        self._painter.prepare()

    def view(self, stop: Stop, tick: int) -> View:
        rotation = rotation_of_view(stop.yaw_deg, stop.tilt_deg)
        eye = Eye(stop.position_m, rotation)
        truth = self._painter.depth(eye, self._image_m).astype(float)
        found = self.focus(truth)
        return View(
            robot=stop.robot,
            incarnation="",
            seq=stop.seq,
            camera=self.camera,
            rotation=rotation,
            position_m=np.array(stop.position_m),
            pose_covariance=EXACT,
            picture=linear(self._painter.frame(eye, self._image_m, tick=tick), self.gamma),
            depth_m=found.depth_m,
            sigma_m=found.sigma_m,
        )

    def focus(self, truth_m: Floats) -> FocusMap:
        """What a sweep would say of these depths (height, width)."""
        side = self._block / self._times
        rows, cols = self._full[1] // self._block, self._full[0] // self._block
        number = (np.arange(truth_m.shape[0]) // side)[:, None] * cols + np.arange(truth_m.shape[1]) // side
        inside = np.s_[: math.floor(rows * side), : math.floor(cols * side)]
        number, inverse = number[inside].astype(int).ravel(), (1.0 / truth_m[inside]).ravel()
        mean = np.bincount(number, inverse, rows * cols) / np.bincount(number, minlength=rows * cols)
        low, high = np.full(rows * cols, np.inf), np.zeros(rows * cols)
        np.minimum.at(low, number, inverse)
        np.maximum.at(high, number, inverse)
        z = 1.0 / mean
        shows = ((high - low) * z < MOST_SPREAD) & (z > NEAREST_M) & (z < FARTHEST_M)
        shows &= self._rng.random(len(z)) < SHOWS
        sigma = math.hypot(FOCUS.noise, phase_sigma(FOCUS.width, self._block * self._block))
        peaks = np.array([lens_position(FOCUS, float(one)) for one in z]) + self._rng.normal(0.0, sigma, len(z))
        shape = rows, cols
        reason = np.where(shows, Reason.ACCEPTED, Reason.NO_TEXTURE).astype(np.uint8).reshape(shape)
        everywhere = np.ones(shape)
        grid = GridPeaks(peaks.reshape(shape), sigma * everywhere, FOCUS.width * everywhere, everywhere, reason).ranged(
            FOCUS
        )
        found = DepthMap(self._block, grid, None, np.zeros((1, 1, 3), np.uint8), 0.0)
        return focus_map(found, FOCUS, self._times, truth_m.shape[::-1])


def coarser(lens: Lens, times: int) -> Lens:
    """The same lens before a sensor whose pixels are so many times as wide."""
    cx, cy = ((c - (times - 1) / 2.0) / times for c in lens.centre_px)
    return lens._replace(
        pixel_m=times * lens.pixel_m, width=lens.width // times, height=lens.height // times, centre_px=(cx, cy)
    )
