"""Each robot at the end of a run, by target: what sentence, picture and tables say of it comes from here."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agent.core.messages import State, Symmetric, Vector
from replay.report.creature_track import Path3, true_path
from replay.report.robot_timeline import RobotTimeline
from replay.report.run import Run


class End(NamedTuple):
    """One robot and one target."""

    robot: str
    target: str
    label: str  # the robot, and the target where there are several
    known_s: float | None  # when it first knew where the target is; None: it never did
    seen_s: float | None  # when it first said that it sees it
    last: State | None  # what it showed last
    x_m: Vector | None  # the last place that it held, world frame
    cov_m2: Symmetric | None
    held_s: float | None  # when it last said so
    truth_m: Vector | None  # where the target was then, by the twin
    off_m: float | None  # between these two

    @property
    def sigma_m(self) -> float | None:
        """What it states of the place that it holds at the end; None: it holds none then."""
        return None if self.last is None or self.last.posterior_m is None else self.last.posterior_sigma_m


def ends(run: Run) -> list[End]:
    """In the order of the timelines."""
    ways = {target: truth_of(run, target) for target in run.fleet.target}
    return [_end(run, timeline, ways[timeline.target]) for timeline in run.timelines]


def truth_of(run: Run, target: str) -> Path3 | None:
    """The true way of a target that swims; None of one that rests, and where no twin has left it."""
    folder = run.path if run.path.is_dir() else run.path.parent
    return None if run.fleet.target[target].speed_m_s is None else true_path(folder, target)


def _end(run: Run, timeline: RobotTimeline, way: Path3 | None) -> End:
    held_s = [t_s for t_s, state in timeline.states if state.posterior_m is not None]
    estimate, truth_m = timeline.estimate, run.truths_m.get(timeline.target)
    if held_s and way is not None:
        at = way.at([(run.start_ns or 0) + round(held_s[-1] * 1e9)])[0]
        truth_m = None if np.isnan(at).any() else (float(at[0]), float(at[1]), float(at[2]))
    return End(
        robot=timeline.robot,
        target=timeline.target,
        label=timeline.label,
        known_s=held_s[0] if held_s else None,
        seen_s=next((t_s for t_s, state in timeline.states if state.knows == "sees"), None),
        last=timeline.beliefs[-1].state if timeline.beliefs else None,
        x_m=estimate[0] if estimate else None,
        cov_m2=estimate[1] if estimate else None,
        held_s=held_s[-1] if held_s else None,
        truth_m=truth_m,
        off_m=math.dist(estimate[0], truth_m) if estimate and truth_m else None,
    )
