"""From what happened to figures: who saw it, how well it was known, and how soon one that lost it had it again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agent.experiments.following.cases import Case
from agent.experiments.following.dive import Draw
from agent.experiments.result import Row

LOST_S = 0.4  # not seen for longer: lost, as the kernel has it (control/gaze.py)
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
    """The smallest time that at least 95 % keep. One that was cut off by the end counts as never; None: nobody lost it,
    or the figure is never."""
    ordered = sorted(one.seconds if one.seen else math.inf for one in again)
    if not ordered:
        return None
    return _number(ordered[-(-95 * len(ordered) // 100) - 1])


def least_m(draw: Draw) -> float:
    """Of any two robots."""
    at = draw.robots[:, :, :2]
    apart = np.linalg.norm(at[:, :, None] - at[:, None], axis=3)[:, *np.triu_indices(at.shape[1], 1)]
    return float(apart.min())


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
