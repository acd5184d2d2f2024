"""A ball in the dark, robots around it with lamps, and the focus sweeps of one of them.

Pictures are the twin's, with noise and exposure; clarity and its peak are the project's own. Drawn once for each
lens position and developed again and again, sweeps differ in the sensor's noise alone.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.light.allocate import Lamp, Scene
from agent.core.config import CameraPreset, Lighting, Tank, WaterOptics
from agent.core.messages import Vector
from agent.core.ranging.focus import Peak, fit_peak
from agent.experiments.still_camera import mm_per_position
from agent.perception.clarity import around, disc_clarity
from hw.camera.camera import Frame, Roi
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye, Hull, LampBeam, Moment
from hw.twin.scene import Scene as TwinScene
from hw.twin.scene import SceneWater, Solid, generator

Array = NDArray[np.float64]

# blue, green, red, 1/m; scattering alike in all. Of the size that the names have in the literature of Jerlov's types.
WATERS: dict[str, WaterOptics] = {
    "coastal": WaterOptics(absorption_per_m=(0.25, 0.18, 0.35), scattering_per_m=(0.22, 0.22, 0.22)),
    "bay": WaterOptics(absorption_per_m=(0.40, 0.25, 0.40), scattering_per_m=(0.80, 0.80, 0.80)),
    "harbour": WaterOptics(absorption_per_m=(0.55, 0.37, 0.45), scattering_per_m=(1.82, 1.82, 1.82)),
}
TANK = Tank(size_m=(8.0, 8.0, 4.0), surface_m=4.0)  # so large that its walls stay dark
BALL_M, RADIUS_M = (4.0, 4.0, 2.0), 0.07
INDEX = 1.333
SENSOR: CameraPreset = "imx519_640"
BODY_BEHIND_M, BESIDE_M = 0.10, 0.12  # hull's middle behind the camera, lamp to its left
POSITIONS = 30  # of a sweep, over the whole range
ACCEPTED = 0.5  # of the developed sweeps: with fewer there is no sigma


class Stand(NamedTuple):
    """One robot: its camera's place, level with the ball and aimed at it, as its lamp is."""

    camera_m: Vector

    @property
    def distance_m(self) -> float:
        return math.dist(self.camera_m, BALL_M)


class Swept(NamedTuple):
    sigma_mm: float | None  # standard deviation of the peak over developed sweeps, in range; None: too few accepted
    accepted: float  # share of the sweeps that have a peak


def stand(distance_m: float, azimuth_deg: float) -> Stand:
    """So far from the ball, seen from it at this azimuth."""
    a = math.radians(azimuth_deg)
    return Stand((BALL_M[0] + distance_m * math.cos(a), BALL_M[1] + distance_m * math.sin(a), BALL_M[2]))


def axes_of(one: Stand) -> tuple[Array, Array, Array]:
    """Right, down and ahead of a camera that looks at the ball, world."""
    ahead = np.array(BALL_M) - one.camera_m
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return right, np.cross(ahead, right), ahead


def lamp_place(one: Stand) -> Vector:
    """Where its lamp is."""
    x, y, z = np.array(one.camera_m) - BESIDE_M * axes_of(one)[0]
    return float(x), float(y), float(z)


def lamps_of(stands: Mapping[str, Stand]) -> dict[str, Lamp]:
    """As the rule takes them."""
    return {name: Lamp(lamp_place(one)) for name, one in stands.items()}


class DarkWater:
    """One camera, that of world `seed`, in one water; every robot that sweeps has this camera."""

    def __init__(self, water: str, seed: int) -> None:
        optics = WATERS[water]
        scene = TwinScene(
            name=water,
            room_light=0.0,
            water=SceneWater(absorption_per_m=optics.absorption_per_m, scattering_per_m=optics.scattering_per_m),
            camera=SENSOR,
            solid=(Solid(kind="ball", position_m=BALL_M, radii_m=(RADIUS_M,) * 3),),
        )
        self.lighting = Lighting(water=optics)
        self.lens = draw_lens(SENSOR, generator(seed, "r1", "lens"))
        self._solids = scene.solid
        self.painter = Painter(scene, TANK, INDEX, self.lens, seed, "r1")

    def prepare(self) -> None:
        """Make textures and let the kernels compile."""
        self.painter.prepare()

    def sharp_m(self, distance_m: float) -> float:
        """Lens to sensor at which the ball's nearest point is sharp."""
        apparent_m = self.lens.port_gap_m + (distance_m - RADIUS_M - self.lens.port_gap_m) / INDEX
        return self.lens.image_m(1.0 / apparent_m)

    def slope_mm(self, distance_m: float) -> float:
        """Millimetres of range for a lens position."""
        position = (self.sharp_m(distance_m) - self.lens.at_rest_m) / self.lens.per_position_m
        return float(mm_per_position(self.lens, np.array(position)))

    def scene_of(self, one: Stand) -> Scene:
        """As the rule takes it."""
        x, y, z = axes_of(one)[2].tolist()
        focal_px = INDEX * self.sharp_m(one.distance_m) / self.lens.pixel_m
        return Scene(one.camera_m, (x, y, z), BALL_M, RADIUS_M, focal_px, self.slope_mm(one.distance_m))

    def moment(self, name: str, stands: Mapping[str, Stand], burning: Collection[str]) -> Moment:
        """What `name` sees: the ball, the others' hulls, and these robots' lamps at full power."""
        axes = {robot: axes_of(one) for robot, one in stands.items()}
        hulls = {
            robot: Hull(
                np.array(stands[robot].camera_m) - BODY_BEHIND_M * ahead, np.column_stack([ahead, -right, -down])
            )
            for robot, (right, down, ahead) in axes.items()
        }
        lamps = []
        for robot in sorted(burning):
            place = np.array(lamp_place(stands[robot]))
            way = np.array(BALL_M) - place
            lamps.append(LampBeam(place, way / np.linalg.norm(way), 1.0))
        eye = Eye(stands[name].camera_m, np.column_stack(axes[name]))
        others = tuple(hull for robot, hull in hulls.items() if robot != name)
        return Moment(eye, self._solids, others, lamps=tuple(lamps), own_hull=hulls[name])

    def sweep(
        self, name: str, stands: Mapping[str, Stand], burning: Collection[str], draws: int, first: int = 0
    ) -> Swept:
        """`draws` sweeps of one robot in the light of these lamps; `first`: of the first frame, for its noise."""
        moment, lens = self.moment(name, stands, burning), self.lens
        distance_m = stands[name].distance_m
        radius_px = INDEX * lens.at_rest_m / lens.pixel_m * RADIUS_M / distance_m
        centre_px = lens.centre_px
        roi = around(centre_px, radius_px, (lens.width, lens.height)) or Roi(0, 0, lens.width, lens.height)
        positions = np.rint(np.linspace(lens.lowest, lens.highest, POSITIONS))
        curves = np.zeros((draws, POSITIONS))
        exposure = self.painter.metered(moment, self.sharp_m(distance_m))  # locked while it sweeps
        for k, position in enumerate(positions):
            light = self.painter.light(moment, lens.at_position_m(float(position)), roi)
            for draw in range(draws):
                image = self.painter.develop(light, exposure, roi, first + draw * POSITIONS + k)
                clarity, _ = disc_clarity(Frame(0, 0, image, roi), centre_px, radius_px)
                curves[draw, k] = clarity or 0.0
        peaks = [fit_peak(positions.tolist(), curve.tolist()) for curve in curves]
        good = [peak.lens_position for peak in peaks if isinstance(peak, Peak)]
        if len(good) < max(ACCEPTED * draws, 3):
            return Swept(None, len(good) / draws)
        return Swept(float(np.std(good, ddof=1)) * self.slope_mm(distance_m), len(good) / draws)
