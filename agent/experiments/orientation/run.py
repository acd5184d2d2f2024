"""`aucamp experiment orientation`: pushed and sent down, how soon is a robot level and at depth again?

The paper's two tests (Aucamp, arXiv 2506.09876, section 6) for each law of the firmware, on robots of the twin that
differ in mass, water, thrusters and sensors: a push of 8 N down at a corner for 0.3 s at 0.30 m, and a step of the
set-point from 0.22 to 0.41 m. Every law steers the same robots. All times are counted in the twin's truth.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from agent.experiments.figures_orientation import draw
from agent.experiments.manoeuvre import HOVER_S, PLACES_M, PUSH, STEP, Case, Flight, fly
from agent.experiments.result import make_room, write_result
from agent.experiments.settling import rms, score_push, score_step, spread
from agent.experiments.tables_orientation import controllers_table, number, stability_table
from agent.launch import run_folder, temporary_folder, with_bar
from hw.twin.scene import generator

Progress = Callable[[int, int], None]  # dives done, dives in all

LAWS = ("observer", "pid", "pi")
DEFAULT_LAW = LAWS[0]
LAGS_S = (0.10, 0.15)  # of thruster and ESC; the headline figures are those at the first
MASS_SPREAD = 0.20  # what a lab changes on a robot between two dives

# The default law, where its model is far off: mass and inertia, samples of delay, on the twin's spread of all else.
STABLE_MASSES, STABLE_DELAYS = (0.65, 1.4), (1, 2)

TARGETS = (  # for the default law at the first lag: where in its figures, limit
    ("push_recovery_s", "median", 1.0),
    ("push_recovery_s", "p95", 1.5),
    ("step_settle_s", "p95", 1.2),
    ("hover_depth_rms_mm", "", 1.0),
    ("hover_tilt_rms_deg", "", 0.2),
)


class Group(NamedTuple):
    """Cases that dive together."""

    world: int  # seed of the twin
    cases: list[Case]


class Flown(NamedTuple):
    case: Case
    push: Flight
    step: Flight


def run(seed: int, seeds: int, out: Path | None, console: Console) -> dict[str, Any]:
    """The verb: progress bar, table, where it went."""
    folder = run_folder(out)
    result = with_bar(console, "dives of up to five robots", lambda show: orientation(seed, seeds, folder, show))
    console.print(controllers_table(result))
    console.print(stability_table(result))
    for text in result["missed"]:
        console.print(f"{DEFAULT_LAW} misses: {text}")
    console.print(f"twin, firmware under {result['firmware']}, {seeds} seeds. Written to {folder}")
    return result


def orientation(
    seed: int,
    seeds: int,
    out: Path,
    progress: Progress,
    laws: Sequence[str] = LAWS,
    lags_s: Sequence[float] = LAGS_S,
) -> dict[str, Any]:
    """Fly all cases; writes result.json and the figures into `out` and returns the content of result.json.

    Raises ConfigError where `out` holds a result already, Failed where a robot of the twin does not arm.
    """
    make_room(out)
    interpreter = shutil.which("micropython", path=str(Path(sys.executable).parent)) or shutil.which("micropython")
    plain = [group for law in laws for lag_s in lags_s for group in groups(seed, seeds, law, lag_s)]
    strange = [
        group
        for mass_scale in STABLE_MASSES
        for delay_samples in STABLE_DELAYS
        for group in groups(seed, min(seeds, len(PLACES_M)), DEFAULT_LAW, LAGS_S[0], mass_scale, delay_samples)
    ]
    rows: list[dict[str, Any]] = []
    shown: dict[str, Flown] = {}  # each law's first robot, at the first lag
    progress(0, len(plain) + len(strange))
    for done, group in enumerate((*plain, *strange), start=1):
        for flown in dive(group, interpreter or sys.executable):
            rows.append(score(*flown))
            shown.setdefault(flown.case.law, flown)
        progress(done, len(plain) + len(strange))

    ordinary = sum(len(group.cases) for group in plain)
    by_lag = {
        f"{lag_s:.2f}": {
            law: sum_up(r for r in rows[:ordinary] if (r["law"], r["lag_s"]) == (law, lag_s)) for law in laws
        }
        for lag_s in lags_s
    }
    first = by_lag[f"{lags_s[0]:.2f}"]
    result = {
        "schema": 1,
        "source": "twin",
        "seed": seed,
        "seeds": seeds,
        "firmware": "MicroPython" if interpreter else "CPython",
        "controllers": first,
        "controllers_lag_s": lags_s[0],
        "by_lag_s": by_lag,
        "stability": sum_up_stability(rows[ordinary:]),
        "missed": missed(first[DEFAULT_LAW]),
        "cases": rows,
    }
    write_result(out, result)
    draw({law: flown.push for law, flown in shown.items()}, PUSH, out / "orientation_push")
    draw({law: flown.step for law, flown in shown.items()}, STEP, out / "orientation_step")
    return result


def dive(group: Group, interpreter: str) -> list[Flown]:
    """Both manoeuvres, each from a fresh boot."""
    with temporary_folder() as folder:
        pushed = fly(group.cases, PUSH, group.world, folder, interpreter)
    with temporary_folder() as folder:
        stepped = fly(group.cases, STEP, group.world, folder, interpreter)
    return [Flown(*one) for one in zip(group.cases, pushed, stepped, strict=True)]


def groups(
    seed: int, seeds: int, law: str, lag_s: float, mass_scale: float | None = None, delay_samples: int = 1
) -> Iterator[Group]:
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
        yield Group(1000 * seed + first // len(PLACES_M), cases)


def score(case: Case, push: Flight, step: Flight) -> dict[str, Any]:
    """One row of result.json's cases."""
    return {
        **case._asdict(),
        **score_push(push.track, PUSH.goal_m, HOVER_S),
        **score_step(step.track, STEP.start_m, STEP.goal_m),
        "deepest_m": max(float(push.track.depth_m.max()), float(step.track.depth_m.max())),
        "failsafe": max(push.failsafe, step.failsafe),
        "disarmed": push.disarmed or step.disarmed,
    }


def sum_up(cases: Iterable[dict[str, Any]]) -> dict[str, Any]:
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


def sum_up_stability(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One line for each mass and delay; stable: every robot came to rest after the push and after the step."""
    lines = []
    for mass_scale in STABLE_MASSES:
        for delay in STABLE_DELAYS:
            figures = sum_up(r for r in rows if (r["mass_scale"], r["delay_samples"]) == (mass_scale, delay))
            never = figures["push_recovery_s"]["never"] + figures["step_settle_s"]["never"]
            condition = {"law": DEFAULT_LAW, "lag_s": LAGS_S[0], "mass_scale": mass_scale, "delay_samples": delay}
            lines.append({**condition, **figures, "stable": never == 0})
    return lines


def missed(figures: dict[str, Any]) -> list[str]:
    """Targets that a law with these figures does not reach; no value counts as one that is too large."""
    found = []
    for key, part, limit in TARGETS:
        value = figures[key][part] if part else figures[key]
        if value is None or value > limit:
            found.append(f"{' '.join((key, part)).strip()} {number(value)}, target {limit}")
    return found
