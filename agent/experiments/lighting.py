"""What robots gain that light for each other: own lamp, the rule, and the optimum of the rule's own score, compared by
sweeps that the twin draws in the dark.

A range is usable where at least half of the sweeps have a peak and their standard deviation is below 60 mm. That is the
sensor's noise alone: what texture does to a peak comes on top, and is the same for all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations

import msgspec
import numpy as np

from agent.capabilities.light.allocate import WORST_MM, Worth, allocate, dazzles, worth
from agent.capabilities.light.model import pair
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value
from agent.experiments.dark_water import WATERS, DarkWater, Stand, Swept, lamp_place, lamps_of, stand

# --- policies: whose lamps burn while a robot sweeps ---

Names = frozenset[str]
Score = Callable[[str, Names], Worth]  # of a sweeper and the lamps that burn

POLICIES = ("own", "rule", "optimum")


def scored(sea: DarkWater, stands: Mapping[str, Stand]) -> Score:
    """What the model says of any set of lamps, places and water exactly known."""
    scenes = {name: sea.scene_of(one) for name, one in stands.items()}
    lamps = lamps_of(stands)
    pairs = {
        (name, robot): pair(scene.camera_m, scene.target_m, scene.radius_m, lamp.place_m, sea.lighting)
        for name, scene in scenes.items()
        for robot, lamp in lamps.items()
    }

    def of(name: str, burning: Names) -> Worth:
        chosen, scene = [pairs[name, robot] for robot in sorted(burning)], scenes[name]
        return worth(chosen, stands[name].distance_m, scene.radius_m, scene.focal_px, scene.slope_mm)

    return of


def sets_for(policy: str, sea: DarkWater, stands: Mapping[str, Stand], score: Score) -> dict[str, Names]:
    """Whose lamps burn while each robot sweeps."""
    if policy == "own":
        return {name: frozenset((name,)) for name in stands}
    if policy == "rule":
        lamps = lamps_of(stands)
        return {
            name: frozenset(allocate(name, sea.scene_of(one), lamps, sea.lighting).lamps)
            for name, one in stands.items()
        }
    sets = [frozenset(c) for k in range(1, len(stands) + 1) for c in combinations(sorted(stands), k)]
    return {name: max(sets, key=lambda burning, name=name: score(name, burning).log_j) for name in stands}  # type: ignore[misc]


class Sweeps:
    """Those of one fleet, each set of lamps drawn but once."""

    def __init__(self, sea: DarkWater, stands: Mapping[str, Stand], draws: int, first: int) -> None:
        self.sea, self.stands, self.score = sea, stands, scored(sea, stands)
        self._draws, self._first = draws, first
        self._known: dict[tuple[str, Names], Swept] = {}

    def by(self, policy: str) -> dict[str, Names]:
        return sets_for(policy, self.sea, self.stands, self.score)

    def of(self, name: str, burning: Names) -> Swept:
        if (name, burning) not in self._known:
            self._known[name, burning] = self.sea.sweep(name, self.stands, burning, self._draws, self._first)
        return self._known[name, burning]

    def logs(self) -> list[tuple[float, float]]:
        """Of the expected J and the measured sigma, by set of lamps; not where a lamp shines towards the camera, for
        the rule does not look at such sets."""
        found = []
        for (name, burning), swept in self._known.items():
            scene = self.sea.scene_of(self.stands[name])
            facing = any(dazzles(scene, lamp_place(self.stands[robot])) for robot in burning)
            if swept.sigma_mm and not facing:
                found.append((self.score(name, burning).log_j, math.log(swept.sigma_mm)))
        return found


# --- the ladder: one robot farther and farther away, two neighbours' lamps near the ball ---

LADDER_M = (0.75, 1.0, 1.25, 1.5, 1.8, 2.1, 2.5)  # camera to ball
AT_M = 1.25  # where sigma is compared
NEIGHBOURS = (("r2", 0.6, 30.0), ("r3", 0.6, -45.0))  # distance from the ball, m, and azimuth, deg


def on_ladder(sea: DarkWater, draws: int) -> tuple[Row, list[tuple[float, float]]]:
    """Sigma at AT_M by own lamp and rule, None: hardly any peak; the farthest distance at which at least half of the
    sweeps have one, at least the ladder's first; and the logarithms of all sweeps."""
    row: Row = {f"{policy}_reach_m": LADDER_M[0] for policy in ("own", "rule")}
    logs = []
    for distance_m in LADDER_M:
        stands = {"r1": stand(distance_m, 0.0), **{name: stand(*place) for name, *place in NEIGHBOURS}}
        sweeps = Sweeps(sea, stands, draws, 0)
        for policy in ("own", "rule"):
            swept = sweeps.of("r1", sweeps.by(policy)["r1"])
            if swept.accepted >= 0.5:
                row[f"{policy}_reach_m"] = distance_m
            if distance_m == AT_M:
                row[f"{policy}_mm"] = swept.sigma_mm
        logs += sweeps.logs()
    return row, logs


def ratio(rule_mm: float | None, own_mm: float | None) -> float | None:
    """None: the rule has no sigma; of an own lamp that has none it is nothing."""
    if rule_mm is None:
        return None
    return 0.0 if own_mm is None else rule_mm / own_mm


# --- fleets at random places, all of whose robots sweep in their turn ---

NEAR_M, FAR_M, APART_DEG = 0.6, 1.8, 35.0  # around the ball
SIZES = (2, 3, 5)


def draw_fleet(robots: int, rng: np.random.Generator) -> dict[str, Stand]:
    """Robots around the ball, but not in each other's way."""
    azimuths: list[float] = []
    while len(azimuths) < robots:
        azimuth = float(rng.uniform(0.0, 360.0))
        if all(abs((azimuth - other + 180.0) % 360.0 - 180.0) >= APART_DEG for other in azimuths):
            azimuths.append(azimuth)
    return {f"r{k + 1}": stand(float(rng.uniform(NEAR_M, FAR_M)), azimuth) for k, azimuth in enumerate(azimuths)}


def usable(sweeps: Sweeps, policy: str) -> int:
    """Robots of a fleet that have a usable range."""
    swept = [sweeps.of(name, burning) for name, burning in sweeps.by(policy).items()]
    return sum(one.sigma_mm is not None and one.sigma_mm < WORST_MM for one in swept)


# --- the claim ---

LEAST_PAIRS = 8  # for a correlation


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    scenes: int = 1  # fleets of each size in each world
    draws: int = 5  # sweeps of each robot in each light; on the ladder twice as many


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """A world, by its camera's lens and the ball's texture."""
    sea = DarkWater(case, seed)
    sea.prepare()
    row, logs = on_ladder(sea, 2 * settings.draws)
    counts: dict[str, dict[str, int]] = {}
    for robots in SIZES:
        total = dict.fromkeys(POLICIES, 0)
        for scene in range(settings.scenes):
            rng = np.random.default_rng((seed, robots, scene, 22))
            sweeps = Sweeps(sea, draw_fleet(robots, rng), settings.draws, 10_000 * (scene + 1))
            total = {policy: count + usable(sweeps, policy) for policy, count in total.items()}
            logs += sweeps.logs()
        counts[str(robots)] = {**total, "of": robots * settings.scenes}
    row["times_own"] = ratio(row["rule_mm"], row["own_mm"])
    row["farther"] = row["rule_reach_m"] / row["own_reach_m"]
    return [{**row, "usable": counts, "logs": logs}]


def summary(rows: Rows) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for water, worlds in rows.items():
        for key in ("own_mm", "rule_mm", "times_own", "farther"):
            found[f"{water}_{key}"] = Quantile([world[key] for world in worlds], 50.0)
        total = {size: total_of([world["usable"][size] for world in worlds]) for size in worlds[0]["usable"]}
        five = total[str(max(SIZES))]
        for policy in ("own", "rule"):
            found[f"{water}_{policy}_usable"] = Share(five[policy], five["of"])
        found[f"{water}_below"] = 100.0 * (five["optimum"] - five["rule"]) / five["of"]
        found[f"{water}_gain"] = min(100.0 * (each["rule"] - each["own"]) / each["of"] for each in total.values())
        found[f"{water}_correlation"] = correlation([each for world in worlds for each in world["logs"]])
    return found


def total_of(counts: Sequence[Mapping[str, int]]) -> dict[str, int]:
    return {key: sum(each[key] for each in counts) for key in counts[0]}


def correlation(logs: Sequence[Sequence[float]]) -> float | None:
    """None: of too few."""
    return float(np.corrcoef(np.array(logs).T)[0, 1]) if len(logs) >= LEAST_PAIRS else None


JUDGED = (
    Figure("own_mm", f"{AT_M} m: sigma of the range by the own lamp, median", "mm"),
    Figure("rule_mm", "by the rule, median", "mm"),
    Figure("times_own", "the one over the other, median", most=0.25),
    Figure("farther", "farthest range over that by the own lamp, median", least=1.5),
    Figure("rule_usable", "five robots: have a usable range by the rule", "%", least=75.0),
    Figure("below", "so many fewer than by the optimum", "points", most=5.0),
    Figure("own_usable", "by own lamps", "%"),
    Figure("gain", "two, three or five robots: more than by own lamps, the least", "points", least=0.0),
    Figure("correlation", "log J, as expected, with log sigma, as measured", most=-0.85),
)
EVERYWHERE = ("gain", "correlation")  # figures whose targets hold in all waters; the others' in the harbour


def figures(water: str) -> Iterator[Figure]:
    for figure in JUDGED:
        bare = figure if water == "harbour" or figure.key in EVERYWHERE else figure._replace(least=None, most=None)
        yield bare._replace(key=f"{water}_{figure.key}", words=f"{water}: {figure.words}")


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"draws": 3},
    cases=tuple(WATERS),
    measured_on="twin",
    figures=tuple(figure for water in ("harbour", "bay", "coastal") for figure in figures(water)),
    explanation="""A robot sweeps its focus over a ball in the dark, by the lamps that a policy has burn, again and
        again: its sigma is that of the sensor's noise alone. Two neighbours stand 0.6 m from the ball, or fleets of
        two, three and five at random places sweep in their turn. The rule lends lamps by a model of light and veil;
        the optimum is the best set by the same model. Each seed is another lens and texture, and other fleets.""",
)
