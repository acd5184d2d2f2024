"""What an outside judge found: one quantity, by the twin and by the judge."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?")


@dataclass(frozen=True)
class Finding:
    COLUMNS: ClassVar = ("quantity", "cases", "twin", "judge", "by")
    quantity: str  # "edge spread, 30 mm before focus"
    judge: str  # "Mitsuba 3.9.1"
    twin: float
    outside: float
    unit: str
    allowed: float  # of the outside figure, as a share; or absolute where `absolute`
    absolute: bool = False

    @property
    def off(self) -> float:
        """How far apart they are; 1 is what is allowed."""
        return abs(self.twin - self.outside) / (self.allowed if self.absolute else self.allowed * abs(self.outside))

    @property
    def passes(self) -> bool:
        return self.off <= 1.0

    @property
    def kind(self) -> tuple[str, ...]:
        """Alike for the cases of one quantity, by numbers and judges; each that fails is of a kind of its own."""
        return (NUMBER.sub("#", self.quantity), self.unit) if self.passes else (self.quantity, self.unit, self.judge)


def rows(found: Iterable[Finding]) -> list[tuple[str, ...]]:
    """One of each kind: the case that lies farthest apart. What the judge says otherwise is bold."""
    kinds: dict[tuple[str, ...], list[Finding]] = {}
    for one in found:
        kinds.setdefault(one.kind, []).append(one)
    return [_row(cases) for cases in kinds.values()]


def _row(cases: list[Finding]) -> tuple[str, ...]:
    worst = max(cases, key=lambda one: one.off)
    numbers = zip(*(NUMBER.findall(one.quantity) for one in cases), strict=True)
    spans = iter([_span(sorted(set(each), key=float)) for each in numbers])
    what = NUMBER.sub(lambda _: next(spans), cases[0].quantity)
    theirs = f"{worst.outside:.4g}" if worst.passes else f"**{worst.outside:.4g}**"
    named = f"{what}, {worst.unit}" if worst.unit else what
    judges = ", ".join(dict.fromkeys(one.judge for one in cases))
    return named, str(len(cases)), f"{worst.twin:.4g}", theirs, judges


def _span(numbers: list[str]) -> str:
    return numbers[0] if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
