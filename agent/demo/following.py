"""What following a target that swims was worth: who saw it when, and how far off its track each robot was.

Judged from when all robots know of it to the end, from the black boxes and the twin's truth. A fish is not a point:
what is measured is the middle of what shows of it, and what counts is that of its body.

The verdict asks whether the fleet follows it: it is not lost, each robot takes part, everybody knows where it is to
within its length, and nobody is surer than right. How good that could be is asked by BARS, which are told and decide
nothing here; `aucamp experiment following` holds them against many seeds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agent.core.config import Fleet
from agent.core.messages import Symmetric
from agent.demo.history import History
from replay.check.black_box import black_boxes, open_boxes
from replay.report.creature_track import CreatureTrack, Held, creature_track

FOLLOW_S = 60.0  # from when all robots know of it until the demo ends
LEAST_S = 30.0  # less is no following
# What the verdict asks: shares of the time in which one robot at least, and each of them sees it; then the track.
ONE_SEES, EACH_SEES = 0.95, 0.5
LENGTH_M = 0.15  # of a creature of which nobody says how long it is
MOST_NEES = 3.5  # of three axes: 3 where errors are as large as robots say, less where they are smaller
BARS: dict[str, tuple[float | None, float | None]] = {  # least and most
    "seen_by_one": (0.99, None),
    "seen_by_two": (0.95, None),
    "seen_each": (0.88, None),
    "track_rms_mm": (None, 25.0),
    "nees": (2.5, 3.5),
}
LOST_S = 0.3  # out of sight of one for longer, it has been lost


def swims(fleet: Fleet, target: str) -> bool:
    return fleet.target[target].speed_m_s is not None


def followed_s(of_target: Mapping[str, History]) -> float:
    """For how long all robots have known where it is."""
    firsts, lasts = [], []
    for history in of_target.values():
        first = next((state for state in history.states if state.posterior_m is not None), None)
        if first is None or history.newest is None:
            return 0.0
        firsts.append(first.sent_ns)
        lasts.append(history.newest.sent_ns)
    return (min(lasts) - max(firsts)) * 1e-9 if firsts else 0.0


def scored(run: Path, fleet: Fleet, target: str) -> dict[str, Any]:
    """The row of summary.json of a target that swims, from the folder of its run. Raises ConfigError without black
    boxes."""
    return score_following(creature_track(run, open_boxes(black_boxes(run)), target), fleet, target)


def score_following(track: CreatureTrack | None, fleet: Fleet, target: str) -> dict[str, Any]:
    """The same of a track; None: nobody knows the truth. Lengths in mm, times in seconds of the dive."""
    known_ns = track.known_ns if track is not None else None
    row: dict[str, Any] = {
        "swims": True,
        "truth_m": None,
        "radii_m": None,
        "followed_s": 0.0,
        "seen_by_one": None,
        "seen_by_two": None,
        "seen_each": None,
        "track_rms_mm": None,
        "nees": None,
        "allowed_rms_mm": 1e3 * (fleet.target[target].length_m or LENGTH_M),
        "bars": {},
        "agents": {},
    }
    if track is None:
        return row
    since_ns = known_ns if known_ns is not None else track.ends_ns
    moments = track.moments(since_ns)
    seen = {robot: track.sees(robot, moments) for robot in fleet.robot if robot in track.looks}
    row["agents"] = {robot: _agent(track, robot, since_ns, seen.get(robot)) for robot in fleet.robot}
    row["truth_m"] = [float(x) for x in track.truth.x_m[-1]]
    if known_ns is None or len(moments) < 2:
        return row
    together = np.sum([seen[robot] for robot in seen], axis=0)
    errors = [_errors(track, robot, since_ns) for robot in fleet.robot]
    row |= {
        "followed_s": float(moments[-1] - moments[0]) * 1e-9,
        "seen_by_one": float(np.mean(together >= 1)),
        "seen_by_two": float(np.mean(together >= 2)) if len(fleet.robot) > 1 else None,
        "seen_each": float(min(np.mean(each) for each in seen.values())),
        "track_rms_mm": 1e3 * _rms(np.concatenate([off for off, _ in errors])),
        "nees": float(np.mean(np.concatenate([nees for _, nees in errors]))),
    }
    row["bars"] = {key: _within(row[key], *limits) for key, limits in BARS.items() if row[key] is not None}
    return row


def reasons_following(row: Mapping[str, Any]) -> list[str]:
    """Why following failed; empty where it is as good as it has to be."""
    if row["followed_s"] < LEAST_S:
        never = [name for name, about in row["agents"].items() if about["known_s"] is None]
        return [
            f"{', '.join(never)} never knew where it is" if never else f"followed for less than {LEAST_S:.0f} s in all"
        ]
    asked = (("one robot", "seen_by_one", ONE_SEES), ("each robot", "seen_each", EACH_SEES))
    found = [
        f"{who} saw it for {100 * row[key]:.1f} % of the time < {100 * least:.0f} %"
        for who, key, least in asked
        if row[key] < least
    ]
    for name, about in row["agents"].items():
        if about["track_rms_mm"] > row["allowed_rms_mm"]:
            off, length = about["track_rms_mm"], row["allowed_rms_mm"]
            found.append(f"{name}: its track is off by {off:.0f} mm rms, more than the creature's length, {length:.0f}")
        if about["nees"] > MOST_NEES:
            found.append(f"{name}: NEES {about['nees']:.2f} > {MOST_NEES}: it is surer than right")
    return found


def _within(value: float, least: float | None, most: float | None) -> bool:
    return (least is None or value >= least) and (most is None or value <= most)


def _agent(track: CreatureTrack, robot: str, since_ns: int, sees: np.ndarray | None) -> dict[str, Any]:
    held, looks = track.held.get(robot, []), track.looks.get(robot, [])
    off, nees = _errors(track, robot, since_ns)
    late = [look for look in looks if look.t_ns >= since_ns]
    shown = [look for look in late if look.there == "shows"]
    newest = held[-1] if held else None
    return {
        "known_s": None if not held or not looks else (held[0].t_ns - looks[0].t_ns) * 1e-9,
        "seen": float(np.mean(sees)) if sees is not None and len(sees) else None,
        "longest_unseen_s": _longest_s(sees) if sees is not None else None,
        "times_lost": _times_lost(sees) if sees is not None else None,
        "frames": len(late),
        "in_the_picture": len(shown),
        "found_of_these": sum(look.right for look in shown),
        "mistaken": sum(look.found and not look.right for look in late),
        "track_rms_mm": 1e3 * _rms(off) if len(off) else None,
        "track_p95_mm": 1e3 * float(np.percentile(off, 95)) if len(off) else None,
        "nees": float(np.mean(nees)) if len(nees) else None,
        "estimate_m": list(newest.x_m) if newest else None,
        "iterations": len(held),
    }


def _errors(track: CreatureTrack, robot: str, since_ns: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the truth (n,), m, and its square in the covariance that the robot states (n,)."""
    rows = [row for row in track.held.get(robot, []) if row.t_ns >= since_ns]
    if not rows:
        return np.zeros(0), np.zeros(0)
    e = np.array([row.x_m for row in rows]) - track.truth.at([row.t_ns for row in rows])
    known = np.asarray(np.isfinite(e).all(axis=1))
    squares = [float(d @ np.linalg.solve(_full(row.cov_m2), d)) for d, row in _pairs(e, rows, known)]
    return np.linalg.norm(e[known], axis=1), np.array(squares)


def _pairs(e: np.ndarray, rows: list[Held], known: np.ndarray) -> list[tuple[np.ndarray, Held]]:
    return [(d, row) for d, row, is_known in zip(e, rows, known, strict=True) if is_known]


def _full(cov_m2: Symmetric) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = cov_m2
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _rms(values: np.ndarray) -> float:
    return math.sqrt(float(np.mean(np.square(values)))) if len(values) else math.nan


def _gaps(sees: np.ndarray) -> list[int]:
    """Lengths of the runs of moments in which it is not seen."""
    edges = np.flatnonzero(np.diff(np.concatenate([[1], sees.astype(int), [1]])))
    return [int(end - start) for start, end in edges.reshape(-1, 2)]


def _longest_s(sees: np.ndarray) -> float:
    return 0.1 * max(_gaps(sees), default=0)


def _times_lost(sees: np.ndarray) -> int:
    return sum(0.1 * gap > LOST_S for gap in _gaps(sees))
