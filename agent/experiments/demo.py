"""Robots that find a target together, as `aucamp demo` has them: its own processes, over its own links, in the twin."""

from __future__ import annotations

import itertools
import math
import shutil
from collections.abc import Mapping, Sequence
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console

from agent.core.config import Protocol
from agent.demo.demo import demo
from agent.demo.summary import BARS, PASS_PERCENT
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value
from agent.process.command import temporary_folder

ALL_PERCENT = 95.0  # of the dives have to be right
WORST_MM = 45.0  # off a fish's track in as many

# --- one dive ---


class Dive(msgspec.Struct, frozen=True, kw_only=True):
    """What a user asks of `aucamp demo`, and what its figures are called by."""

    words: str
    fleet: str = "tank"
    protocol: Protocol | None = None
    loss: float | None = None
    lags: tuple[tuple[float, float], ...] = ()  # stamps late by, lens slow by, ms: one pair a seed, in turn
    stale: bool = False  # calibrated before that


LAGS = tuple(itertools.product((0.0, 60.0, 120.0), (50.0, 150.0, 300.0)))  # each is calibrated out, it is claimed
HARMFUL = tuple((late, slow) for late, slow in LAGS if late or slow >= 300.0)  # the others hide in what a frame waits
DIVES = {
    "tank": Dive(words="three robots"),
    "loss30": Dive(words="three, 30 % of messages lost", loss=0.3),
    "paper": Dive(words="three, the paper's protocol", protocol="paper"),
    "line": Dive(words="five in a line", fleet="line_of_five"),
    "fixed": Dive(words="three of fixed focus", fleet="fixed"),
    "swim": Dive(words="robots that swim", fleet="swim"),
    "late": Dive(words="late stamps and slow lenses", lags=LAGS),
    "stale": Dive(words="the same, calibrated before", lags=HARMFUL, stale=True),
    "box": Dive(words="a stone in a box", fleet="box_target"),
    "fish": Dive(words="a fish", fleet="fish"),
}
AT_BALL = ("tank", "loss30", "paper", "line", "fixed", "swim", "late")
TIMING = "camera timing"  # the fault that robots tell where sweeps contradict their calibration


OF_BALL = ("error_percent", "from_iteration", "prior_mm", "sigma_mm", "nees")


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    limit_s: float = 120.0  # of a dive's own clock, as `aucamp demo` has it
    keep: str | None = None  # a folder: recordings of dives that fail are copied there


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """One dive, as fast as the machine can. Raises Failed where one of its processes fails."""
    dive = DIVES[case]
    lag = dive.lags[seed % len(dive.lags)] if dive.lags else (0.0, 0.0)
    with temporary_folder() as folder:
        _, summary = demo(
            None,
            dive.protocol,
            dive.loss,
            seed,
            settings.limit_s,
            folder / "run",
            Console(file=StringIO(), markup=False, emoji=False),
            dive.fleet,
            speed=math.inf,
            faults=dict(zip(("stamp_late_ms", "lens_slow_ms"), lag, strict=True)) if dive.lags else None,
            stale=dive.stale,
        )
        if settings.keep is not None and summary["verdict"] != "pass":
            shutil.copytree(folder / "run", Path(settings.keep) / f"{case}-{seed}")
    (target,) = summary["targets"].values()
    judge = of_fish if case == "fish" else of_stone if case == "box" else of_ball
    doubted = any(row["verdict"] != "consistent" for row in target["agents"].values())
    told = sum(TIMING in row["faults"] for row in target["agents"].values())
    lags = {"late_ms": lag[0], "slow_ms": lag[1], "told": told} if dive.lags else {}
    return [{"passed": summary["verdict"] == "pass", "doubted": doubted, **lags, **judge(target)}]


# --- what its summary.json says of the target ---


def worst(rows: Mapping[Any, Row], key: str) -> float | None:
    """The largest of all robots; None: one has none."""
    values = [row[key] for row in rows.values()]
    return None if None in values else float(max(values))


def of_ball(target: dict[str, Any]) -> Row:
    rows = target["agents"]
    says = [(row["error_mm"], row["sigma_m"]) for row in rows.values()]
    sure = None if any(None in each for each in says) else [3.0 * (1e-3 * error / sigma) ** 2 for error, sigma in says]
    return {
        "error_percent": worst(rows, "relative_error_percent"),
        "from_iteration": worst(rows, "below_0_4_percent_from"),
        "prior_mm": worst(rows, "prior_rmse_mm"),
        "sigma_mm": None if sure is None else 1e3 * max(sigma for _, sigma in says),
        "nees": None if sure is None else max(sure),
    }


def of_stone(target: dict[str, Any]) -> Row:
    return {"outside_mm": worst(target["agents"], "outside_mm")}


def of_fish(target: dict[str, Any]) -> Row:
    return {key: target[key] for key in BARS}


# --- the claim ---


def summary(rows: Rows) -> dict[str, Value]:
    """Of each dive its worst robot counts: robots of one dive agree, so that each of them is no trial of its own."""
    found: dict[str, Value] = {}
    for case, dives in rows.items():
        median = partial(_median, dives)
        if case == "stale":
            found["stale_told"] = Share(sum(dive["told"] > 0 for dive in dives), len(dives))
            continue
        found[f"{case}_doubted"] = Share(sum(dive["doubted"] for dive in dives), len(dives))
        found[f"{case}_passed"] = Share(sum(dive["passed"] for dive in dives), len(dives))
        if case in AT_BALL:
            errors = [dive["error_percent"] for dive in dives]
            within = sum(error is not None and error < PASS_PERCENT for error in errors)
            found[f"{case}_within"] = Share(within, len(dives))
            found |= {f"{case}_{key}": median(key) for key in OF_BALL}
        elif case == "box":
            found["box_outside_mm"] = median("outside_mm")
        else:
            found |= {f"fish_{key}": median(key) for key in BARS}
            found["fish_worst_mm"] = Quantile([dive["track_rms_mm"] for dive in dives], ALL_PERCENT)
    return found


def _median(dives: Sequence[Row], key: str) -> Quantile:
    return Quantile([dive[key] for dive in dives], 50.0)


def _figures(case: str) -> tuple[Figure, ...]:
    def figure(key: str, words: str, unit: str = "", **limits: Any) -> Figure:
        return Figure(f"{case}_{key}", f"{DIVES[case].words}: {words}", unit, **limits)

    own: tuple[Figure, ...] = ()
    if case in AT_BALL:
        own = (
            figure("error_percent", "its worst robot's relative error, median", "%", most=0.4, paper="< 0.4 %"),
            figure("within", "dives in which all are within 0.4 %", "%", least=ALL_PERCENT),
            figure("from_iteration", "all stay below 0.4 % from iteration, median", paper="about 30"),
            figure("prior_mm", "its worst robot's own measurements off by, rms, median", "mm"),
            figure("sigma_mm", "what its most modest robot says of its error, median", "mm"),
            figure("nees", "its worst robot's 3 (error / sigma)², median", most=6.0),
        )
    elif case == "stale":
        told = "dives in which a robot says that its camera's timing is not as calibrated"
        return (figure("told", told, "%", least=ALL_PERCENT),)
    elif case == "box":
        own = (figure("outside_mm", "its worst robot's estimate outside of it, median", "mm"),)
    else:
        words = {
            "seen_by_one": "seen by one at least, share of the time",
            "seen_by_two": "by two",
            "seen_least": "by the one that sees it least",
            "track_rms_mm": "off its track, rms",
            "nees": "its error as robots say: NEES",
        }
        own = tuple(
            figure(key, f"{words[key]}, median", "mm" if key.endswith("mm") else "", least=least, most=most)
            for key, (least, most) in BARS.items()
        )
        own += (figure("worst_mm", "off its track, rms, 95 % of dives", "mm", most=WORST_MM),)
    return (
        *own,
        figure("doubted", "dives at whose end a robot says another word than `consistent`", "%"),
        figure("passed", "dives that pass their own verdict", "%", least=ALL_PERCENT),
    )


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"limit_s": 20.0},
    cases=tuple(DIVES),
    by_default=("tank", "loss30"),
    measured_on="twin",
    figures=tuple(figure for case in DIVES for figure in _figures(case)),
    seeds=60,  # as many as the 95 % take
    alone=True,  # it takes ports, and all cores
    explanation="""Each seed is one dive of `aucamp demo`: robots calibrate their cameras, then find the target and
        agree about it, as processes that talk over real links; water, cameras and bodies are the twin's. A dive ends
        when the robots have settled, or after two minutes of its own clock. What counts of a dive is its worst
        robot. In `fixed` cameras have a fixed focus. Of a ball whose radius is known
        that loses nothing: own measurements and sigma of `fixed` and of `tank` stand below. What is lost is the second
        cue, which tells of a wrong radius, and all range of a thing of unknown size: 0.6 m give or take 0.35 m is left
        of it, a bearing. In `late` and `stale` each seed takes the next pair of stamps late by 0, 60 or 120 ms and
        lenses that take 50, 150 or 300 ms to come to rest. Nine seeds have all.""",
)
