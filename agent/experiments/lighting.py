"""What robots gain that light for each other: own lamp, all lamps, one set for all, the rule, and the optimum of the
rule's own score, compared by sweeps that the twin draws in the dark.

A range is usable where at least half of the sweeps have a peak and their standard deviation is below 60 mm. That is the
sensor's noise alone: what texture does to a peak (docs/experiments.md, depth) comes on top, and is the same for all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import msgspec
import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table

from agent.capabilities.light.allocate import WORST_MM, Worth, allocate, dazzles, worth
from agent.capabilities.light.model import Pair, pair
from agent.experiments.dark_water import WATERS, DarkWater, Stand, Swept, lamp_place, lamps_of, model_check, stand
from agent.experiments.experiment import ExperimentResult, Figures, Row
from agent.process.command import Progress, step_by_step

# --- policies: whose lamps burn while a robot sweeps ---

Names = frozenset[str]

POLICIES = ("own", "all", "common", "rule", "optimum")


class Scored(NamedTuple):
    """What the model says of any set of lamps, for each robot of a fleet that sweeps."""

    pairs: dict[str, dict[str, Pair]]  # sweeper, then lamp
    of: Callable[[str, Names], Worth]


def scored(sea: DarkWater, stands: Mapping[str, Stand]) -> Scored:
    """Places and water exactly known."""
    pairs: dict[str, dict[str, Pair]] = {}
    for name, one in stands.items():
        scene = sea.scene_of(one)
        pairs[name] = {
            robot: pair(scene.camera_m, scene.target_m, scene.radius_m, lamp.place_m, sea.lighting)
            for robot, lamp in lamps_of(stands).items()
        }

    def of(name: str, burning: Names) -> Worth:
        scene = sea.scene_of(stands[name])
        chosen = [pairs[name][robot] for robot in sorted(burning)]
        return worth(chosen, stands[name].distance_m, scene.radius_m, scene.focal_px, scene.slope_mm)

    return Scored(pairs, of)


def all_sets(names: Mapping[str, Stand]) -> list[Names]:
    """Every set of lamps but the empty one."""
    return [frozenset(c) for k in range(1, len(names) + 1) for c in combinations(sorted(names), k)]


def sets_for(policy: str, sea: DarkWater, stands: Mapping[str, Stand], score: Scored) -> dict[str, Names]:
    """Whose lamps burn while each robot sweeps."""
    if policy == "own":
        return {name: frozenset((name,)) for name in stands}
    if policy == "all":
        return {name: frozenset(stands) for name in stands}
    if policy == "common":  # the one set that serves most robots, and among those best on the whole
        best = max(
            all_sets(stands),
            key=lambda burning: (
                sum(score.of(name, burning).usable for name in stands),
                sum(score.of(name, burning).log_j for name in stands),
            ),
        )
        return dict.fromkeys(stands, best)
    if policy == "optimum":
        return {name: max(all_sets(stands), key=lambda s, n=name: score.of(n, s).log_j) for name in stands}  # type: ignore[misc]
    lamps = lamps_of(stands)
    return {
        name: frozenset(allocate(name, sea.scene_of(one), lamps, sea.lighting).lamps) for name, one in stands.items()
    }


def after_loss(name: str, wanted: Names, loss: float, rng: np.random.Generator) -> Names:
    """The lamps that burn when messages get lost: a lender without its lease stays dark, and a sweeper that hears of
    none takes its own lamp, whichever lamps burn beside it."""
    reached = {robot for robot in sorted(wanted - {name}) if rng.random() >= loss}
    answered = {robot for robot in sorted(reached) if rng.random() >= loss}
    own = {name} if name in wanted or (wanted != {name} and not answered) else set()
    return frozenset(reached | own)


# --- targets ---

ENOUGH = 4  # fleets of each size: with fewer there is no verdict
AT_M, SIGMA_SHARE, RANGE_TIMES = 1.25, 0.25, 1.5  # harbour
USABLE, BELOW_OPTIMUM = 0.75, 0.05  # of five robots, harbour
FIRST_ORDER, ALL_ORDERS, MS_PER_LAMP, CORRELATION = 0.02, 0.30, 10.0, -0.85


def missed(cases: Sequence[Row], model: Row, scenes: int) -> list[str]:
    """The targets that a run misses, in words, for tables and result.json."""
    found: list[str] = []
    if scenes < ENOUGH:
        return found
    ladder = {
        (row["policy"], row["distance_m"]): row
        for row in cases
        if row["water"] == "harbour" and row["distance_m"] is not None
    }
    if ladder:
        own, rule = (ladder[policy, AT_M]["sigma_mm"] for policy in ("own", "rule"))
        if rule is None or (own is not None and rule > SIGMA_SHARE * own):
            found.append(f"sigma at {AT_M} m in harbour water: more than {SIGMA_SHARE} of the own lamp's")
        if reach_m(ladder, "rule") < RANGE_TIMES * reach_m(ladder, "own"):
            found.append(f"accepted range in harbour water: less than {RANGE_TIMES} times the own lamp's")
    fleets = {
        (row["water"], row["robots"], row["policy"]): row["usable_share"]
        for row in cases
        if row["distance_m"] is None and not row["loss"]
    }
    for (water, robots, policy), share in fleets.items():
        if policy == "own" and fleets[water, robots, "rule"] < share:
            found.append(f"{robots} robots in {water}: fewer have a range than with their own lamps")
    if ("harbour", 5, "rule") in fleets:
        rule = fleets["harbour", 5, "rule"]
        if rule < USABLE:
            found.append(f"five robots in harbour water: fewer than {100 * USABLE:.0f} % have a range")
        if rule < fleets["harbour", 5, "optimum"] - BELOW_OPTIMUM:
            found.append(f"five robots in harbour water: more than {100 * BELOW_OPTIMUM:.0f} points below the optimum")
    for key, bar in (("veil_first_order", FIRST_ORDER), ("veil_all_orders", ALL_ORDERS)):
        found += [f"{who}{key}" for who in ("", "twin_") if model[who + key] > bar]
    if model["ms_per_lamp"] > MS_PER_LAMP:
        found.append("ms_per_lamp")
    found += [
        f"correlation of log J with log sigma, {water}"
        for water, value in model["correlation"].items()
        if value is not None and value > CORRELATION
    ]
    return found


def reach_m(ladder: dict[tuple[str, float], Row], policy: str) -> float:
    """The farthest distance at which at least half of the sweeps have a peak."""
    return max((d for (who, d), row in ladder.items() if who == policy and row["accepted"] >= 0.5), default=0.0)


# --- the experiment ---

LADDER_M = (0.75, 1.0, 1.25, 1.5, 1.8, 2.1, 2.5)  # camera to ball, two neighbours' lamps 0.6 m from it
NEIGHBOURS = (("r2", 0.6, 30.0), ("r3", 0.6, -45.0))
NEAR_M, FAR_M, APART_DEG = 0.6, 1.8, 35.0  # of a fleet around its ball
SIZES = (1, 2, 3, 5)
LOSSES = (0.0, 0.3)


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0
    scenes: int = 4  # fleets of each size in each water
    draws: int = 5  # sweeps of each robot in each light
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
        """A row for each robot and set of lamps that was swept."""
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
    """Sweep on the ladder of distances and in random fleets, in each water; progress counts fleets."""
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


# --- tables ---


def table(result: Result) -> RenderableType:
    """By distance, by fleets, how good the models are, and which targets are missed."""
    verdict = "no verdict, too few fleets" if result.scenes < ENOUGH else "; ".join(result.missed) or "nothing"
    return Group(_ladder(result), _fleets(result), _model(result), f"targets missed: {verdict}")


def _millimetres(row: Row) -> str:
    sigma = "-" if row["sigma_mm"] is None else f"{row['sigma_mm']:.1f}"
    return sigma if row["accepted"] > 0.99 else f"{sigma} ({100 * row['accepted']:.0f} %)"


def _ladder(result: Result) -> Table:
    rows = [row for row in result.cases if row["distance_m"] is not None]
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    shown = Table(
        title="Sigma of the range, mm, and how many sweeps have a peak; neighbours' lamps 0.6 m from the ball"
    )
    for column in ("water", "distance", *policies):
        shown.add_column(column, justify="left" if column == "water" else "right")
    for water, distance_m in dict.fromkeys((row["water"], row["distance_m"]) for row in rows):
        of = {row["policy"]: row for row in rows if (row["water"], row["distance_m"]) == (water, distance_m)}
        shown.add_row(water, f"{distance_m:.2f} m", *(_millimetres(of[policy]) for policy in policies))
    return shown


def _fleets(result: Result) -> Table:
    rows = [row for row in result.cases if row["distance_m"] is None]
    kinds = list(dict.fromkeys((row["policy"], row["loss"]) for row in rows))
    shown = Table(title=f"Robots with a usable range, {result.scenes} fleets of each size at random places, in turn")
    shown.add_column("water")
    shown.add_column("robots", justify="right")
    for policy, loss in kinds:
        shown.add_column(policy + (f", {100 * loss:.0f} % lost" if loss else ""), justify="right")
    for water, robots in dict.fromkeys((row["water"], row["robots"]) for row in rows):
        of = {(row["policy"], row["loss"]): row for row in rows if (row["water"], row["robots"]) == (water, robots)}
        shown.add_row(water, str(robots), *(f"{100 * of[kind]['usable_share']:.0f} %" for kind in kinds))
    return shown


def _model(result: Result) -> Table:
    model = result.model
    shown = Table(title="The models, worst of 4 geometries in each water against Monte Carlo")
    for column in ("", "kernel", "twin"):
        shown.add_column(column, justify="left" if not column else "right")
    for label, key in (("veil, one order", "veil_first_order"), ("veil, all orders", "veil_all_orders")):
        shown.add_row(label, f"{100 * model[key]:.1f} %", f"{100 * model['twin_' + key]:.1f} %")
    shown.add_row("one more lamp in a frame", "", f"{model['ms_per_lamp']:.1f} ms")
    for water, value in model["correlation"].items():
        shown.add_row(f"log J with log sigma, {water}", "-" if value is None else f"{value:.2f}", "")
    return shown


# --- figures ---


def figures(result: Result) -> Figures:
    """sigma.png: sigma over distance; usable.png: what fleets gain."""
    from matplotlib.figure import Figure

    ladder = [row for row in result.cases if row["distance_m"] is not None]
    waters = list(dict.fromkeys(row["water"] for row in ladder))
    drawn = Figure(figsize=(4 * len(waters), 3.4), layout="constrained")
    axes = drawn.subplots(1, len(waters), squeeze=False, sharey=True)[0]
    for ax, water in zip(axes, waters, strict=True):
        for policy in ("own", "all", "rule"):
            rows = [row for row in ladder if (row["water"], row["policy"]) == (water, policy) and row["sigma_mm"]]
            ax.semilogy([row["distance_m"] for row in rows], [row["sigma_mm"] for row in rows], "o-", label=policy)
        ax.set_title(water)
        ax.set_xlabel("camera to ball, m")
    axes[0].set_ylabel("sigma of the range (noise), mm")
    axes[0].legend()
    yield "sigma.png", drawn

    fleets = [row for row in result.cases if row["distance_m"] is None]
    drawn = Figure(figsize=(4 * len(waters), 3.4), layout="constrained")
    axes = drawn.subplots(1, len(waters), squeeze=False, sharey=True)[0]
    for ax, water in zip(axes, waters, strict=True):
        for policy, loss in dict.fromkeys((row["policy"], row["loss"]) for row in fleets):
            rows = [row for row in fleets if (row["water"], row["policy"], row["loss"]) == (water, policy, loss)]
            label = policy + (f", {100 * loss:.0f} % lost" if loss else "")
            ax.plot([row["robots"] for row in rows], [100 * row["usable_share"] for row in rows], "o-", label=label)
        ax.set_title(water)
        ax.set_xlabel("robots")
    axes[0].set_ylabel("with a usable range, %")
    axes[-1].legend()
    yield "usable.png", drawn
