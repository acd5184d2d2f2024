"""Can robots follow a target that swims, and what does it help that they talk and that they swim?

Each case is dived for many seeds; a seed is a world of its own: bodies, gimbals, survey, pull, the target's way, weeds,
and words that are lost. Closed loop with the kernel's agents, on the twin's bodies under the board's own firmware, with
drawn frames.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np
from matplotlib.figure import Figure
from rich.console import Group
from rich.table import Table

from agent.core.config import ConfigError
from agent.experiments.experiment import ExperimentResult, Figures, FollowingPolicy, Row, Task, all_draws
from agent.experiments.following_dive import FLEET, WATCH_S, Case, Draw, all_cases, dive
from agent.experiments.navigation.basin import TANK
from agent.process.command import Progress

# --- figures of a case: which robots saw it, how well it was known, how soon a robot that lost it had it again ---

LOST_S = 0.4  # not seen for longer: lost, as the kernel has it (pursuit.LOST_NS)
FRAME_S = 0.1
ALONE_S = 0.4  # another saw it within that time before: it is not alone


class Again(NamedTuple):
    """One time that a robot lost it."""

    t_s: float  # when it was in sight again, or lost with nothing in between
    seconds: float  # from then until it was seen; as long as was watched, where it was not
    seen: bool  # at all
    by_others: bool  # others saw it then


def row_of(case: Case, draws: Sequence[Draw]) -> Row:
    """A row of result.json."""
    seen = {key: float(np.mean([share(draw)[key] for draw in draws])) for key in SHARES}
    error_m = np.concatenate([draw.error_m[draw.watched :].ravel() for draw in draws])
    nees = np.concatenate([draw.nees[draw.watched :].ravel() for draw in draws])
    again = [one for draw in draws for one in losses(draw)]
    round_about = [one for draw in draws for one in losses(draw, any_side=True)]
    told = case.robots > 1 and case.policy != "silent"
    with_others = [one for one in again if told and one.by_others]
    alone = [one for one in again if not (told and one.by_others)]
    return {
        **case._asdict(),
        **seen,
        "rms_mm": _number(1e3 * math.sqrt(np.nanmean(error_m**2)) if np.isfinite(error_m).any() else math.nan),
        "nees": _number(float(np.nanmean(nees)) if np.isfinite(nees).any() else math.nan),
        "reacquire_p95_s": p95(with_others if told else alone),
        "losses": len(with_others if told else alone),
        "reacquire_any_side_p95_s": p95([one for one in round_about if one.by_others or not told]),
        "reacquire_alone_p95_s": p95(alone),
        "losses_alone": len(alone),
        "known": float(np.mean(np.isfinite(error_m))),
        "least_m": min((least_m(draw) for draw in draws), default=math.inf) if case.robots > 1 else None,
    }


SHARES = ("seen_by_one", "seen_by_two", "seen_each")


def share(draw: Draw) -> Row:
    """Of the frames of the watch. seen_each leaves out what a covered camera would have seen; where only one robot is,
    so do the others."""
    sees, open_eyes = draw.sees[draw.watched :], ~draw.covered[draw.watched :]
    some = open_eyes.any(axis=1)
    at_once = sees.sum(axis=1)[some]
    return {
        "seen_by_one": float(np.mean(at_once >= 1)),
        "seen_by_two": float(np.mean(at_once >= 2)),
        "seen_each": float(np.mean(sees[open_eyes])),
    }


def losses(draw: Draw, any_side: bool = False) -> list[Again]:
    """Each time that a robot lost it in the watch, from when it was in sight and the camera not at landmarks. any_side:
    also where the gimbal does not reach, and the body has to turn first."""
    found = []
    for k in range(draw.sees.shape[1]):
        could = draw.in_sight[:, k] & ~draw.landmarks[:, k] & (draw.in_reach[:, k] | any_side)
        last, since = -math.inf, None
        for i, t_s in enumerate(draw.t_s):
            lost = t_s - last > LOST_S + 0.5 * FRAME_S
            if draw.sees[i, k]:
                if since is not None and lost:
                    found.append(_again(draw, k, since, float(t_s), seen=True))
                last, since = t_s, None
            elif not could[i]:
                since = None
            elif since is None:
                since = i
        if since is not None and draw.t_s[-1] - last > LOST_S:
            found.append(_again(draw, k, since, float(draw.t_s[-1]), seen=False))
    return [one for one in found if one.t_s + one.seconds >= draw.t_s[draw.watched]]


def _again(draw: Draw, k: int, since: int, until_s: float, seen: bool) -> Again:
    before = max(since - round(ALONE_S / FRAME_S), 0)
    others = np.delete(draw.sees[before : since + 1], k, axis=1)
    t_s = float(draw.t_s[since])
    return Again(t_s, round(until_s - t_s, 3), seen, bool(others.any()))  # whole frames, whatever is rounded off


def p95(again: Sequence[Again]) -> float | None:
    """The smallest time that at least 95 % keep. One that was cut off by the end counts as never; None: no robot lost
    it, or the figure is never."""
    ordered = sorted(one.seconds if one.seen else math.inf for one in again)
    if not ordered:
        return None
    return _number(ordered[-(-95 * len(ordered) // 100) - 1])


def least_m(draw: Draw) -> float:
    """Least distance of any two robots, m."""
    at = draw.robots[:, :, :2]
    apart = np.linalg.norm(at[:, :, None] - at[:, None], axis=3)[:, *np.triu_indices(at.shape[1], 1)]
    return float(apart.min())


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


# --- targets: of three robots that share, at each speed, and what lost words may cost them ---


class Bar(NamedTuple):
    """A figure of a case, and where it has to lie; None: no limit."""

    key: str
    least: float | None
    most: float | None
    words: str


class Verdict(NamedTuple):
    """Of one case. value and met: None where there is no number, which misses a bar, or the case was not run."""

    bar: Bar
    case: Row
    value: float | None
    met: bool


BARS = (
    Bar("seen_by_one", 0.99, None, "one or more see it"),
    Bar("seen_by_two", 0.95, None, "two or more see it"),
    Bar("seen_each", 0.88, None, "each sees it"),
    Bar("rms_mm", None, 25.0, "the fleet's track, mm rms"),
    Bar("nees", 2.5, 3.5, "its normalised error squared"),
    Bar("reacquire_p95_s", None, 0.3, "seen again, others see it, s"),
    Bar("reacquire_alone_p95_s", None, 1.0, "seen again, nobody sees it, s"),
)
COSTS = Bar("rms_mm", None, 1.10, "error with 30 % of words lost, times that without loss")


def verdicts(cases: Sequence[Row]) -> list[Verdict]:
    """Of three robots that share: against all targets where they lose no words, against COSTS where they lose some. A
    fleet that never loses the fish has no target for finding it again."""
    found = []
    for case in cases:
        if case["policy"] != "share" or case["robots"] != FLEET:
            continue
        if not case["loss"]:
            found += [
                Verdict(bar, case, case[bar.key], _meets(bar, case[bar.key])) for bar in BARS if _asked(bar, case)
            ]
            continue
        free = [one for one in cases if _without_loss(one, case)]
        if free:
            value = None if None in (case["rms_mm"], free[0]["rms_mm"]) else case["rms_mm"] / free[0]["rms_mm"]
            found.append(Verdict(COSTS, case, value, _meets(COSTS, value)))
    return found


def _asked(bar: Bar, case: Row) -> bool:
    of = {"reacquire_p95_s": "losses", "reacquire_alone_p95_s": "losses_alone"}.get(bar.key)
    return of is None or case[of] > 0


def _without_loss(one: Row, case: Row) -> bool:
    return not one["loss"] and all(one[key] == case[key] for key in ("policy", "robots", "speed_m_s"))


def _meets(bar: Bar, value: float | None) -> bool:
    return value is not None and (bar.least is None or value >= bar.least) and (bar.most is None or value <= bar.most)


# --- the experiment ---

ENOUGH = 20  # seeds
WORLDS = 1000  # of one --seed
COST = 7  # CPU seconds of a robot in a draw, about


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # the first of the worlds
    seeds: int = ENOUGH
    only: FollowingPolicy | None = None  # this policy; none: all
    robots: int | None = None  # fleets of that size; none: all

    def __post_init__(self) -> None:
        if not all_cases(self.only, self.robots):
            raise ConfigError("no such case: share has 1, 2, 3 or 5 robots, silent and moored have 3")


class Result(ExperimentResult, frozen=True, kw_only=True):
    """A row for each case (`row_of`)."""

    cases: list[Row]
    shown: Shown

    @property
    def failed(self) -> bool:
        return self.shown.verdict and any(verdict.met is False for verdict in verdicts(self.cases))


class Shown(NamedTuple):
    """Beside result.json."""

    draws: dict[Case, list[Draw]]
    verdict: bool  # seeds enough for one


def run(settings: Settings, progress: Progress) -> Result:
    """Dive all cases on all processors; progress counts seconds of work. Raises Failed where a firmware hangs."""
    chosen = all_cases(settings.only, settings.robots)
    first = WORLDS * settings.seed
    tasks = [Task(partial(worlds, case, first), settings.seeds, COST * case.robots, 1) for case in chosen]
    draws = dict(zip(chosen, all_draws(tasks, progress), strict=True))
    rows = [row_of(case, of) for case, of in draws.items()]
    return Result(cases=rows, shown=Shown(draws, settings.seeds >= ENOUGH))


def worlds(case: Case, world: int, first: int, last: int, watch_s: float = WATCH_S) -> list[Draw]:
    """The draws of worlds from the first to the last, the latter excluded, counted from `world`."""
    return [dive(case, world + k, watch_s) for k in range(first, last)]


# --- tables ---

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


# --- figures ---


def figures(result: Result) -> Figures:
    """How soon a robot that lost it has it again, and one fleet's dive; each as SVG and PNG."""
    draws = result.shown.draws
    drawn = {"following_again": again(draws)}
    for case, of in draws.items():
        worst = min(of, key=lambda draw: share(draw)["seen_each"])
        name = f"following_{case.policy}_{case.robots}_{100 * case.loss:.0f}_{100 * case.speed_m_s:.0f}"
        drawn[name] = one_dive(case, worst)
    for name, figure in drawn.items():
        for suffix in ("svg", "png"):
            yield f"{name}.{suffix}", figure


def again(draws: dict[Case, list[Draw]]) -> Figure:
    """Share of the losses after which it was seen again by then, of all speeds together."""
    drawn = Figure(figsize=(6.4, 4.0), dpi=120, layout="constrained")
    panel = drawn.subplots()
    for key in dict.fromkeys((case.policy, case.robots, case.loss) for case in draws):
        every = [one for case, of in draws.items() if case[:3] == key for draw in of for one in losses(draw)]
        for by_others, words in ((True, "others see it"), (False, "nobody else")):
            seconds = sorted(one.seconds for one in every if one.by_others == by_others and one.seen)
            count = sum(one.by_others == by_others for one in every)
            if count:
                label = f"{key[0]}, {key[1]} robots, loss {key[2]:.0%}, {words} ({count})"
                panel.step([0.0, *seconds], np.arange(len(seconds) + 1) / count, where="post", label=label)
    panel.set(xlabel="s from when it was in sight", ylabel="share seen again", xlim=(0.0, 5.0), ylim=(0.0, 1.02))
    if panel.get_legend_handles_labels()[0]:
        panel.legend(fontsize="xx-small")
    return drawn


def one_dive(case: Case, draw: Draw) -> Figure:
    """The seed in which each saw least: which robots saw it when, and how far off they believed it."""
    drawn = Figure(figsize=(9.0, 4.4), dpi=120, layout="constrained")
    above, time = drawn.subplots(1, 2)
    above.plot(*draw.target_m[draw.watched :, :2].T, color="black", linewidth=0.8, label="target")
    for k in range(draw.robots.shape[1]):
        above.plot(*draw.robots[draw.watched :, k, :2].T, linewidth=0.8, label=f"r{k + 1}")
        when = draw.t_s[draw.sees[:, k]]
        time.plot(when, np.full(len(when), -0.1 * (k + 1)), "|", markersize=4)
        time.plot(draw.t_s, draw.error_m[:, k], linewidth=0.8, color=f"C{k}")
    for weed in draw.weeds:
        above.plot(weed.x_m, weed.y_m, "o", color="green", markersize=8)
    above.set(xlim=(0.0, TANK.size_m[0]), ylim=(0.0, TANK.size_m[1]), aspect="equal")
    above.legend(fontsize="x-small")
    time.axvline(draw.t_s[draw.watched], color="grey", linewidth=0.6)
    time.set(xlabel="s", ylabel="error, m; below: frames that show it", ylim=(-0.1 * (draw.sees.shape[1] + 1), 1.0))
    drawn.suptitle(f"{case.policy}, {case.robots} robots, loss {case.loss:.0%}, {case.speed_m_s:g} m/s: worst seed")
    return drawn
