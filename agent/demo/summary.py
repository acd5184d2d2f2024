"""What a run was worth: errors of priors and posteriors against the truth, which the twin alone knows; how far a survey
came; how a target that swims was followed.

A run has a history for each target and robot. The verdict is over all of them.

Of a ball the middle is measured, to the paper's figure. Of a thing in a box each robot measures a point of the surface
that it sees, and what several of them agree on lies between such points: on the thing or in it. How far outside of it
an estimate lies is what counts, beside the standard deviation that the robot itself states.

Of what swims there is a track instead of a place (following.py).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from agent.core.capability_messages import Claim
from agent.core.config import Fleet
from agent.core.messages import State, Vector
from agent.core.status import UNRECORDED, fault_kind
from replay.check.reexecute import open_boxes
from replay.files.recover import black_boxes
from replay.report.creature_track import PATHS, SETTLES_NS, CreatureTrack, creature_track, errors, true_ways

# --- how far a survey has come ---
# How far a survey has come, by what robots tell each other of it.


class SurveyWatch:
    """The newest claim of each robot; of a fleet without [coverage] there is none."""

    def __init__(self, fleet: Fleet) -> None:
        self.robots, self._settings = tuple(fleet.robot), fleet.coverage
        self._newest: dict[str, Claim] = {}

    def add(self, claim: Claim) -> None:
        before = self._newest.get(claim.src)
        if claim.src in self.robots and (before is None or claim.sent_ns >= before.sent_ns):
            self._newest[claim.src] = claim

    def newest(self) -> dict[str, Claim]:
        """Of each robot that was heard."""
        return self._newest

    def usual_digest(self) -> str:
        """That of most maps; of as many that which was heard first."""
        counts = Counter(claim.digest for claim in self._newest.values()).most_common(1)
        return counts[0][0] if counts else ""

    @property
    def over(self) -> bool:
        """Everybody knows all that is asked for, and has the same map."""
        return not list(self.reasons())

    def shares(self) -> dict[str, float | None]:
        """Of the wanted cells that each robot's map knows well enough; None: never heard."""
        return {name: None if name not in self._newest else self._newest[name].share for name in self.robots}

    def equal(self) -> bool:
        """Whether all have said the same of their maps last."""
        digests = {self._newest[name].digest if name in self._newest else None for name in self.robots}
        return len(digests) == 1 and None not in digests

    def reasons(self) -> Iterator[str]:
        """Why the survey has not succeeded, or not yet."""
        assert self._settings is not None
        for name, share in self.shares().items():
            if share is None:
                yield f"{name} never said what it holds"
            elif share < self._settings.share:
                yield f"{name} knows {100 * share:.1f} % of what is wanted < {100 * self._settings.share:.0f} %"
        if not self.equal():
            yield "the robots' maps differ"

    def as_json(self) -> dict[str, Any]:
        """`coverage` of summary.json. keyframes: how many of each robot's everybody holds."""
        assert self._settings is not None
        held = {name: {has.origin: has.upto for has in claim.has} for name, claim in self._newest.items()}
        keyframes = {name: min((each.get(name, 0) for each in held.values()), default=0) for name in self.robots}
        return {
            "wanted_share": self._settings.share,
            "goal_mm": self._settings.goal_mm,
            "cell_mm": self._settings.cell_mm,
            "faces": list(self._settings.faces),
            "share": self.shares(),
            "maps_equal": self.equal(),
            "digest": {name: claim.digest for name, claim in sorted(self._newest.items())},
            "keyframes": keyframes,
        }

    def lines(self) -> Iterator[str]:
        """For people."""
        told = self.as_json()
        shares = (
            f"{name} {'-' if share is None else format(100 * share, '.1f')} %" for name, share in told["share"].items()
        )
        yield f"known of {', '.join(told['faces'])} and what lies there: {', '.join(shares)}"
        each = ", ".join(f"{name} {count}" for name, count in told["keyframes"].items())
        yield f"keyframes that all hold: {each}; maps {'are equal' if told['maps_equal'] else 'differ'}"


# --- what robots showed ---
# What the robots of a demo showed, by target and robot.


class History(NamedTuple):
    """What one robot showed about one target, newest last."""

    states: list[State]

    @property
    def newest(self) -> State | None:
        """The last state, if there is one."""
        return self.states[-1] if self.states else None

    def iterations(self) -> list[State]:
        """The last state of each iteration."""
        by_t = {state.t: state for state in self.states}
        return [by_t[t] for t in sorted(by_t)]

    def priors(self) -> list[Vector]:
        """Each measurement once."""
        by_number = {s.measurements: s.prior_m for s in self.states if s.prior_m is not None}
        return [by_number[n] for n in sorted(by_number)]


Histories = dict[str, dict[str, History]]  # by target, then by robot

# --- where robots that swim believed to be ---

YAW = 5  # its column in true_ways


def whereabouts(run: Path, histories: Histories) -> dict[str, dict[str, float]]:
    """Of each robot that said where it is: how far off that was, rms over all that it said.

    place_mm and yaw_deg; place_sigmas and yaw_sigmas: the same in the standard deviations that it stated with it, 1
    where it is as wrong as it says. Empty where nobody knows the truth. Raises ConfigError for a damaged file.
    """
    if not (run / PATHS).is_file():
        return {}
    off = {}
    for robot, way in true_ways(run).items():
        states = [state for of in histories.values() if robot in of for state in of[robot].states]
        told = {s.sent_ns: s.whereabouts for s in states if s.whereabouts and way.t_ns[0] <= s.sent_ns <= way.t_ns[-1]}
        if not told:
            continue
        truth = way.at(list(told))
        said = np.array([msgspec.structs.astuple(each) for each in told.values()])
        aside_m = np.hypot(*(said[:, :2] - truth[:, :2]).T)
        turned_deg = (said[:, 2] - truth[:, YAW] + 180.0) % 360.0 - 180.0
        off[robot] = {
            "place_mm": round(1e3 * _rms(aside_m), 1),
            "place_sigmas": round(_rms(aside_m / said[:, 3]), 2),
            "yaw_deg": round(_rms(turned_deg), 2),
            "yaw_sigmas": round(_rms(turned_deg / said[:, 4]), 2),
        }
    return off


def whereabouts_lines(off: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    """For people."""
    for robot, by in off.items():
        yield (
            f"{robot} believed to be {by['place_mm']:.1f} mm and {by['yaw_deg']:.2f} deg beside where it was, rms: "
            f"{by['place_sigmas']:.2f} and {by['yaw_sigmas']:.2f} of what it stated"
        )


# --- a target that swims ---
# What following a target that swims was worth: who saw it when, and how far off its track each robot was.
#
# Judged from 5 s after the first robot has seen it to the end, and beside that from the first moment on, by the black
# boxes and the twin's truth. A fish is not a point: what is measured is the middle of what shows of it, and what counts
# is that of its body.
#
# The verdict asks whether the fleet follows it: it is not lost, each robot takes part, everybody knows where it is to
# within its length, and nobody is surer than right. How good that could be is asked by BARS, which are told and
# decide nothing here; `aucamp experiment following` holds them against many seeds.

FOLLOW_S = 60.0  # from when all robots know of it until the demo ends
LEAST_S = 30.0  # less is no following
# What the verdict asks: shares of the time in which one robot at least, and each of them sees it; then the track.
ONE_SEES, EACH_SEES = 0.95, 0.5
LENGTH_M = 0.15  # of a creature of which nobody says how long it is
# Of three axes: 3 where errors are as large as robots say, less where they are smaller. Errors of a second are alike:
# a dive holds some forty, whose mean is above 4 in one of two hundred dives of robots that are right.
MOST_NEES = 4.0
BARS: dict[str, tuple[float | None, float | None]] = {  # least and most
    "seen_by_one": (0.99, None),
    "seen_by_two": (0.95, None),
    "seen_least": (0.85, None),
    "track_rms_mm": (None, 25.0),
    "nees": (2.2, MOST_NEES),
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
    row: dict[str, Any] = {
        "swims": True,
        "truth_m": None,
        "radii_m": None,
        **NO_FIGURES,
        "whole": NO_FIGURES,
        "allowed_rms_mm": 1e3 * (fleet.target[target].length_m or LENGTH_M),
        "bars": {},
        "agents": {},
    }
    if track is None:
        return row
    since_ns = track.ends_ns if track.first_ns is None else track.first_ns + SETTLES_NS
    row["agents"] = {robot: _agent(track, robot, since_ns) for robot in fleet.robot}
    row["truth_m"] = [float(x) for x in track.truth.x_m[-1]]
    if track.first_ns is None or track.known_ns is None or since_ns >= track.ends_ns:
        return row
    row |= _figures(track, since_ns) | {"whole": _figures(track, track.first_ns)}
    row["bars"] = {key: _within(row[key], *limits) for key, limits in BARS.items() if row[key] is not None}
    return row


NO_FIGURES: dict[str, float | None] = {
    "followed_s": 0.0,
    "seen_by_one": None,
    "seen_by_two": None,
    "seen_mean": None,
    "seen_least": None,
    "track_rms_mm": None,
    "nees": None,
}


def _figures(track: CreatureTrack, since_ns: int) -> dict[str, float | None]:
    """Of all robots from then on: shares of the time in which one, two, the mean and the least of them see it."""
    moments = track.moments(since_ns)
    sees = np.array([track.sees(robot, moments) for robot in track.looks])
    errors = [_errors(track, robot, since_ns) for robot in track.looks]
    return {
        "followed_s": float(moments[-1] - moments[0]) * 1e-9,
        "seen_by_one": float(np.mean(sees.sum(axis=0) >= 1)),
        "seen_by_two": float(np.mean(sees.sum(axis=0) >= 2)) if len(sees) > 1 else None,
        "seen_mean": float(sees.mean()),
        "seen_least": float(sees.mean(axis=1).min()),
        "track_rms_mm": 1e3 * _rms(np.concatenate([off for off, _ in errors])),
        "nees": float(np.mean(np.concatenate([nees for _, nees in errors]))),
    }


def reasons_following(row: Mapping[str, Any]) -> list[str]:
    """Why following failed; empty where it is as good as it has to be."""
    if row["followed_s"] < LEAST_S:
        never = [name for name, about in row["agents"].items() if about["known_s"] is None]
        return [
            f"{', '.join(never)} never knew where it is" if never else f"followed for less than {LEAST_S:.0f} s in all"
        ]
    asked = (("one robot", "seen_by_one", ONE_SEES), ("each robot", "seen_least", EACH_SEES))
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


def _agent(track: CreatureTrack, robot: str, since_ns: int) -> dict[str, Any]:
    sees = track.sees(robot, track.moments(since_ns)) if robot in track.looks else None
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
    return errors([row[:3] for row in track.held.get(robot, []) if row.t_ns >= since_ns], track.truth)


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


# --- targets at rest ---

NOBODY: dict[str, Any] = {"verdict": None, "causes": []}  # of a robot that showed nothing
PASS_PERCENT = 0.4  # the paper's final relative error (section 6)
SIGMAS = 3.0  # how many of its own standard deviations an estimate may lie outside of a thing in a box


def summarize(
    fleet: Fleet,
    histories: Histories,
    truth: dict[str, Any],
    wall_s: float,
    followed: Mapping[str, dict[str, Any]] | None = None,
    survey: SurveyWatch | None = None,
) -> dict[str, Any]:
    """The content of summary.json, schema 1. `truth`: as the twin wrote it; `followed`: following.scored of each target
    that swims.

    `targets` has every target; `truth_m` and `agents` are those of the first. Of each robot `verdict` and `causes` are
    what it said last of its own belief, `faults` the kinds of all faults that it ever told; they decide nothing here.
    survey: of a fleet with [coverage], whose verdict is over what it surveyed, for its cameras are at that and not at
    targets.
    """
    targets: dict[str, Any] = {}
    why = []
    for target, of_target in histories.items():
        if followed is not None and target in followed:
            targets[target] = followed[target]
            found = reasons_following(followed[target])
            why += [f"{target}: {reason}" if len(histories) > 1 else reason for reason in found]
            continue
        truth_m: Vector = tuple(truth["target_m"][target])
        radii_m: Vector | None = tuple(truth["target_radii_m"][target]) if is_box(fleet, target) else None
        rows = {name: score(history, truth_m, radii_m) for name, history in of_target.items()}
        targets[target] = {"truth_m": list(truth_m), "radii_m": radii_m, "agents": rows}
        why += [f"{target}: {reason}" if len(histories) > 1 else reason for reason in reasons(rows)]
    if survey is not None:
        why = list(survey.reasons())
    why += list(unrecorded(histories))
    for target, about in targets.items():
        for name, row in about["agents"].items():
            states = histories[target][name].states if name in histories[target] else []
            row |= {"verdict": states[-1].verdict, "causes": list(states[-1].causes)} if states else NOBODY
            row["faults"] = sorted({fault_kind(fault) for state in states for fault in state.faults})
    first, depth_m = next(iter(targets)), next(iter(fleet.robot.values())).depth_m
    return {
        "schema": 1,
        "protocol": fleet.estimation.protocol,
        "seed": fleet.twin.seed,
        "loss": fleet.link.loss,
        "wall_s": round(wall_s, 1),
        "incarnations": incarnations(histories),
        "truth_m": targets[first]["truth_m"],
        "agents": targets[first]["agents"],
        "targets": targets,
        "control": control(histories[first].values(), depth_m),
        **({} if survey is None else {"coverage": survey.as_json()}),
        "verdict": "fail" if why else "pass",
        "reasons": why,
    }


def incarnations(histories: Histories) -> dict[str, list[int]]:
    """Which starts of each robot were heard: by them a summary is known to be of the recordings beside it."""
    found: dict[str, set[int]] = {name: set() for of_target in histories.values() for name in of_target}
    for of_target in histories.values():
        for name, history in of_target.items():
            found[name].update(state.incarnation for state in history.states)
    return {name: sorted(each) for name, each in found.items()}


def unrecorded(histories: Histories) -> Iterator[str]:
    """What robots said last of recordings that ended or stalled: without them nobody can look into the dive."""
    said = [(name, of[name].newest) for of in histories.values() for name in of]
    found = [f"{name}: {fault}" for name, newest in said for fault in (newest.faults if newest else ())]
    yield from dict.fromkeys(text for text in found if f": {UNRECORDED}" in text)


def doubts(summary: Mapping[str, Any]) -> list[str]:
    """Who ended with a belief that is not consistent, and why: a sentence for each robot and target."""
    several = len(summary["targets"]) > 1
    return [
        f"{name} ended {row['verdict']}{f' about {target}' * several}: {row['causes'][0]}"
        for target, about in summary["targets"].items()
        for name, row in about.get("agents", {}).items()
        if row.get("causes")
    ]


def is_box(fleet: Fleet, target: str) -> bool:
    """Whether it is a thing in a box, which need not look like its picture from everywhere."""
    return fleet.target[target].detector == "box"


def settled(histories: Iterable[History], after_views: int, window: int, within_m: float, all_see: bool = True) -> bool:
    """All see the target, or without `all_see` have an estimate; `after_views` iterations have passed since the last of
    them first did, and no posterior moved further than `within_m` over the last `window` iterations. Knows nothing of
    the truth."""
    lasts = [h.iterations() for h in histories]
    began = [acquired(states) if all_see else first_estimate(states) for states in lasts]
    if any(t is None for t in began):
        return False
    last_view = max(t or 0 for t in began)
    return all(states[-1].t >= last_view + after_views and moved_m(states[-window:]) <= within_m for states in lasts)


def acquired(states: Sequence[State]) -> int | None:
    """The iteration at which it first saw the target."""
    return states[-1].acquired_t if states else None


def first_estimate(states: Sequence[State]) -> int | None:
    """The iteration at which it first knew where the target is, by its own eyes or a neighbour's word."""
    return next((state.t for state in states if state.posterior_m is not None), None)


def moved_m(states: Sequence[State]) -> float:
    """Largest distance of a posterior from the last one."""
    places = [s.posterior_m for s in states if s.posterior_m is not None]
    return max((distance_m(p, places[-1]) for p in places), default=math.inf)


def score(history: History, truth: Vector, radii_m: Vector | None = None) -> dict[str, Any]:
    """One robot's row of summary.json; lengths in metres unless the name says otherwise.

    `radii_m`: along x, y and z, of a thing in a box, whose middle is `truth`; None: a ball.
    """
    newest = history.newest
    estimate = newest.posterior_m if newest else None
    priors = history.priors()
    error_mm = distance_m(estimate, truth) * 1e3 if estimate else None
    sigma_m = newest.posterior_sigma_m if newest else None
    percent = 100.0 * error_mm * 1e-3 / distance_m((0, 0, 0), truth) if error_mm is not None else None
    of_a_box: dict[str, float | None] = {"outside_mm": None, "allowed_mm": None}
    if radii_m is not None and estimate is not None:
        of_a_box["outside_mm"] = 1e3 * outside_m(estimate, truth, radii_m)
        of_a_box["allowed_mm"] = 1e3 * min(SIGMAS * (sigma_m or 0.0), max(radii_m))  # who knows nothing is not right
    return {
        "estimate_m": estimate,
        "sigma_m": sigma_m,
        "error_mm": error_mm,
        "error_axis_mm": [(e - x) * 1e3 for e, x in zip(estimate, truth, strict=True)] if estimate else None,
        "relative_error_percent": percent if radii_m is None else None,
        "acquired_iteration": newest.acquired_t if newest else None,
        "iterations": newest.t if newest else 0,
        "measurements": newest.measurements if newest else 0,
        "prior_rmse_mm": rms(distance_m(p, truth) for p in priors) * 1e3 if priors else None,
        "prior_rmse_axis_mm": [rms(p[k] - truth[k] for p in priors) * 1e3 for k in range(3)] if priors else None,
        "below_0_4_percent_from": first_below(history, truth) if radii_m is None else None,
        **(of_a_box if radii_m is not None else {}),
    }


def outside_m(place: Vector, middle: Vector, radii_m: Vector) -> float:
    """How far a place lies outside of an ellipsoid, measured towards its middle: no less than the shortest way."""
    offset = [p - x for p, x in zip(place, middle, strict=True)]
    radii_away = math.hypot(*(d / r for d, r in zip(offset, radii_m, strict=True)))
    return math.hypot(*offset) * (1.0 - 1.0 / radii_away) if radii_away > 1.0 else 0.0


def first_below(history: History, truth: Vector) -> int | None:
    """The iteration from which on the relative error stayed below the paper's figure; None if it is not."""
    limit_m = PASS_PERCENT / 100.0 * distance_m((0, 0, 0), truth)
    since = None
    for state in history.iterations():
        good = state.posterior_m is not None and distance_m(state.posterior_m, truth) < limit_m
        if not good:
            since = None
        elif since is None:
            since = state.t
    return since


def control(histories: Iterable[History], depth_m: float) -> dict[str, float | None]:
    """How still the armed robots hung, by their own pressure sensors."""
    armed = [s for h in histories for s in h.states if s.armed and s.depth_m is not None]
    tilts = [math.hypot(s.roll_deg or 0.0, s.pitch_deg or 0.0) for s in armed]
    return {
        "depth_rms_mm": rms((s.depth_m or 0.0) - depth_m for s in armed) * 1e3 if armed else None,
        "tilt_rms_deg": rms(tilts) if armed else None,
    }


def reasons(rows: dict[str, dict[str, Any]]) -> list[str]:
    """Why the run failed; empty when every robot's estimate is as good as it has to be."""
    found = []
    for robot, row in rows.items():
        is_box = "outside_mm" in row
        if row["error_mm"] is None:
            found.append(f"{robot} has no estimate")
        elif is_box and row["outside_mm"] > row["allowed_mm"]:
            found.append(f"{robot}: {row['outside_mm']:.1f} mm outside of it > {row['allowed_mm']:.1f} mm")
        elif not is_box and row["relative_error_percent"] >= PASS_PERCENT:
            found.append(f"{robot}: relative error {row['relative_error_percent']:.2f} % >= {PASS_PERCENT} %")
        if row["acquired_iteration"] is None and not is_box:  # others tell it where a thing is that it cannot see
            found.append(f"{robot} never saw the target")
    return found


def distance_m(a: Vector, b: Vector) -> float:
    """Euclidean."""
    return math.dist(a, b)


def rms(values: Iterable[float]) -> float:
    """Root mean square; not a number of nothing."""
    squares = [v * v for v in values]
    return math.sqrt(math.fsum(squares) / len(squares)) if squares else math.nan
