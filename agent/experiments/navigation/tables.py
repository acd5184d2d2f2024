"""Figures beside their bars, fixes against blur and distance, and the spread over seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from rich.console import Group
from rich.table import Table

from agent.experiments.navigation.bars import BARS, met
from agent.experiments.navigation.run import ENOUGH, Result
from agent.experiments.navigation.summaries import AIDED
from agent.experiments.result import Row
from agent.experiments.spread import number_or_never, rms, spread

BLURS_PX = (0.0, 2.0, 6.0, math.inf)  # diameters of the disc
DISTANCES_M = (0.0, 0.5, 0.8, math.inf)
SPREAD = (  # of draws: name, key, heading
    ("hold", "rms_mm", "hold, rms mm"),
    ("hold", "yaw_rms_deg", "hold, yaw rms deg"),
    ("goto", "s", "goto, s"),
    ("goto", "overshoot_mm", "goto, overshoot mm"),
    ("turn", "s", "turn, s"),
    ("orbit", "rms_mm", "orbit, rms mm"),
    ("orbit with gaps", "rms_mm", "orbit with gaps, rms mm"),
    ("follow", "off_mm", "follow, off its distance, rms mm"),
    ("follow", "gap_deg", "follow, off an even angle, rms deg"),
    ("search", "s", "search, three robots, s"),
    ("search alone", "s", "search, one robot, s"),
)


def table(result: Result) -> Group:
    """All of them, and the verdict."""
    draws = result.shown.draws
    parts: list[Table | str] = [bars_table(result)]
    parts += [fixes_table(draws["fix"])] if draws.get("fix") else []
    parts += [spread_table(draws)] if any(name in draws for name, *_ in SPREAD) else []
    parts += [crossing_line(draws["separation"])] if draws.get("separation") else []
    parts += [target_line(draws["target"])] if draws.get("target") else []
    parts += [aid_table(draws)] if draws.get("aid") else []
    parts += [f"missed: {', '.join(result.missed)}"] if result.missed else []
    parts += [f"no verdict: the bars are for {ENOUGH} seeds"] if result.missed is None else []
    return Group(*parts)


def bars_table(result: Result) -> Table:
    """A line for each figure of result.json that was measured."""
    shown = Table(title="robots that swim (twin; no water was involved)")
    for head in ("what", "body", "measured", "bar", "met"):
        shown.add_column(head, justify="left" if head in ("what", "body") else "right")
    for bar in BARS:
        figures = getattr(result, bar.case)
        if bar.key not in figures:
            continue
        value, answer = figures[bar.key], met(bar, figures)
        measured = "none" if value is None else f"{value:.2f} {bar.unit}".rstrip()
        shown.add_row(bar.words, bar.body, measured, bar.asked, "-" if answer is None else "yes" if answer else "no")
    return shown


def fixes_table(rows: Sequence[Row]) -> Table:
    """A line for each band of blur and distance in which there was a fix; frames without any tag are counted above."""
    seen = [row for row in rows if row["tags"]]
    shown = Table(title=f"fixes of rendered frames: {len(seen)} of {len(rows)} show tags")
    for head in ("blur px", "distance m", "frames", "fixes", "median mm", "90 % mm", "90 % deg", "NEES/3"):
        shown.add_column(head, justify="right")
    bands: list[tuple[float, float] | None] = [*pairwise(BLURS_PX), None]  # None: no edge was fitted, nobody knows
    for blurs, ways in ((b, d) for b in bands for d in pairwise(DISTANCES_M)):
        within = [r for r in seen if _blurred(r["blur_px"], blurs) and _in(r["distance_m"], ways)]
        good = [row for row in within if "nees" in row]
        if not good:
            continue
        mm, deg = ([row[key] for row in good] for key in ("error_mm", "error_deg"))
        figures = (np.median(mm), np.percentile(mm, 90), np.percentile(deg, 90), np.mean([r["nees"] for r in good]))
        named = "rough" if blurs is None else _band(blurs), _band(ways)
        shown.add_row(*named, str(len(within)), str(len(good)), *(f"{value:.2f}" for value in figures))
    return shown


def spread_table(draws: dict[str, list[Row]]) -> Table:
    """Median, 95 % and worst of the seeds."""
    shown = Table(title="over the seeds")
    for head in ("what", "seeds", "median", "95 %", "never"):
        shown.add_column(head, justify="left" if head == "what" else "right")
    for name, key, words in SPREAD:
        if name in draws:
            values = [row[key] for row in draws[name]]
            found = spread([None if value is None or not math.isfinite(value) else value for value in values])
            middle, p95 = number_or_never(found["median"]), number_or_never(found["p95"])
            shown.add_row(words, str(len(values)), middle, p95, str(found["never"]))
    return shown


def crossing_line(rows: Sequence[Row]) -> str:
    arrived = np.mean([row["arrived"] for row in rows])
    return f"separation: {rows[0]['robots']} robots, {arrived:.0%} were within 5 cm of where they should be at the end"


def target_line(rows: Sequence[Row]) -> str:
    bound_mm, nees = np.sqrt(np.mean([r["bound_mm"] ** 2 for r in rows])), np.mean([r["bound_nees"] for r in rows])
    samples = np.mean([row["samples"] for row in rows])
    return f"target: {samples:.1f} samples a run; the bound is off by {bound_mm:.1f} mm rms, its NEES/3 is {nees:.2f}"


def aid_table(draws: dict[str, list[Row]]) -> Table:
    """A line for each filter: rms error of each robot's place, mm, and of the ball's."""
    shown = Table(title="tags at 5 Hz (r1), 2 s of every 4 s (r2), once in 4 s (r3), once in 6 s (r4)")
    for head in ("", "pose", "r1", "r2", "r3", "r4", "ball mm", "NEES/3"):
        shown.add_column(head, justify="left" if head in ("", "pose") else "right")
    for name in AIDED:
        rows = draws[name]
        for key, words in (("own", "own"), ("aided", "aided"), ("joint", "joint filter, no gyro")):
            robots = [f"{rms(each):.1f}" for each in zip(*(row[f"{key}_mm"] for row in rows), strict=True)]
            if key == "own":
                known = np.mean([row["known"] for row in rows], axis=0)
                robots = [f"{mm} ({share:.0%})" for mm, share in zip(robots, known, strict=True)]
            nees = {"own": [r["target_nees"] for r in rows], "aided": [v for r in rows for v in r["nees"]]}.get(key)
            ball = {"own": "target_mm", "joint": "joint_target_mm"}.get(key)
            mm = f"{rms([row[ball] for row in rows]):.1f}" if ball else ""
            shown.add_row(name, words, *robots, mm, f"{np.mean(nees):.2f}" if nees else "")
    return shown


def _blurred(blur_px: float | None, band: tuple[float, float] | None) -> bool:
    if band is None or blur_px is None:
        return band is None and blur_px is None
    return _in(blur_px, band)


def _in(value: float, band: tuple[float, float]) -> bool:
    return band[0] <= value < band[1]


def _band(band: tuple[float, float]) -> str:
    return f"{band[0]:g} to {band[1]:g}" if math.isfinite(band[1]) else f"{band[0]:g} and more"
