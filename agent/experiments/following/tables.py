"""A line for each case, and three robots that share beside their bars."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table

from agent.experiments.following.bars import Bar, verdicts
from agent.experiments.following.run import ENOUGH, Result
from agent.experiments.result import Row

COLUMNS = (
    ("seen_by_one", "by one"),
    ("seen_by_two", "by two"),
    ("seen_each", "each"),
    ("known", "known"),
    ("rms_mm", "rms mm"),
    ("nees", "NEES"),
    ("reacquire_p95_s", "again s"),
    ("reacquire_any_side_p95_s", "any side s"),
    ("reacquire_alone_p95_s", "alone s"),
    ("least_m", "least m"),
)
COLUMN_SHARES = ("seen_by_one", "seen_by_two", "seen_each", "known")


def table(result: Result) -> Group:
    parts: list[Table | str] = [cases_table(result.cases)]
    if verdicts(result.cases):
        parts.append(bars_table(result.cases))
    if not result.shown.verdict:
        parts.append(f"no verdict: the bars are for {ENOUGH} seeds")
    return Group(*parts)


def cases_table(cases: list[Row]) -> Table:
    shown = Table(title="robots that follow a target that swims (twin's bodies, drawn frames; no water was involved)")
    for head in ("policy", "robots", "loss", "m/s", *(words for _, words in COLUMNS)):
        shown.add_column(head, justify="left" if head == "policy" else "right")
    for case in cases:
        named = case["policy"], str(case["robots"]), f"{case['loss']:.0%}", f"{case['speed_m_s']:.2f}"
        shown.add_row(*named, *(_figure(key, case[key]) for key, _ in COLUMNS))
    return shown


def bars_table(cases: list[Row]) -> Table:
    shown = Table(title="three robots that share")
    for head in ("what", "m/s", "loss", "measured", "bar", "met"):
        shown.add_column(head, justify="left" if head == "what" else "right")
    for bar, case, value, met in verdicts(cases):
        measured, where = (
            "none" if value is None else f"{value:.3g}",
            (f"{case['speed_m_s']:.2f}", f"{case['loss']:.0%}"),
        )
        shown.add_row(bar.words, *where, measured, _asked_text(bar), "yes" if met else "no")
    return shown


def _asked_text(bar: Bar) -> str:
    if bar.least is None:
        return f"<= {bar.most:g}"
    return f">= {bar.least:g}" if bar.most is None else f"{bar.least:g} to {bar.most:g}"


def _figure(key: str, value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.1%}" if key in COLUMN_SHARES else f"{value:.3g}"
