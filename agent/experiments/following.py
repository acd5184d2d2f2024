"""Can three robots follow a target that swims, and what does it help that they talk?

All fleets dive in the same worlds, once at each speed of the target; following_dive.py has a dive.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from statistics import median
from typing import NamedTuple

import msgspec
import numpy as np

from agent.capabilities.swim.barrier import RINGS_M
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value, percentile
from agent.experiments.following_dive import WATCH_S, Case, Draw, dive

# --- what is counted of a dive: which robots saw it, how well it was known, how soon a robot that lost it had it again

LOST_S = 0.4  # not seen for longer: lost, as the kernel has it (pursuit.LOST_NS)
FRAME_S = 0.1
ALONE_S = 0.4  # another saw it within that time before: it is not alone


class Again(NamedTuple):
    """One time that a robot lost it."""

    t_s: float  # when it was in sight again, or lost with nothing in between
    seconds: float | None  # from then until it was seen; None: not by the end
    by_others: bool  # others saw it then


def row_of(case: Case, draw: Draw) -> Row:
    """Counts and sums of the watch, which add up over dives. Where robots say nothing of the target, it does not matter
    what others see: all times are those of a robot alone."""
    sees, open_eyes = draw.sees[draw.watched :], ~draw.covered[draw.watched :]
    at_once = sees.sum(axis=1)[open_eyes.any(axis=1)]
    error_m, nees = draw.error_m[draw.watched :], draw.nees[draw.watched :]
    told = not case.silent
    whole_m = draw.error_m[draw.first :]
    shares = [float(each[eyes].mean()) for each, eyes in zip(sees.T, open_eyes.T, strict=True)]
    again = losses(draw)
    alone_s = [one.seconds for one in again if not (told and one.by_others)]
    return {
        "frames": len(at_once),
        "by_one": int(np.sum(at_once >= 1)),
        "by_two": int(np.sum(at_once >= 2)),
        "open_eyes": int(open_eyes.sum()),  # what a covered camera would have seen does not count
        "seen": int(sees[open_eyes].sum()),
        "least": min(shares),
        "whole_m2": float(np.nansum(whole_m**2)),
        "whole_of": int(np.isfinite(whole_m).sum()),
        "error_m2": float(np.nansum(error_m**2)),
        "errors": int(np.isfinite(error_m).sum()),
        "beliefs": error_m.size,  # a robot that does not know has no error
        "nees": float(np.nansum(nees)),
        "nees_of": int(np.isfinite(nees).sum()),
        "again_s": [one.seconds for one in again if one.by_others] if told else alone_s,
        "again_any_side_s": [one.seconds for one in losses(draw, any_side=True) if one.by_others or not told],
        "again_alone_s": alone_s,
        "least_m": draw.least_m,
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
                if since is not None and lost and t_s >= draw.t_s[draw.watched]:
                    found.append(_again(draw, k, since, float(t_s)))
                last, since = t_s, None
            elif not could[i]:
                since = None
            elif since is None:
                since = i
        if since is not None and draw.t_s[-1] - last > LOST_S:
            found.append(_again(draw, k, since, None))
    return found


def _again(draw: Draw, k: int, since: int, seen_s: float | None) -> Again:
    before = max(since - round(ALONE_S / FRAME_S), 0)
    others = np.delete(draw.sees[before : since + 1], k, axis=1)
    t_s = float(draw.t_s[since])
    seconds = None if seen_s is None else round(seen_s - t_s, 3)  # whole frames, whatever is rounded off
    return Again(t_s, seconds, bool(others.any()))


def figures_of(dives: Sequence[Row]) -> dict[str, Value]:
    """Of all dives of one case at one speed. Frames of one dive are much alike: a share of them is known as well as
    seeds tell, and is no Share. Where no robot lost the target there is no time to tell: NaN."""
    total = {key: sum(row[key] for row in dives) for key in SUMS}
    found: dict[str, Value] = {
        "by_one": 1e2 * total["by_one"] / total["frames"],
        "by_two": 1e2 * total["by_two"] / total["frames"],
        "each": 1e2 * total["seen"] / total["open_eyes"],
        "least": 1e2 * median(row["least"] for row in dives),
        "known": 1e2 * total["errors"] / total["beliefs"],
        "rms_mm": 1e3 * math.sqrt(total["error_m2"] / total["errors"]) if total["errors"] else None,
        "whole_rms_mm": 1e3 * math.sqrt(total["whole_m2"] / total["whole_of"]) if total["whole_of"] else None,
        "nees": total["nees"] / total["nees_of"] if total["nees_of"] else None,
    }
    for key in ("again_s", "again_any_side_s", "again_alone_s"):
        times_s = [seconds for row in dives for seconds in row[key]]
        found[key] = percentile(times_s, 95.0) if times_s else math.nan
    least_m = [row["least_m"] for row in dives]
    return found | {"least_m": Quantile(least_m, 0.0), "keep": Share(sum(m >= RINGS_M for m in least_m), len(least_m))}


SUMS = (
    *("frames", "by_one", "by_two", "open_eyes", "seen", "error_m2", "errors", "whole_m2", "whole_of"),
    *("beliefs", "nees", "nees_of"),
)

# --- the claim ---

SPEEDS_M_S = (0.10, 0.15, 0.20)  # of the target
LOST = 0.3  # of all words, where some are lost

CASES = {"share-3": Case(), "share-3-loss30": Case(LOST), "silent-3": Case(silent=True)}
TARGETS = ("share-3", "share-3-loss30")  # cases that have any


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    speed_m_s: float | None = None  # of the target; None: each of SPEEDS_M_S
    watch_s: float = WATCH_S  # and 20 s, in which robots search at first


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """A row for each speed. Raises Failed where a firmware hangs."""
    of = CASES[case]
    speeds_m_s = SPEEDS_M_S if settings.speed_m_s is None else (settings.speed_m_s,)
    dives = {speed_m_s: dive(of, speed_m_s, seed, settings.watch_s) for speed_m_s in speeds_m_s}
    return [{"speed_m_s": speed_m_s, **row_of(of, draw)} for speed_m_s, draw in dives.items()]


def summary(rows: Rows) -> dict[str, Value]:
    """Keys are case, speed and figure; `cost` is the error where words are lost, of that where none are."""
    found: dict[tuple[str, float], dict[str, Value]] = {}
    for case, dives in rows.items():
        for speed_m_s in {row["speed_m_s"] for row in dives}:
            found[case, speed_m_s] = figures_of([row for row in dives if row["speed_m_s"] == speed_m_s])
    for speed_m_s in SPEEDS_M_S:
        if all((case, speed_m_s) in found for case in TARGETS):
            free_mm, lossy_mm = (found[case, speed_m_s]["rms_mm"] for case in TARGETS)
            cost = lossy_mm / free_mm if isinstance(lossy_mm, float) and isinstance(free_mm, float) else None
            found[TARGETS[1], speed_m_s]["cost"] = cost
    return {
        f"{case}_{speed_m_s:.2f}_{key}": value
        for (case, speed_m_s), of_case in found.items()
        for key, value in of_case.items()
    }


JUDGED = (
    Figure("by_one", "one or more see it", "%", least=99.0),
    Figure("by_two", "two or more see it", "%", least=95.0),
    Figure("each", "each sees it", "%", least=88.0),
    Figure("least", "the robot that sees it least, median of dives", "%", least=85.0),
    Figure("known", "each knows where it is", "%"),
    Figure("rms_mm", "where they believe it to be is off, rms", "mm", most=25.0),
    Figure("whole_rms_mm", "the same from the first frame on that shows it", "mm"),
    Figure("nees", "its error as it says: NEES", "", least=2.5, most=3.5),
    Figure("again_s", "lost, and seen again while others see it, 95 %", "s", most=0.3),
    Figure("again_alone_s", "lost, and seen again while nobody sees it, 95 %", "s", most=1.0),
    Figure("again_any_side_s", "the same while others see it, also where the body has to turn first", "s"),
    Figure("least_m", "least distance of any two robots", "m"),
    Figure("keep", "no two nearer than 0.34 m, share of dives", "%", least=95.0),
)


def _figures(name: str, case: Case) -> Iterator[Figure]:
    """At each speed; three that share have the targets."""
    lost = f", {100 * LOST:.0f} % of words lost" if case.loss else ""
    who = ("three silent" if case.silent else "three share") + lost
    cost = Figure("cost", "error, of that where no words are lost", "x", most=1.10)
    bare = [cost] * (case.loss > 0.0) + [figure._replace(least=None, most=None) for figure in JUDGED]
    for speed_m_s in SPEEDS_M_S:
        for figure in JUDGED if name == TARGETS[0] else bare:
            at = f"{speed_m_s:.2f}"
            yield figure._replace(key=f"{name}_{at}_{figure.key}", words=f"{who}, {at} m/s: {figure.words}")


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=tuple(CASES),
    by_default=TARGETS,
    quick={"speed_m_s": 0.15, "watch_s": 5.0},
    measured_on="twin",
    figures=tuple(figure for name, case in CASES.items() for figure in _figures(name, case)),
    explanation="""Robots search a basin with weeds for a fish, find it in their own drawn frames as bearings, and
        follow it; for some seconds one camera is covered. What counts begins 5 s after the first robot that swims
        has seen it. Robots that share tell each other what they see, the silent say only where they are themselves.
        A robot that lost the fish is asked for it from when it is in sight again; NEES is the error squared in units of
        the stated covariance, 3 where it is honest. The thruster rings of two robots touch at 0.34 m.""",
)
