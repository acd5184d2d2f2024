"""A claim that costs nothing, to test the runner with: `python -m tests.experiments.dice FOLDER [SECONDS]`."""

import signal
import sys
import time
from pathlib import Path

import msgspec
import numpy as np

from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value, measure
from agent.experiments.registry import Entry, code_hash
from agent.experiments.results import result_of, run_of, write_result
from agent.experiments.run_claim import Plan, run_plan
from agent.process.command import Failed


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    sides: int = 6
    seconds: float = 0.0  # that a throw takes
    colours: tuple[str, ...] = ("white",)


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    if settings.sides < 1:
        raise Failed("a die has sides")
    time.sleep(settings.seconds)
    rng = np.random.default_rng((seed, len(case)))
    return [{"eyes": float(rng.integers(1, settings.sides + 1)), "share": float(rng.random())} for _ in range(3)]


def summary(rows: Rows) -> dict[str, Value]:
    found: dict[str, Value] = {}
    if "one" in rows:
        eyes = [row["eyes"] for row in rows["one"]]
        found |= {"mean": float(np.mean(eyes)), "six": Share(sum(each == 6.0 for each in eyes), len(eyes))}
        found["most"] = Quantile(eyes, 95.0)
    if "another" in rows:
        found["other"] = float(np.mean([row["share"] for row in rows["another"]]))
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=("one", "another"),
    quick={"sides": 2},
    measured_on="model",
    figures=(
        Figure("mean", "mean of the eyes", "", least=3.0, most=4.0),
        Figure("six", "sixes", "%", most=50.0),
        Figure("most", "95 % of throws", "", most=6.0),
        Figure("other", "mean of the others", "", least=0.9),
    ),
    explanation="A die is thrown.",
)
ENTRY = Entry("tests.experiments.dice", "a die", "Chance")


def plan(seeds: int = 40, seconds: float = 0.0, code: str | None = None) -> Plan:
    return Plan("dice", ENTRY, code or code_hash(ENTRY.module), Settings(seconds=seconds), CLAIM.cases, range(seeds))


def throw(folder: Path, seconds: float = 0.0, jobs: int | None = 2, scheduler: str | None = None) -> None:
    asked = plan(seconds=seconds)
    found = run_plan(asked, folder, jobs, scheduler, lambda done, total: None, CLAIM)
    result = result_of(asked, CLAIM, measure(CLAIM, found.rows))
    write_result(result, run_of(asked, "dice", found.seconds_a_seed, False), folder)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what a shell runs in the background ignores it
    throw(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 0.0)
