"""Three robots in a dark tank that find a ball by each other's light, and three that lend nobody theirs."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from msgspec.structs import replace

from agent.core.config import Fleet
from agent.demo.summary import PASS_PERCENT
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from hw.twin.scene import scene_of
from tests.bench.light.lockstep import calibrated, night

CASES = {"night": ("night", 0.0), "night-loss30": ("night", 0.3), "night-alone": ("night_alone", 0.0)}
ALL_PERCENT = 95.0  # of the dives have to be right


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    limit_s: float = 120.0  # of a dive's own clock
    whole: bool = False  # go on to the limit when all have settled


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """One dive."""
    name, loss = CASES[case]
    fleet = seeded(name, seed)
    far_mm = 1e3 * math.hypot(*scene_of(fleet).solid[0].position_m)
    calibrations = {robot: calibrated(fleet, robot) for robot in fleet.robot}
    settled_s, robots = night(fleet, calibrations, settings.limit_s, loss, settings.whole)
    errors_mm = [row["error_mm"] for row in robots]
    worst = None if None in errors_mm else 100.0 * max(errors_mm) / far_mm
    return [{"settled_s": settled_s, "worst_percent": worst, "robots": robots}]


def seeded(name: str, seed: int) -> Fleet:
    fleet = load_fleet(fleet_file(name))
    return replace(fleet, twin=replace(fleet.twin, seed=seed))


def summary(rows: Rows) -> dict[str, Value]:
    """NEES and NIS are means of the robots that have an estimate, and sweeps of their own."""
    found: dict[str, Value] = {}
    for case, dives in rows.items():
        robots = [robot for dive in dives for robot in dive["robots"]]
        worst = [dive["worst_percent"] for dive in dives]
        right = [percent is not None and percent < PASS_PERCENT for percent in worst]
        seen = [[robot["first_s"] for robot in dive["robots"]] for dive in dives]
        kept = sum(robot["kept"] for robot in robots)
        of = {
            "worst": Quantile(worst, 50.0),
            "right": Share(sum(right), len(right)),
            "seen": Quantile([None if None in each else max(each) for each in seen], 50.0),
            "settled": Quantile([dive["settled_s"] for dive in dives], 50.0),
            "nees": mean([robot["nees"] for robot in robots]),
            "nis": mean([robot["nis"] for robot in robots]),
            "steady": Share(sum(robot["epochs"] == 0 for robot in robots), len(robots)),
            "kept": Share(kept, kept + sum(robot["rejected"] for robot in robots)),
            "lent": Share(sum(robot["by_lent"] for robot in robots), kept),
        }
        found |= {f"{case}_{key}": value for key, value in of.items()}
    return found


def mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def figures(case: str, words: str) -> tuple[Figure, ...]:
    """Those of a fleet that lends."""
    return (
        Figure(f"{case}_worst", f"{words}: error of the worst robot, of its distance, median", "%", most=PASS_PERCENT),
        Figure(f"{case}_right", f"all robots are within {PASS_PERCENT} %", "%", least=ALL_PERCENT),
        Figure(f"{case}_seen", "the ball has been in a frame of each robot after, median", "s"),
        Figure(f"{case}_settled", "all have settled after, median", "s"),
        Figure(f"{case}_nees", "error as they say at the end: mean NEES, 3 where it is honest"),
        Figure(f"{case}_nis", "sweeps against those before: mean NIS, 3 where they scatter as they say"),
        Figure(f"{case}_steady", "robots that never take the ball to move", "%"),
        Figure(f"{case}_kept", "sweeps that gave a place", "%"),
        Figure(f"{case}_lent", "of them, by another's lamp", "%"),
    )


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"limit_s": 6.0},
    cases=tuple(CASES),
    measured_on="twin",
    figures=(
        *figures("night", "three robots that lend"),
        *figures("night-loss30", "the same, 30 % of messages lost"),
        Figure("night-alone_right", f"robots that lend nobody: all are within {PASS_PERCENT} %", "%"),
        Figure("night-alone_kept", "their sweeps that gave a place", "%"),
    ),
    explanation="""Three robots with lamps in a dark tank of harbour water find and measure a ball that no own lamp
        shows. Pictures are rendered, firmware, vision and kernels are the real ones, and a dive ends when all have
        settled or time is up. Each seed draws another world: bodies, lenses, lamps and the sensors' noise. A robot
        without an estimate is wrong without limit.""",
)
