"""What a run of a claim found: on the disk as the run's folder has it, and kept in the repository for its pages.

`result.json` in the run's folder has the figures, `run.json` beside it when and where they were measured. A figure that
is kept lies in docs/research/results/CLAIM.json with both: its own seeds, date, commit, processor and command.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import msgspec

from agent.core.config import ConfigError
from agent.experiments.claim import Claim, Figure, Measured, verdict
from agent.experiments.run_claim import Plan, write_whole
from replay.files.mcap_file import environment

RESULT, RUN = "result.json", "run.json"
KEPT = Path("docs/research/results")

Number = float | Literal["inf", "-inf"]  # JSON has no infinity; float() reads both


class Told(msgspec.Struct, frozen=True, kw_only=True):
    """One figure, its interval, and where it had to lie."""

    key: str
    words: str
    unit: str
    value: Number
    low: Number
    high: Number
    n: int
    least: float | None
    most: float | None
    paper: str
    verdict: Literal["met", "missed", "not shown", ""]

    @property
    def measured(self) -> Measured:
        return Measured(float(self.value), float(self.low), float(self.high), self.n)

    @property
    def figure(self) -> Figure:
        return Figure(self.key, self.words, self.unit, self.least, self.most, self.paper)


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """result.json: pure, for the same seeds give the same bytes."""

    claim: str
    settings: dict[str, Any]
    cases: list[str]
    seeds: tuple[int, int]  # the first and the last
    figures: list[Told]


class Run(msgspec.Struct, frozen=True, kw_only=True):
    """run.json: when, where and of what."""

    date: str
    commit: str  # with a + where the files differed from it
    processor: str
    command: str
    code: str
    seconds_a_seed: float  # of one core
    quick: bool = False


class KeptFigure(msgspec.Struct, frozen=True, kw_only=True):
    """A figure with all that is to be known of it."""

    told: Told
    seeds: tuple[int, int]
    run: Run


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """docs/research/results/CLAIM.json."""

    claim: str
    figures: list[KeptFigure]


def tell(figure: Figure, measured: Measured) -> Told:
    value, low, high = (_number(one) for one in measured[:3])
    return Told(
        **figure._asdict(), value=value, low=low, high=high, n=measured.n, verdict=verdict(figure, measured)
    )  # fmt: skip


def result_of(plan: Plan, claim: Claim, measured: Mapping[str, Measured]) -> Result:
    return Result(
        claim=plan.name,
        settings=msgspec.to_builtins(plan.settings),
        cases=list(plan.cases),
        seeds=(plan.seeds[0], plan.seeds[-1]),
        figures=[tell(figure, measured[figure.key]) for figure in claim.figures if figure.key in measured],
    )


def write_result(result: Result, run: Run, folder: Path) -> None:
    write_whole(folder / RESULT, _text(result))
    write_whole(folder / RUN, _text(run))


def run_of(plan: Plan, command: str, seconds_a_seed: float, quick: bool, date: datetime | None = None) -> Run:
    about = environment()
    return Run(
        date=f"{date or datetime.now(UTC):%Y-%m-%d}",
        commit=about["commit"][:10] + ("+" if about["dirty"] == "yes" else ""),
        processor=about["cpu"],
        command=command,
        code=plan.code,
        seconds_a_seed=round(seconds_a_seed, 2),
        quick=quick,
    )


def keep(folders: Sequence[Path], into: Path = KEPT) -> list[str]:
    """Take the figures of these runs in the place of older ones; the names of their claims.

    Raises ConfigError for a folder without a finished run, and for a run in quick.
    """
    names = []
    for folder in folders:
        result, run = _read(folder / RESULT, Result), _read(folder / RUN, Run)
        if run.quick:
            raise ConfigError(f"{folder}: is a run of --quick, which gives no verdict; run it without")
        kept = {one.told.key: one for one in read_kept(result.claim, into)}
        kept |= {told.key: KeptFigure(told=told, seeds=result.seeds, run=run) for told in result.figures}
        write_kept(result.claim, list(kept.values()), into)
        names.append(result.claim)
    return names


def read_kept(name: str, into: Path = KEPT) -> list[KeptFigure]:
    """Empty where nothing was kept of it."""
    path = into / f"{name}.json"
    return _read(path, Kept).figures if path.exists() else []


def write_kept(name: str, figures: list[KeptFigure], into: Path = KEPT) -> None:
    into.mkdir(parents=True, exist_ok=True)
    write_whole(into / f"{name}.json", _text(Kept(claim=name, figures=figures)))


def judged_anew(claim: Claim, kept: Sequence[KeptFigure]) -> list[KeptFigure]:
    """By the claim's words and limits of today, in its order; figures that it no longer states are left out."""
    by_key = {one.told.key: one for one in kept}
    return [
        msgspec.structs.replace(by_key[figure.key], told=tell(figure, by_key[figure.key].told.measured))
        for figure in claim.figures
        if figure.key in by_key
    ]


def _read(path: Path, kind: type[Any]) -> Any:
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; give the folder of a run that has come to its end") from None
    except (OSError, msgspec.MsgspecError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}); give the folder of a run") from None


def _number(value: float) -> Number:
    return value if math.isfinite(value) else "inf" if value > 0 else "-inf"


def _text(struct: msgspec.Struct) -> str:
    return json.dumps(msgspec.to_builtins(struct), indent=1) + "\n"
