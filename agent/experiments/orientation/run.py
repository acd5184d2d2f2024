"""Pushed and sent down, how soon is a robot level and at depth again?

The paper's two tests (Aucamp, arXiv 2506.09876, section 6) for each law of the firmware, on robots of the twin that
differ in mass, water, thrusters and sensors: a push of 8 N down at a corner for 0.3 s at 0.30 m, and a step of the
set-point from 0.22 to 0.41 m. Every law steers the same robots. All times are counted in the twin's truth.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from agent.experiments.orientation.manoeuvre import HOVER_S, PLACES_M, PUSH, STEP, Case, Response, respond
from agent.experiments.orientation.settling import score_push, score_step
from agent.experiments.result import ExperimentResult, Row
from agent.experiments.spread import number_or_never, rms, spread
from agent.process.command import Progress, step_by_step, temporary_folder
from hw.twin.scene import generator

LAWS = ("observer", "pid", "pi")
DEFAULT_LAW = LAWS[0]
LAGS_S = (0.10, 0.15)  # of thruster and ESC; the headline figures are those at the first
MASS_SPREAD = 0.20  # what a lab changes on a robot between two dives

# The default law, where its model is far off: mass and inertia, samples of delay, on the twin's spread of all else.
STABLE_MASSES, STABLE_DELAYS = (0.65, 1.4), (1, 2)

ENOUGH = 20  # robots in each case: of fewer the slowest is what p95 says
TARGETS = (  # for the default law at the first lag: where in its figures, limit
    ("push_recovery_s", "median", 1.0),
    ("push_recovery_s", "p95", 1.5),
    ("step_settle_s", "p95", 1.2),
    ("hover_depth_rms_mm", "", 1.0),
    ("hover_tilt_rms_deg", "", 0.2),
)


class CaseGroup(NamedTuple):
    """Cases that dive together."""

    world: int  # seed of the twin
    cases: list[Case]


class Responses(NamedTuple):
    """One robot under one law, in both manoeuvres."""

    case: Case
    push: Response
    step: Response


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # of the robots
    seeds: int = ENOUGH  # robots in each case
    laws: tuple[str, ...] = LAWS
    lags_s: tuple[float, ...] = LAGS_S


class Result(ExperimentResult, frozen=True, kw_only=True):
    """Figures per law at each lag, of the default law on robots that it does not know, and a row for each robot.

    shown: each law's first robot, at the first lag.
    """

    schema: int = 1
    source: str = "twin"
    seed: int
    seeds: int
    firmware: str  # the interpreter that runs it
    controllers: dict[str, Row]  # by law, at the first lag
    controllers_lag_s: float
    by_lag_s: dict[str, dict[str, Row]]
    stability: list[Row]
    missed: list[str] | None  # None: too few robots to tell
    cases: list[Row]
    shown: dict[str, Responses]

    @property
    def failed(self) -> bool:
        return bool(self.missed)


def run(settings: Settings, progress: Progress) -> Result:
    """Dive with all cases; progress counts dives of up to five robots, push and step together.

    Raises Failed where a robot of the twin does not arm.
    """
    interpreter = shutil.which("micropython", path=str(Path(sys.executable).parent)) or shutil.which("micropython")
    seed, seeds, laws, lags_s = settings.seed, settings.seeds, settings.laws, settings.lags_s
    plain = [group for law in laws for lag_s in lags_s for group in groups(seed, seeds, law, lag_s)]
    strange = [
        group
        for mass_scale in STABLE_MASSES
        for delay_samples in STABLE_DELAYS
        for group in groups(seed, min(seeds, len(PLACES_M)), DEFAULT_LAW, LAGS_S[0], mass_scale, delay_samples)
    ]
    step = step_by_step(progress, len(plain) + len(strange))
    rows: list[Row] = []
    shown: dict[str, Responses] = {}
    for group in (*plain, *strange):
        for one in both_manoeuvres(group, interpreter or sys.executable):
            rows.append(score(*one))
            shown.setdefault(one.case.law, one)
        step()

    ordinary = sum(len(group.cases) for group in plain)
    by_lag = {
        f"{lag_s:.2f}": {
            law: summary(r for r in rows[:ordinary] if (r["law"], r["lag_s"]) == (law, lag_s)) for law in laws
        }
        for lag_s in lags_s
    }
    first = by_lag[f"{lags_s[0]:.2f}"]
    return Result(
        seed=seed,
        seeds=seeds,
        firmware="MicroPython" if interpreter else "CPython",
        controllers=first,
        controllers_lag_s=lags_s[0],
        by_lag_s=by_lag,
        stability=stability(rows[ordinary:]),
        missed=missed(first[DEFAULT_LAW]) if seeds >= ENOUGH else None,
        cases=rows,
        shown=shown,
    )


def both_manoeuvres(group: CaseGroup, interpreter: str) -> list[Responses]:
    """Push and step, each from a fresh boot."""
    with temporary_folder() as folder:
        pushed = respond(group.cases, PUSH, group.world, folder, interpreter)
    with temporary_folder() as folder:
        stepped = respond(group.cases, STEP, group.world, folder, interpreter)
    return [Responses(*one) for one in zip(group.cases, pushed, stepped, strict=True)]


def groups(
    seed: int, seeds: int, law: str, lag_s: float, mass_scale: float | None = None, delay_samples: int = 1
) -> Iterator[CaseGroup]:
    """The dives of all seeds. A seed is the same robot in every group: its world and its place are its own.

    Without a mass_scale the seeds share out the whole spread evenly, in an order of chance.
    """
    order = generator(seed, "orientation", "mass").permutation(seeds)
    scales = 1 + MASS_SPREAD * (2 * (order + 0.5) / seeds - 1)
    for first in range(0, seeds, len(PLACES_M)):
        cases = [
            Case(law, k, lag_s, float(scales[k]) if mass_scale is None else mass_scale, delay_samples)
            for k in range(first, min(first + len(PLACES_M), seeds))
        ]
        yield CaseGroup(1000 * seed + first // len(PLACES_M), cases)


def score(case: Case, push: Response, step: Response) -> Row:
    """One row of result.json's cases."""
    return {
        **case._asdict(),
        **score_push(push.track, PUSH.goal_m, HOVER_S),
        **score_step(step.track, STEP.start_m, STEP.goal_m),
        "deepest_m": max(float(push.track.depth_m.max()), float(step.track.depth_m.max())),
        "failsafe": max(push.failsafe, step.failsafe),
        "disarmed": push.disarmed or step.disarmed,
    }


def summary(cases: Iterable[Row]) -> Row:
    """A law's figures over its cases."""
    rows = list(cases)
    return {
        "cases": len(rows),
        "push_recovery_s": spread([r["recovery_s"] for r in rows]),
        "step_settle_s": spread([r["settle_s"] for r in rows]),
        "hover_depth_rms_mm": rms([r["hover_depth_rms_mm"] for r in rows]),
        "hover_tilt_rms_deg": rms([r["hover_tilt_rms_deg"] for r in rows]),
        "worst_push_tilt_deg": max(r["push_tilt_deg"] for r in rows),
        "worst_overshoot_mm": max(r["overshoot_mm"] for r in rows),
        "disarmed": sum(r["disarmed"] for r in rows),
    }


def stability(rows: Sequence[Row]) -> list[Row]:
    """One line for each mass and delay; stable: every robot came to rest after the push and after the step."""
    lines = []
    for mass_scale in STABLE_MASSES:
        for delay in STABLE_DELAYS:
            figures = summary(r for r in rows if (r["mass_scale"], r["delay_samples"]) == (mass_scale, delay))
            never = figures["push_recovery_s"]["never"] + figures["step_settle_s"]["never"]
            condition = {"law": DEFAULT_LAW, "lag_s": LAGS_S[0], "mass_scale": mass_scale, "delay_samples": delay}
            lines.append({**condition, **figures, "stable": never == 0})
    return lines


def missed(figures: Row) -> list[str]:
    """Targets that a law with these figures does not reach; no value counts as one that is too large."""
    found = []
    for key, part, limit in TARGETS:
        value = figures[key][part] if part else figures[key]
        if value is None or value > limit:
            found.append(f"{' '.join((key, part)).strip()} {number_or_never(value)}, target {limit}")
    return found
