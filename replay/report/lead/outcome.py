"""What came of a run, as figures: what its sentence is made of."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

from agent.core.status import fault_kind
from replay.report.lead.ends import End
from replay.report.robot_timeline import RobotTimeline
from replay.report.run import Run
from replay.report.surveyed import Surveyed

EARLY_S = 3.0  # before the last one: that early a robot ended, or fell silent, as on the page
LOUD = ("warning", "error")  # levels of the log
ORDERED = " orders: "  # agent.kernel.desk: what people ordered is no trouble
SWEEP = "sweep"  # that one comes to nothing is no trouble: the next one follows
OVER = "over: "  # agent.core.status: the end of a fault


class Found(NamedTuple):
    """What became of one target. Times are seconds of the run, by robot."""

    target: str
    seen_s: Mapping[str, float]  # who saw it, first when
    known_s: Mapping[str, float]  # who knew where it is, first when
    sigma_m: Mapping[str, float]  # who holds a place of it at the end, and how surely
    off_m: Mapping[str, float]  # how far each was off at the end; empty: nobody knows the truth
    has_size: bool = False  # a thing in a box: its surface is measured, and the truth is of its middle
    apart_m: float | None = None  # between the two places held that differ most; None of one that swims
    in_view: tuple[float, float] | None = None  # of one that swims: shares of the time, least and largest
    track_rms_m: float | None = None  # of one that swims: the robots' tracks off the true one


class Survey(NamedTuple):
    """How far it came: of what is wanted, by the robot that knows least."""

    share: float
    wanted: float
    keyframes: int
    alike: bool  # all maps are the same


# Its recording was finished by its writer; it was not; there is none, and this is what others heard of it.
Ending = Literal["ended", "torn", "silent"]


class RobotOutcome(NamedTuple):
    """How one robot fared."""

    ends_s: float
    starts: int = 1
    mode: str = "running"
    ending: Ending = "ended"
    faults: tuple[str, ...] = ()  # that stand at the end
    warned: tuple[str, ...] = ()  # what else its log warns of, each kind once


class Outcome(NamedTuple):
    fleet: tuple[str, ...]  # all robots of the fleet file
    robots: Mapping[str, RobotOutcome]  # those that were heard
    targets: tuple[Found, ...]
    missing: tuple[str, ...] = ()  # of whom there should be something, and is nothing
    survey: Survey | None = None
    torn: tuple[str, ...] = ()  # recordings that nobody finished
    verdict: str = ""  # the demo's own: pass, fail; nothing for a run without
    reasons: tuple[str, ...] = ()  # why it failed

    @property
    def lasted_s(self) -> float:
        return max((robot.ends_s for robot in self.robots.values()), default=0.0)


def outcome(run: Run, at_end: Sequence[End], survey: Surveyed | None) -> Outcome:
    """By the recordings; a share of a survey and what a track was worth as the demo found it, where it did."""
    summary = run.summary or {}
    torn = [box.path.name for box in run.boxes if not box.complete]
    torn += [run.fleet_file.path.name] if run.fleet_file and not run.fleet_file.complete else []
    heard = {timeline.robot for timeline in run.robots}
    alone = run.fleet_file is None and not run.path.is_dir()  # one robot's recording, and only that was asked for
    return Outcome(
        fleet=tuple(run.fleet.robot),
        robots={timeline.robot: _robot(timeline) for timeline in run.robots},
        targets=tuple(
            _found(
                target,
                about.speed_m_s is not None,
                about.detector == "box",
                [end for end in at_end if end.target == target],
                summary.get("targets", {}).get(target, {}),
            )
            for target, about in run.fleet.target.items()
        ),
        missing=tuple(name for name in run.fleet.robot if name not in heard) if not alone else (),
        survey=_survey(run, survey),
        torn=tuple(torn),
        verdict=summary.get("verdict", ""),
        reasons=tuple(summary.get("reasons", ())),
    )


def _found(target: str, swims: bool, has_size: bool, of: Sequence[End], by_demo: Mapping[str, Any]) -> Found:
    held = [end.x_m for end in of if end.sigma_m is not None and end.x_m is not None]
    seen = [row["seen"] for row in by_demo.get("agents", {}).values() if row.get("seen") is not None] if swims else []
    rms_mm = by_demo.get("track_rms_mm") if swims else None
    return Found(
        target=target,
        seen_s={end.robot: end.seen_s for end in of if end.seen_s is not None},
        known_s={end.robot: end.known_s for end in of if end.known_s is not None},
        sigma_m={end.robot: end.sigma_m for end in of if end.sigma_m is not None},
        off_m={end.robot: end.off_m for end in of if end.off_m is not None and end.sigma_m is not None},
        has_size=has_size,
        apart_m=max((math.dist(a, b) for a, b in itertools.combinations(held, 2)), default=None) if not swims else None,
        in_view=(min(seen), max(seen)) if seen else None,
        track_rms_m=None if rms_mm is None else 1e-3 * rms_mm,
    )


def _survey(run: Run, found: Surveyed | None) -> Survey | None:
    if run.fleet.coverage is None or found is None:
        return None
    lasts = [rows[-1] for rows in found.known.values() if rows]
    if not lasts:
        return None
    return Survey(
        share=min(last.share for last in lasts),
        wanted=run.fleet.coverage.share,
        keyframes=len(found.frames),
        alike=len({last.digest for last in lasts}) == 1,
    )


def _robot(timeline: RobotTimeline) -> RobotOutcome:
    last = timeline.states[-1][1] if timeline.states else None
    warned: dict[str, None] = {}
    for _, line in timeline.log:
        if (
            line.level in LOUD
            and ORDERED not in line.text
            and SWEEP not in line.text
            and not line.text.startswith(OVER)
        ):
            warned.setdefault(fault_kind(line.text))
    faults = last.faults if last is not None else ()
    kinds = {fault_kind(fault) for fault in faults}
    return RobotOutcome(
        ends_s=timeline.ends_s,
        starts=max(1, len(timeline.starts_s)),
        mode=last.mode if last is not None else "running",
        ending="silent" if not timeline.boxes else "ended" if timeline.boxes[-1].complete else "torn",
        faults=faults,
        warned=tuple(kind for kind in warned if kind not in kinds),
    )
