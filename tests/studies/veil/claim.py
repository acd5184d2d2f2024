"""A lamp's veil as the kernel and the twin compute it, against fresh Monte Carlo.

On the axis of a camera that looks at a ball, at drawn places of the lamp, which are none that the tables were made at.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import msgspec
import numpy as np

from agent.capabilities.light.model import all_orders, single_veil
from agent.core.config import Beam, WaterOptics
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value
from agent.experiments.dark_water import INDEX, RADIUS_M, WATERS
from hw.twin.optics.lamps import transmission
from hw.twin.optics.raycast import LampBeam, Optics
from hw.twin.optics.veil import CELLS, INTENSITY_W_SR, Grid, Scattering, beam_table, fill_veil, make_beams, scattering
from tests.studies.veil.particles import Medium, beside, scattered

GREEN = 1
UNCUT_RAD = 1e-6
LENGTHS = 4096  # of the transmission's table: 8 m

Place = tuple[float, float, float]  # camera to ball, and how far ahead of the camera and beside its axis the lamp is, m


def draw_place(rng: np.random.Generator) -> Place:
    """Of the own lamp or a neighbour's."""
    depth_m = float(rng.uniform(0.7, 2.0))
    if rng.random() < 0.4:
        return depth_m, 0.0, float(rng.uniform(0.1, 0.4))
    range_m, angle = float(rng.uniform(0.5, 1.2)), math.radians(float(rng.uniform(20.0, 80.0)))
    return depth_m, depth_m - range_m * math.cos(angle), range_m * math.sin(angle)


def against_monte_carlo(water: WaterOptics, place: Place, seed: int) -> Row:
    """Green veil less Monte Carlo's, as a share of that: of one order, attenuated alike, and of all orders."""
    (depth_m, ahead_m, aside_m), beam = place, Beam(intensity_w_sr=1.0)
    setting = beside(depth_m, RADIUS_M, ahead_m, aside_m)
    medium = Medium(water.absorption_per_m[GREEN], water.scattering_per_m[GREEN])
    single = scattered(setting, medium, orders=1, straight_rad=UNCUT_RAD, error=0.002, seed=seed).total
    every = scattered(setting, medium, error=0.01, seed=seed).total
    attenuated = single_veil(depth_m, RADIUS_M, ahead_m, aside_m, water, beam, 1.0)[GREEN]
    by_table = single_veil(depth_m, RADIUS_M, ahead_m, aside_m, water, beam)[GREEN]
    one, more = (
        axis_veil(scattering(water.absorption_per_m, water.scattering_per_m, orders), *place)
        for orders in (False, True)
    )
    return {
        "kernel_first": attenuated / single - 1.0,
        "kernel_every": by_table * all_orders(depth_m, ahead_m, aside_m, water)[GREEN] / every - 1.0,
        "twin_first": one / single - 1.0,
        "twin_every": more / every - 1.0,
    }


def axis_veil(tables: Scattering, depth_m: float, ahead_m: float, aside_m: float) -> float:
    """Green veil on the axis of a camera at the origin that looks along z, by the twin's cells; per W/sr."""
    range_m = math.hypot(depth_m - ahead_m, aside_m)
    aim = (-aside_m / range_m, 0.0, (depth_m - ahead_m) / range_m)
    beams = make_beams(
        (LampBeam((aside_m, 0.0, ahead_m), aim, 1.0),),
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


# --- the claim ---

FIRST, EVERY = 0.02, 0.30  # so far off it may be, as a share
MOST_PERCENT = 95.0  # of the places have to be within


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    draws: int = 4  # places of the lamp


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    rng = np.random.default_rng((seed, list(WATERS).index(case), 2022))
    return [against_monte_carlo(WATERS[case], draw_place(rng), seed) for _ in range(settings.draws)]


def summary(rows: Rows) -> dict[str, Value]:
    """Of all waters that were run."""
    off = [row for water in rows.values() for row in water]
    found: dict[str, Value] = {}
    for who in ("kernel", "twin"):
        for orders, limit in (("first", FIRST), ("every", EVERY)):
            shares = [abs(row[f"{who}_{orders}"]) for row in off]
            found[f"{who}_{orders}"] = Share(sum(share <= limit for share in shares), len(shares))
            found[f"{who}_{orders}_worst"] = Quantile([100.0 * share for share in shares], 100.0)
    return found


def figures() -> Iterator[Figure]:
    for who in ("kernel", "twin"):
        for orders, limit, words in (("first", FIRST, "one order"), ("every", EVERY, "all orders")):
            key, kept = f"{who}_{orders}", f"{who}, {words}: within {100 * limit:.0f} % of Monte Carlo"
            yield Figure(key, kept, "%", least=MOST_PERCENT)
            yield Figure(f"{key}_worst", "the farthest off of all", "%")


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"draws": 1},
    cases=tuple(WATERS),
    measured_on="model",
    figures=tuple(figures()),
    explanation="""What a lamp's light in the water adds to a picture is computed twice: by the kernel along the
        camera's axis, and by the twin in cells of the view. Both have tables of scattered light that one Monte Carlo
        made; fresh draws of it judge them here, at places of the lamp that the tables were not made at. Each seed
        draws others, of a robot's own lamp and a neighbour's.""",
)
