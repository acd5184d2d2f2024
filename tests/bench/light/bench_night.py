"""Three robots in a dark tank that find a ball by each other's light, and three that lend nobody theirs."""

from __future__ import annotations

import math
from random import Random
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.config import Fleet
from agent.core.linear_algebra import difference, inverse, quadratic
from agent.core.messages import Vector
from agent.core.step_io import Heard, Outputs
from agent.core.topics import LIGHT, NEAR
from agent.demo.demo import SETTLE_ITERATIONS, SETTLE_M, SETTLE_WINDOW
from agent.demo.summary import PASS_PERCENT, History, settled
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value
from agent.experiments.navigation.swimmers import frame_error_m
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from agent.robot.step import Agent
from hw.twin.dive import run_in_lock_step
from hw.twin.scene import scene_of
from tests.bench.lockstep import START_NS, divers_of

CASES = {"night": ("night", 0.0), "night-loss30": ("night", 0.3), "night-alone": ("night_alone", 0.0)}
ALL_PERCENT = 95.0  # of the dives have to be right


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    limit_s: float = 120.0  # of a dive's own clock


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """One dive."""
    name, loss = CASES[case]
    fleet = load_fleet(fleet_file(name))
    fleet = replace(fleet, twin=replace(fleet.twin, seed=seed))
    far_mm = 1e3 * math.hypot(*scene_of(fleet).solid[0].position_m)
    settled_s, robots = night(fleet, settings.limit_s, loss)
    errors_mm = [row["error_mm"] for row in robots]
    worst = None if None in errors_mm else 100.0 * max(errors_mm) / far_mm
    return [{"settled_s": settled_s, "worst_percent": worst, "robots": robots}]


def night(fleet: Fleet, seconds: float, loss: float) -> tuple[float | None, list[Row]]:
    """When all had settled, s, or None; and a row a robot."""
    truth_m, settled_s, random = scene_of(fleet).solid[0].position_m, None, Random(fleet.twin.seed)
    steps, histories = {name: list[Step]() for name in fleet.robot}, {name: History([]) for name in fleet.robot}
    with divers_of(fleet) as (dive, divers):
        while dive.now_ns - START_NS < seconds * 1e9 and settled_s is None:
            t_s, said = (dive.now_ns - START_NS) * 1e-9, {name: diver.tick() for name, diver in divers.items()}
            run_in_lock_step(dive, 1)
            for name, outputs in said.items():
                if outputs is None:
                    continue
                steps[name].append(Step(t_s, any(one.found for one in divers[name].sightings), outputs))
                if outputs.state is not None:
                    histories[name].states.append(outputs.state)
                for heard, to in letters(name, outputs, dive.now_ns):
                    if random.random() >= loss:
                        divers[to].post.append(heard)
            if dive.ticks % 100 == 0 and settled(list(histories.values()), SETTLE_ITERATIONS, SETTLE_WINDOW, SETTLE_M):
                settled_s = (dive.now_ns - START_NS) * 1e-9
    return settled_s, [row_of(name, fleet, diver.agent, steps[name], truth_m) for name, diver in divers.items()]


class Step(NamedTuple):
    """Of one robot."""

    t_s: float
    sees: bool
    outputs: Outputs


def row_of(name: str, fleet: Fleet, agent: Agent, steps: list[Step], truth_m: Vector) -> Row:
    """How it knows the ball, and how it came to. None: it has no estimate; nis: of its sweeps against those before, 3
    where they scatter as they say; epochs: that its estimate went through, of a ball at rest none; first_s: when the
    ball was in a frame of it for the first time; kept: sweeps that gave a place, some of them by another's lamp."""
    estimator, off_m, nees = agent.measuring.current.estimator, None, None
    if (believed := estimator.posterior) is not None:
        off = difference(believed.x_m, truth_m)
        weight = inverse(believed.cov_m2)
        off_m, of_frame_m = math.hypot(*off), difference(off, frame_error_m(fleet))
        nees = None if weight is None else quadratic(weight, of_frame_m)
    states = [step.outputs.state for step in steps if step.outputs.state is not None]
    nis = {state.t: state.explain.nis for state in states if state.explain}
    outcomes = [step.outputs.outcome for step in steps if step.outputs.outcome]
    kept = [outcome for outcome in outcomes if outcome.x_m is not None]
    return {
        "doubted": agent.measuring.current.consistency.verdict(round(steps[-1].t_s * 1e9) + START_NS)[0]
        != "consistent",
        "error_mm": None if off_m is None else 1e3 * off_m,
        "nees": nees,
        "nis": mean(list(nis.values())),
        "epochs": estimator.epoch.counter,
        "first_s": next((step.t_s for step in steps if step.sees), None),
        "kept": len(kept),
        "by_lent": sum(set(outcome.lamps or ()) != {name} for outcome in kept),
        "rejected": len(outcomes) - len(kept),
    }


def letters(src: str, outputs: Outputs, now_ns: int) -> list[tuple[Heard, str]]:
    """What a robot says, and to whom."""
    topics = (UNSET, outputs.says), ("light", outputs.said(LIGHT)), ("near", outputs.said(NEAR))
    return [
        (Heard(arrived_ns=now_ns, src=src, topic=topic, payload=encode(said)), said.dst)
        for topic, letters_of in topics
        for said in letters_of
    ]


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
            "doubted": Share(sum(any(robot["doubted"] for robot in dive["robots"]) for dive in dives), len(dives)),
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
        Figure(f"{case}_doubted", "dives at whose end a robot says another word than `consistent`", "%"),
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
