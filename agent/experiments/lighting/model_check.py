"""How good the models of light are: the kernel's and the twin's veil against fresh Monte Carlo, what a lamp costs to
draw, and whether the model's information says what sweeps then show."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from agent.capabilities.light import model
from agent.capabilities.light.model import all_orders
from agent.clock import machine
from agent.core.config import Beam, WaterOptics
from agent.experiments.lighting.dark_water import INDEX, RADIUS_M, WATERS, DarkWater, stand
from agent.experiments.lighting.monte_carlo import Medium, scattered
from agent.experiments.lighting.veil_nodes import beside
from agent.experiments.result import Row
from hw.twin.optics.lamps.beam import INTENSITY_W_SR, beam_table, make_beams
from hw.twin.optics.lamps.lit import transmission
from hw.twin.optics.lamps.scattered import Scattering, scattering
from hw.twin.optics.lamps.veil import CELLS, Grid, fill_veil
from hw.twin.optics.raycast import Optics
from hw.twin.optics.view import LampBeam

UNCUT_RAD = 1e-6
GREEN = 1
REPEATS = 8
LENGTHS = 4096  # of the transmission's table: 8 m


def model_check(seed: int, waters: Sequence[str], sweeps: Sequence[Row]) -> Row:
    """Geometries drawn from `seed`, not those that the tables were made at."""
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
