"""What robots agree on, and what Stone Soup makes of the same numbers: Kalman updates, covariance intersection."""

from __future__ import annotations

import datetime
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError
from agent.core.estimation.evidence_table import Table
from agent.core.estimation.fuse import fuse
from agent.core.estimation.interface import Prior
from agent.core.linear_algebra import full, upper
from agent.experiments.claim import Claim, Figure, NoSettings, Row, Rows, Value, rms
from agent.experiments.localization.lockstep import TARGET_M, draw_dive, draw_world

ROBOTS = {"three": 3, "ten": 10}
SAMPLES = 10  # of each robot
Array = NDArray[np.float64]
Place = tuple[Array, Array]  # (3,) and its covariance (3, 3)
NOW = datetime.datetime(2026, 1, 1)


def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """Errors and NEES of one draw, by each way. Raises ConfigError without Stone Soup."""
    world = draw_world(ROBOTS[case], "aniso", True, np.random.default_rng(seed))
    dive = draw_dive(world, "all", 0.0, SAMPLES, np.random.default_rng((seed, 1)))
    table = Table()
    for k, (random_m2, stays_m2) in enumerate(zip(world.random_m2, world.systematic_m2, strict=True)):
        for x, y, z in dive.sample_m[:, k].tolist():
            table.measure((f"r{k:02d}", 1), Prior((x, y, z), upper(random_m2), 0, upper(stays_m2)))
    fused = fuse(table.opinions())
    assert fused is not None
    of_each = list(zip(dive.sample_m.mean(axis=0), world.random_m2 / SAMPLES + world.systematic_m2, strict=True))
    ways: dict[str, Place] = {"ours": (np.array(fused.x_m), np.array(full(fused.cov_m2)))}
    ways |= {way: in_turn(of_each, step) for way, step in steps().items()}
    return [{way: judged(*place) for way, place in ways.items()}]


def judged(x: Array, covariance: Array) -> dict[str, float]:
    off = x - TARGET_M
    return {"error_mm": 1e3 * float(np.linalg.norm(off)), "nees": float(off @ np.linalg.solve(covariance, off))}


def in_turn(places: list[Place], step: Callable[[Place, Place], Place]) -> Place:
    so_far = places[0]
    for place in places[1:]:
        so_far = step(so_far, place)
    return so_far


def steps() -> dict[str, Callable[[Place, Place], Place]]:
    """Stone Soup's updates of one place by another. Their covariance intersection weighs both alike, as it ships."""
    try:
        from stonesoup.models.measurement.linear import LinearGaussian
        from stonesoup.types.detection import Detection, GaussianDetection
        from stonesoup.types.hypothesis import SingleHypothesis
        from stonesoup.types.prediction import GaussianStatePrediction
        from stonesoup.updater.chernoff import ChernoffUpdater
        from stonesoup.updater.kalman import KalmanUpdater
    except ImportError:
        raise ConfigError("experiment oracles: Stone Soup is not installed: pip install 'aucamp[oracles]'") from None

    def model(covariance: Array) -> LinearGaussian:
        return LinearGaussian(ndim_state=3, mapping=(0, 1, 2), noise_covar=covariance)

    def predicted(place: Place) -> GaussianStatePrediction:
        return GaussianStatePrediction(place[0][:, None], place[1], timestamp=NOW)

    def kalman(a: Place, b: Place) -> Place:
        seen = Detection(b[0][:, None], timestamp=NOW, measurement_model=model(b[1]))
        found = KalmanUpdater(None).update(SingleHypothesis(predicted(a), seen))
        return np.ravel(found.mean).astype(float), np.array(found.covar, float)

    def intersection(a: Place, b: Place) -> Place:
        nothing = model(np.zeros((3, 3)))
        seen = GaussianDetection(b[0][:, None], b[1], timestamp=NOW, measurement_model=nothing)
        found = ChernoffUpdater(nothing).update(SingleHypothesis(predicted(a), seen))
        return np.ravel(found.mean).astype(float), np.array(found.covar, float)

    return {"kalman": kalman, "intersection": intersection}


def summary(rows: Rows) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for case, of in rows.items():
        off = {way: rms([row[way]["error_mm"] for row in of]) for way in of[0]}
        found[f"{case}_to_kalman"] = _ratio(off["ours"], off["kalman"])
        found[f"{case}_to_intersection"] = _ratio(off["ours"], off["intersection"])
        for way in off:
            found[f"{case}_{way}_nees"] = float(np.mean([row[way]["nees"] for row in of]))
    return found


def _ratio(ours: float | None, theirs: float | None) -> float | None:
    return None if ours is None or not theirs else ours / theirs


def _figures(case: str, robots: int) -> tuple[Figure, ...]:
    return (
        Figure(f"{case}_to_kalman", f"{robots} robots: our error to that of Kalman updates with all of it", most=1.06),
        Figure(f"{case}_to_intersection", "to that of covariance intersection", most=1.0),
        Figure(f"{case}_ours_nees", "our NEES, 3 where it is honest", least=2.5, most=3.5),
        Figure(f"{case}_kalman_nees", "that of Kalman updates"),
        Figure(f"{case}_intersection_nees", "that of covariance intersection"),
    )


CLAIM = Claim(
    run=run,
    summary=summary,
    cases=tuple(ROBOTS),
    measured_on="outside judge",
    figures=tuple(figure for case, robots in ROBOTS.items() for figure in _figures(case, robots)),
    seeds=200,
    explanation="""Ten samples of each robot, with errors that average out and errors that stay, no robot wrong. Each
        way has the same numbers: ours as entries of a table, Stone Soup the mean of each robot with its covariance.
        Kalman updates are right here, for robots are independent; covariance intersection is what is right where
        nobody knows how they depend on each other.""",
)
