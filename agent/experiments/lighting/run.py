"""What it is worth that robots light for each other: own lamp, all lamps, one set for all, the rule, and the optimum of
the rule's own score; by sweeps that the twin draws in the dark.

A range is usable where at least half of the sweeps have a peak and their standard deviation is below 60 mm. That is the
sensor's noise alone: what texture does to a peak (docs/experiments.md, depth) comes on top, and is the same for all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import msgspec
import numpy as np

from agent.capabilities.light.allocate import WORST_MM, dazzles
from agent.experiments.lighting.bars import missed
from agent.experiments.lighting.dark_water import WATERS, DarkWater, Stand, Swept, lamp_place, stand
from agent.experiments.lighting.model_check import model_check
from agent.experiments.lighting.policies import POLICIES, Names, after_loss, scored, sets_for
from agent.experiments.result import ExperimentResult, Row
from agent.process.command import Progress, step_by_step

LADDER_M = (0.75, 1.0, 1.25, 1.5, 1.8, 2.1, 2.5)  # camera to ball, two neighbours' lamps 0.6 m from it
NEIGHBOURS = (("r2", 0.6, 30.0), ("r3", 0.6, -45.0))
NEAR_M, FAR_M, APART_DEG = 0.6, 1.8, 35.0  # of a fleet around its ball
SIZES = (1, 2, 3, 5)
LOSSES = (0.0, 0.3)


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0
    scenes: int = 4  # fleets of each size in each water
    draws: int = 6  # sweeps of each robot in each light
    waters: tuple[str, ...] = tuple(WATERS)


class Result(ExperimentResult, frozen=True, kw_only=True):
    """`cases`: a row for each water, number of robots and policy. With a distance_m it is the first robot's on the
    ladder; without one, all robots of fleets at random places, each of which sweeps in its turn."""

    schema: int = 1
    source: str = "twin"
    seed: int
    scenes: int
    cases: list[Row]
    model: Row
    missed: list[str]  # targets, in words
    sweeps: list[Row]  # every sweep: what the model expected, and what was measured

    @property
    def failed(self) -> bool:
        return bool(self.missed)


class Bench:
    """Sweeps of one fleet, each set of lamps drawn but once."""

    def __init__(self, sea: DarkWater, stands: Mapping[str, Stand], draws: int, first: int) -> None:
        self.sea, self.stands, self.score = sea, stands, scored(sea, stands)
        self._draws, self._first = draws, first
        self._known: dict[tuple[str, Names], Swept] = {}

    def sweep(self, name: str, burning: Names) -> Swept:
        if (name, burning) not in self._known:
            self._known[name, burning] = self.sea.sweep(name, self.stands, burning, self._draws, self._first)
        return self._known[name, burning]

    def rows(self) -> list[Row]:
        """Of all that was swept."""
        found = []
        for (name, burning), swept in self._known.items():
            expected = self.score.of(name, burning)
            scene = self.sea.scene_of(self.stands[name])
            facing = any(dazzles(scene, lamp_place(self.stands[robot])) for robot in burning)
            found.append(
                {
                    "distance_m": round(self.stands[name].distance_m, 4),
                    "own": name in burning,
                    "lamps": len(burning),
                    "facing": facing,  # one of them shines towards the camera: the rule does not look at such sets
                    "log_j": expected.log_j,
                    "expected_mm": expected.sigma_mm,
                    "expected_contrast": expected.contrast,
                    "sigma_mm": swept.sigma_mm,
                    "accepted": swept.accepted,
                }
            )
        return found


def run(settings: Settings, progress: Progress) -> Result:
    """Progress counts fleets."""
    ladder, fleets = len(LADDER_M), settings.scenes * len(SIZES)
    step = step_by_step(progress, len(settings.waters) * (ladder + fleets) + 1)
    cases: list[Row] = []
    sweeps: list[Row] = []
    for water in settings.waters:
        sea = DarkWater(water, settings.seed)
        sea.prepare()
        for distance_m in LADDER_M:
            stands = {"r1": stand(distance_m, 0.0), **{n: stand(d, a) for n, d, a in NEIGHBOURS}}
            bench = Bench(sea, stands, 2 * settings.draws, 0)
            for policy in ("own", "all", "rule", "optimum"):
                swept = bench.sweep("r1", sets_for(policy, sea, stands, bench.score)["r1"])
                row = {"water": water, "robots": 3, "policy": policy, "loss": 0.0, "distance_m": distance_m}
                cases.append({**row, **_summary([swept])})
            sweeps += [{"water": water, **row} for row in bench.rows()]
            step()
        for robots in SIZES:
            benches = []
            for scene in range(settings.scenes):
                rng = np.random.Generator(np.random.PCG64([settings.seed, robots, scene, 22]))
                benches.append((Bench(sea, draw_fleet(robots, rng), settings.draws, 10_000 * (scene + 1)), rng))
            cases += fleet_cases(water, robots, benches, step)
            for bench, _ in benches:
                sweeps += [{"water": water, **row} for row in bench.rows()]
    model = model_check(settings.seed, settings.waters, sweeps)
    step()
    wrong = missed(cases, model, settings.scenes)
    return Result(seed=settings.seed, scenes=settings.scenes, cases=cases, model=model, missed=wrong, sweeps=sweeps)


def draw_fleet(robots: int, rng: np.random.Generator) -> dict[str, Stand]:
    """Robots around the ball, at random, but not in each other's way."""
    azimuths: list[float] = []
    while len(azimuths) < robots:
        azimuth = float(rng.uniform(0.0, 360.0))
        if all(abs((azimuth - other + 180.0) % 360.0 - 180.0) >= APART_DEG for other in azimuths):
            azimuths.append(azimuth)
    return {f"r{k + 1}": stand(float(rng.uniform(NEAR_M, FAR_M)), azimuth) for k, azimuth in enumerate(azimuths)}


def fleet_cases(
    water: str, robots: int, benches: Sequence[tuple[Bench, np.random.Generator]], step: Callable[[], None]
) -> list[Row]:
    """A row for each policy, and one for the rule where messages get lost."""
    found: dict[tuple[str, float], list[Swept]] = {}
    for bench, rng in benches:
        for policy in POLICIES:
            sets = sets_for(policy, bench.sea, bench.stands, bench.score)
            for loss in LOSSES if policy == "rule" else (0.0,):
                for name, wanted in sets.items():
                    burning = after_loss(name, wanted, loss, rng) if loss else wanted
                    found.setdefault((policy, loss), []).append(bench.sweep(name, burning))
        step()
    head = {"water": water, "robots": robots}
    return [
        {**head, "policy": policy, "loss": loss, "distance_m": None, **_summary(swept)}
        for (policy, loss), swept in found.items()
    ]


def usable(swept: Swept) -> bool:
    return swept.sigma_mm is not None and swept.sigma_mm < WORST_MM


def _summary(swept: Sequence[Swept]) -> Row:
    known = [one.sigma_mm for one in swept if one.sigma_mm is not None]
    return {
        "sigma_mm": float(np.median(known)) if 2 * len(known) > len(swept) else None,
        "accepted": float(np.mean([one.accepted for one in swept])),
        "usable_share": float(np.mean([usable(one) for one in swept])),
        "sweeps": len(swept),
    }
