"""A ball in the dark, robots around it with lamps, the focus sweeps of one of them, and how good the light models are.

Pictures are the twin's, with noise and exposure; clarity and its peak are the project's own. Drawn once for each
lens position and developed again and again, sweeps differ in the sensor's noise alone.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.light import model
from agent.capabilities.light.allocate import Lamp, Scene
from agent.capabilities.light.model import all_orders
from agent.clock import machine
from agent.core.config import Beam, Lighting, Tank, WaterOptics
from agent.core.messages import Vector
from agent.core.ranging.focus import Peak, fit_peak
from agent.experiments.experiment import Row
from agent.experiments.peak_shift import mm_per_position
from agent.experiments.veil_monte_carlo import Medium, beside, scattered
from agent.perception.clarity import around, disc_clarity
from hw.camera.camera import Frame, Roi
from hw.twin.optics.lamps import transmission
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye, Hull, LampBeam, Moment, Optics
from hw.twin.optics.veil import CELLS, INTENSITY_W_SR, Grid, Scattering, beam_table, fill_veil, make_beams, scattering
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
SENSOR = "imx519_640"
BODY_BEHIND_M, BESIDE_M = 0.10, 0.12  # hull's middle behind the camera, lamp to its left
POSITIONS = 30  # of a sweep, over the whole range
ACCEPTED = 0.5  # of the developed sweeps: with fewer there is no sigma


class Stand(NamedTuple):
    """One robot: its camera's place, level with the ball or not, aimed at it as its lamp is."""

    camera_m: Vector

    @property
    def distance_m(self) -> float:
        return math.dist(self.camera_m, BALL_M)


class Swept(NamedTuple):
    sigma_mm: float | None  # standard deviation of the peak over developed sweeps, in range; None: too few accepted
    accepted: float  # share of the sweeps that have a peak
    stated_mm: float | None  # what their fits state, in the median


def stand(distance_m: float, azimuth_deg: float, rise_m: float = 0.0) -> Stand:
    """So far from the ball, seen from it at this azimuth."""
    flat = math.sqrt(distance_m**2 - rise_m**2)
    a = math.radians(azimuth_deg)
    return Stand((BALL_M[0] + flat * math.cos(a), BALL_M[1] + flat * math.sin(a), BALL_M[2] + rise_m))


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


def lamps_of(stands: Mapping[str, Stand], busy: Collection[str] = ()) -> dict[str, Lamp]:
    """As the rule takes them."""
    return {name: Lamp(lamp_place(one), name not in busy) for name, one in stands.items()}


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
        good = [peak for peak in peaks if isinstance(peak, Peak)]
        slope = self.slope_mm(distance_m)
        if len(good) < max(ACCEPTED * draws, 3):
            return Swept(None, len(good) / draws, None)
        spread = float(np.std([peak.lens_position for peak in good], ddof=1))
        return Swept(spread * slope, len(good) / draws, float(np.median([peak.sigma for peak in good])) * slope)


# --- how good the models of light are ---

UNCUT_RAD = 1e-6
GREEN = 1
REPEATS = 8
LENGTHS = 4096  # of the transmission's table: 8 m


def model_check(seed: int, waters: Sequence[str], sweeps: Sequence[Row]) -> Row:
    """The kernel's and the twin's veil against fresh Monte Carlo, what a lamp costs to draw, and whether the model's
    information says what sweeps then show. Geometries are drawn from `seed`, not those that the tables were made at."""
    rng = np.random.Generator(np.random.PCG64([seed, 2022]))
    first, orders, twin_first, twin_orders = [], [], [], []
    for water in waters:
        optics = WATERS[water]
        for _ in range(4):
            depth_m, ahead_m, aside_m = draw_geometry(rng)
            one, more = against_monte_carlo(optics, depth_m, ahead_m, aside_m, seed)
            first.append(one)
            orders.append(more)
            one, more = twin_against_monte_carlo(optics, depth_m, ahead_m, aside_m, seed)
            twin_first.append(one)
            twin_orders.append(more)
    return {
        "veil_first_order": worst(first),
        "veil_all_orders": worst(orders),
        "twin_veil_first_order": worst(twin_first),
        "twin_veil_all_orders": worst(twin_orders),
        "ms_per_lamp": ms_per_lamp(waters[-1], seed),
        "correlation": {water: correlation([row for row in sweeps if row["water"] == water]) for water in waters},
    }


def worst(shares: Sequence[float]) -> float:
    """The largest difference, as a share."""
    return max(abs(share) for share in shares)


def draw_geometry(rng: np.random.Generator) -> tuple[float, float, float]:
    """Camera to ball, and how far ahead of the camera and beside its axis a lamp is: the own one or a neighbour's."""
    depth_m = float(rng.uniform(0.7, 2.0))
    if rng.random() < 0.4:
        return depth_m, 0.0, float(rng.uniform(0.1, 0.4))
    range_m, angle = float(rng.uniform(0.5, 1.2)), math.radians(float(rng.uniform(20.0, 80.0)))
    return depth_m, depth_m - range_m * math.cos(angle), range_m * math.sin(angle)


def against_monte_carlo(
    water: WaterOptics, depth_m: float, ahead_m: float, aside_m: float, seed: int
) -> tuple[float, float]:
    """The kernel's veil less Monte Carlo's, as a share of that: of one order, attenuated alike, and of all orders."""
    a, b = water.absorption_per_m[GREEN], water.scattering_per_m[GREEN]
    setting, beam = beside(depth_m, RADIUS_M, ahead_m, aside_m), Beam(intensity_w_sr=1.0)
    single = scattered(setting, Medium(a, b), orders=1, straight_rad=UNCUT_RAD, error=0.002, seed=seed).total
    every = scattered(setting, Medium(a, b), error=0.01, seed=seed).total
    attenuated = model.single_veil(depth_m, RADIUS_M, ahead_m, aside_m, water, beam, 1.0)[GREEN]
    with_table = model.single_veil(depth_m, RADIUS_M, ahead_m, aside_m, water, beam)[GREEN]
    times = all_orders(depth_m, ahead_m, aside_m, water)[GREEN]
    return attenuated / single - 1.0, with_table * times / every - 1.0


def twin_against_monte_carlo(
    water: WaterOptics, depth_m: float, ahead_m: float, aside_m: float, seed: int
) -> tuple[float, float]:
    """The same of the twin's froxels, on the axis of a camera."""
    a, b = water.absorption_per_m[GREEN], water.scattering_per_m[GREEN]
    setting = beside(depth_m, RADIUS_M, ahead_m, aside_m)
    single = scattered(setting, Medium(a, b), orders=1, straight_rad=UNCUT_RAD, error=0.002, seed=seed).total
    every = scattered(setting, Medium(a, b), error=0.01, seed=seed).total
    found = []
    for orders in (False, True):
        tables = scattering(water.absorption_per_m, water.scattering_per_m, orders)
        found.append(axis_veil(tables, depth_m, ahead_m, aside_m))
    return found[0] / single - 1.0, found[1] / every - 1.0


def axis_veil(tables: Scattering, depth_m: float, ahead_m: float, aside_m: float) -> float:
    """Green veil on the axis of a camera at the origin that looks along z, by the twin's cells; per W/sr."""
    sin, cos = (
        aside_m / math.hypot(depth_m - ahead_m, aside_m),
        (depth_m - ahead_m) / math.hypot(depth_m - ahead_m, aside_m),
    )
    beams = make_beams(
        (LampBeam((aside_m, 0.0, ahead_m), (-sin, 0.0, cos), 1.0),),
        np.eye(3, 4),
        [(np.array((0.0, 0.0, depth_m)), RADIUS_M)],
        np.concatenate([np.eye(3), [[0.0], [0.0], [-depth_m]]], axis=1)[None] / RADIUS_M,
        np.zeros(1, np.int64),
    )
    one = np.float32
    optics = Optics(one(1e-3), one(0), one(0), one(0), one(0), one(INDEX**2), one(0))
    grid = Grid(0, 0, 1, 1, 1, depth_m - RADIUS_M)
    veil = np.zeros((1, 1, CELLS + 1, 3), np.float32)
    fill_veil(optics, beams, tables, beam_table(), transmission(tables.extinct, LENGTHS), grid, veil)
    return float(veil[0, 0, CELLS, GREEN]) / INTENSITY_W_SR


def ms_per_lamp(water: str, seed: int) -> float:
    """What one more lamp adds to a whole frame of 640 x 480, the least of several."""
    sea = DarkWater(water, seed)
    sea.prepare()
    stands = {"r1": stand(1.25, 0.0), "r2": stand(0.72, 30.0), "r3": stand(0.72, -45.0)}
    lens_m = sea.sharp_m(1.25)

    def least(burning: tuple[str, ...]) -> float:
        moment = sea.moment("r1", stands, burning)
        times = []
        for _ in range(REPEATS):
            began_s = machine.processor_s()
            sea.painter.light(moment, lens_m)
            times.append(machine.processor_s() - began_s)
        return min(times)

    return 1e3 * (least(("r1", "r2", "r3")) - least(("r1",))) / 2


def correlation(rows: Sequence[Row]) -> float | None:
    """Of log J with the logarithm of the measured sigma, where no lamp shines towards the camera; None: too few."""
    good = [row for row in rows if row["sigma_mm"] and not row["facing"]]
    if len(good) < 8:
        return None
    measured = [math.log(row["sigma_mm"]) for row in good]
    return float(np.corrcoef([row["log_j"] for row in good], measured)[0, 1])
