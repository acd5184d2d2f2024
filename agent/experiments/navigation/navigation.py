"""Where is a robot that swims, how well does it know, and does it do what it is told?

Each case is run for many seeds, and a seed is a world of its own: another body, lens, survey and pull. Fixes are made
of rendered frames; everything else is swum in closed loop with the kernel's agents, on the twin's bodies under the
board's own firmware, or on planar ones where there are many, and with tags drawn instead of rendered.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple, get_args

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Group
from rich.table import Table

from agent.experiments.experiment import (
    ExperimentResult,
    Figures,
    NavigationCase,
    Row,
    Task,
    all_draws,
    number_or_never,
    rms,
    spread,
)
from agent.experiments.navigation.around_ball import AID_S as AID_S
from agent.experiments.navigation.around_ball import CROSSING_ROBOTS, CROSSING_S, aided, ball, crossing
from agent.experiments.navigation.around_ball import SECONDS as TARGET_S
from agent.experiments.navigation.basin import TANK
from agent.experiments.navigation.manoeuvres import AIDED, PLACES, SUMMARIES, fixes, goto, hold, orbit, turn
from agent.experiments.navigation.pursuit import SEARCH_S, WATCH_S, follow, search
from agent.process.command import Progress

# --- targets: limits of the figures in result.json ---


class Bar(NamedTuple):
    """A figure of result.json, `case` and `key`, and where it has to lie; None: no limit."""

    case: str
    key: str
    unit: str
    least: float | None
    most: float | None
    body: str  # what swam: "rendered" frames of robots at rest, the "twin's body", or a "planar" one
    words: str

    @property
    def asked(self) -> str:
        if self.least is None:
            return "-" if self.most is None else f"<= {self.most:g}"
        return f">= {self.least:g}" if self.most is None else f"{self.least:g} to {self.most:g}"


RENDERED, TWIN, PLANAR = "rendered", "twin's body", "planar"

BARS = (
    Bar("fix", "p90_mm", "mm", None, 5.0, RENDERED, "fix from one frame, 90 %"),
    Bar("fix", "p90_deg", "deg", None, 0.25, RENDERED, "its yaw, 90 %"),
    Bar("fix", "nees", "", 0.8, 1.3, RENDERED, "its error as it says, NEES/3"),
    Bar("hold", "rms_mm", "mm", None, 6.0, TWIN, "hold, the tether pulls by 0.05 N rms"),
    Bar("hold", "yaw_rms_deg", "deg", None, 0.7, TWIN, "its yaw"),
    Bar("goto", "s", "s", None, 5.0, TWIN, "goto 0.5 m, within 20 mm, 95 %"),
    Bar("goto", "overshoot_mm", "mm", None, 30.0, TWIN, "its overshoot, 95 %"),
    Bar("turn", "s", "s", None, 3.0, TWIN, "turn by 90 deg, within 3 deg, 95 %"),
    Bar("orbit", "rms_mm", "mm", None, None, TWIN, "orbit at 0.1 m/s"),
    Bar("orbit", "gap_rms_mm", "mm", None, 8.0, TWIN, "the same, 2 s without tags in every 4"),
    Bar("separation", "least_m", "m", 0.34, None, PLANAR, "robots cross, least distance"),
    Bar("target", "ratio_to_bound", "", None, 1.2, TWIN, "the ball's place, three robots, to the bound"),
    Bar("target", "nees", "", 0.7, 1.3, TWIN, "its error as they say, NEES/3"),
    Bar("aid", "own_mm", "mm", None, None, PLANAR, "robots that rarely see tags, own pose, rms"),
    Bar("aid", "aided_mm", "mm", None, None, PLANAR, "the same, aided by the ball"),
    Bar("aid", "nees", "", None, 1.3, PLANAR, "the aided pose's error as it says, NEES/3"),
    Bar("follow", "rms_mm", "mm", None, None, TWIN, "three follow a target they are told of, its distance less 0.7 m"),
    Bar("follow", "gap_deg", "deg", None, None, TWIN, "their angle to each other around it, less 120 deg"),
    Bar("follow", "least_m", "m", 0.34, None, TWIN, "the same, least distance of two robots"),
    Bar("search", "s", "s", None, None, PLANAR, "a ball nobody sees at first is measured, three robots, 95 %"),
    Bar("search", "alone_s", "s", None, None, PLANAR, "the same, one robot"),
    Bar("search", "least_m", "m", 0.34, None, PLANAR, "three search, least distance of two"),
)


def met(bar: Bar, figures: Row) -> bool | None:
    """Whether a case's figures meet it; None: there is no limit, or the case was not run. No number misses it."""
    if bar.key not in figures or (bar.least is None and bar.most is None):
        return None
    value = figures[bar.key]
    return value is not None and (bar.least is None or value >= bar.least) and (bar.most is None or value <= bar.most)


# --- the experiment ---

ENOUGH = 20  # seeds
WORLDS = 1000  # of one --seed
CASES: tuple[NavigationCase, ...] = get_args(NavigationCase)


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # the first of the worlds
    seeds: int = ENOUGH
    quick: bool = False  # one seed, and of that little
    only: NavigationCase | None = None  # this case; none: all


class Result(ExperimentResult, frozen=True, kw_only=True):
    """The figures of each case, empty where it was not run; BARS says which they are, and what they have to be.

    shown: rows of each draw by name ("orbit", "orbit with gaps", ...), with their paths.
    """

    fix: Row
    hold: Row
    goto: Row
    turn: Row
    orbit: Row
    separation: Row
    target: Row
    aid: Row
    follow: Row
    search: Row
    shown: Shown

    @property
    def missed(self) -> list[str] | None:
        """Targets that are not met; None: too few seeds to tell."""
        if not self.shown.verdict:
            return None
        return [f"{bar.case} {bar.key}" for bar in BARS if met(bar, getattr(self, bar.case)) is False]

    @property
    def failed(self) -> bool:
        return bool(self.missed)


class Shown(NamedTuple):
    """Beside result.json."""

    draws: dict[str, list[Row]]
    verdict: bool  # seeds enough for one


class Draws(NamedTuple):
    """What is run for each seed, and for whose figures; cost: CPU seconds of a seed, about."""

    name: str
    case: NavigationCase
    draw: Callable[[int], Row | list[Row]]
    cost: int


def run(settings: Settings, progress: Progress) -> Result:
    """Run all cases on all processors; progress counts seconds of work. Raises Failed where a firmware hangs."""
    seeds = 1 if settings.quick else settings.seeds
    chosen = [one for one in all_cases(settings.quick) if settings.only in (None, one.case)]
    first = WORLDS * settings.seed
    found = all_draws([Task(partial(worlds, one.draw, first), seeds, one.cost, 1) for one in chosen], progress)
    draws = {one.name: rows for one, rows in zip(chosen, found, strict=True)}
    figures = {case: SUMMARIES[case](draws) if settings.only in (None, case) else {} for case in CASES}
    return Result(**figures, shown=Shown(draws, not settings.quick and seeds >= ENOUGH))


def all_cases(quick: bool) -> Sequence[Draws]:
    places, robots, seconds, aid_s = (3, 4, 10.0, 12.0) if quick else (PLACES, CROSSING_ROBOTS, CROSSING_S, AID_S)
    watch_s, search_s = (10.0, 30.0) if quick else (WATCH_S, SEARCH_S)
    return (
        Draws("fix", "fix", partial(fixes, places=places), 8),
        Draws("hold", "hold", hold, 3),
        Draws("goto", "goto", goto, 1),
        Draws("turn", "turn", turn, 1),
        Draws("orbit", "orbit", orbit, 3),
        Draws("orbit with gaps", "orbit", partial(orbit, gaps=True), 3),
        Draws("separation", "separation", partial(crossing, robots=robots, seconds=seconds), 14),
        Draws("target", "target", partial(ball, seconds=15.0 if quick else TARGET_S), 11),
        Draws("aid", "aid", partial(aided, seconds=aid_s), 3),
        Draws("aid with gyro", "aid", partial(aided, gyro=True, seconds=aid_s), 4),
        Draws("follow", "follow", partial(follow, watch_s=watch_s), 14),
        Draws("search", "search", partial(search, search_s=search_s), 8),
        Draws("search alone", "search", partial(search, robots=1, search_s=search_s), 3),
    )


def worlds(draw: Callable[[int], Row | list[Row]], world: int, first: int, last: int) -> list[Row]:
    """The draws of worlds from the first to the last, the latter excluded, counted from `world`."""
    found: list[Row] = []
    for k in range(first, last):
        rows = draw(world + k)
        found += rows if isinstance(rows, list) else [rows]
    return found


# --- tables ---

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
    """Figures beside their targets, fixes against blur and distance, the spread over seeds, and the verdict."""
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
    bands: list[tuple[float, float] | None] = [*pairwise(BLURS_PX), None]  # None: no edge was fitted
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


# --- figures: every seed a line ---

SWUM = ("hold", "goto", "turn", "orbit", "orbit with gaps")


def figures(result: Result) -> Figures:
    """Paths, fixes and one crossing, of what was run; each as SVG and PNG."""
    draws = result.shown.draws
    drawn = {}
    if swum := [name for name in SWUM if name in draws]:
        drawn["navigation_paths"] = paths(draws, swum)
    if fixed := [row for row in draws.get("fix", ()) if "nees" in row]:
        drawn["navigation_fixes"] = fixes_figure(fixed)
    if "separation" in draws:
        drawn["navigation_crossing"] = crossing_figure(min(draws["separation"], key=lambda row: row["least_m"]))
    for name, figure in drawn.items():
        for suffix in ("svg", "png"):
            yield f"{name}.{suffix}", figure


def paths(draws: dict[str, list[Row]], names: Sequence[str]) -> Figure:
    """True places from above, and true yaw from where each began, over time."""
    drawn = Figure(figsize=(3.4 * len(names), 6.0), dpi=120, layout="constrained")
    panels = drawn.subplots(2, len(names), squeeze=False)
    for column, name in enumerate(names):
        above, below = panels[:, column]
        above.set_title(name)
        for row in draws[name]:
            t, x, y, psi = row["path"].T
            above.plot(x, y, linewidth=0.7)
            below.plot(t, np.degrees(np.unwrap(psi)) - np.degrees(psi[0]), linewidth=0.7)
        basin(above)
        below.set(xlabel="s", ylabel="yaw, deg from the first" if column == 0 else "")
    drawn.suptitle("where robots truly swam (twin)")
    return drawn


def fixes_figure(rows: Sequence[Row]) -> Figure:
    """Error against blur and against distance."""
    drawn = Figure(figsize=(7.2, 3.4), dpi=120, layout="constrained")
    for panel, key, words in zip(
        drawn.subplots(1, 2, sharey=True), ("blur_px", "distance_m"), ("blur, px", "distance, m"), strict=True
    ):
        known = [row for row in rows if row[key] is not None]
        panel.scatter([row[key] for row in known], [row["error_mm"] for row in known], s=8, label="error")
        panel.scatter([row[key] for row in known], [row["sigma_mm"] for row in known], s=8, label="as it says, 1 sigma")
        panel.set(xlabel=words, yscale="log")
    drawn.axes[0].set(ylabel="place, mm")
    drawn.axes[0].legend(fontsize="small")
    drawn.suptitle("fixes from rendered frames (twin)")
    return drawn


def crossing_figure(row: Row) -> Figure:
    """The seed in which two came nearest."""
    drawn = Figure(figsize=(6.0, 4.2), dpi=120, layout="constrained")
    panel = drawn.subplots()
    for path in row["path"].transpose(1, 0, 2):
        panel.plot(path[:, 0], path[:, 1], linewidth=0.8)
        panel.plot(*path[-1], "o", markersize=4)
    basin(panel)
    panel.set_title(f"robots cross, least distance {row['least_m']:.2f} m (planar)")
    return drawn


def basin(panel: Axes) -> None:
    panel.set(xlim=(0.0, TANK.size_m[0]), ylim=(0.0, TANK.size_m[1]), aspect="equal")
