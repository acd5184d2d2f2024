"""What there is of one run, gathered for its report: black boxes, the fleet file, and what a twin knows."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agent.core.config import ConfigError, Fleet
from agent.core.messages import Vector
from agent.robot.fleet_reader import load_fleet
from replay.check.black_box import BlackBox, black_boxes, head, open_boxes, recordings
from replay.check.links import Link, links
from replay.files.channels import CLOCK
from replay.files.clock_rate import Moment, in_dive, moment
from replay.files.log import read
from replay.files.names import parts
from replay.report.fleet_timeline import FleetFile, Overheard, open_fleet_file, overheard
from replay.report.robot_timeline import RobotTimeline, first_ns, timelines


class Run(NamedTuple):
    path: Path
    fleet: Fleet
    boxes: list[BlackBox]
    fleet_file: FleetFile | None  # only where some robot left no black box
    timelines: list[RobotTimeline]  # by robot and target
    links: list[Link]
    summary: dict[str, Any] | None  # what the demo found
    truths_m: dict[str, Vector]  # by target, where a twin knows it
    start_ns: int | None  # since when times are counted: the first step of any robot
    clock: list[Moment]  # of a dive in the twin, how fast its clock went

    @property
    def robots(self) -> list[RobotTimeline]:
        """One timeline for each robot: what is not about a target is the same in all."""
        return list({timeline.robot: timeline for timeline in reversed(self.timelines)}.values())[::-1]

    def about(self, target: str) -> list[RobotTimeline]:
        return [timeline for timeline in self.timelines if timeline.target == target]


def open_run(path: Path) -> Run:
    """A run's folder, or one recording of either kind. What robots without a black box said comes from the fleet file.

    Raises ConfigError if there is nothing to show, or if a recording cannot be read by this version.
    """
    summary = _summary(path)
    boxes, fleet_path = _recordings(path)
    if not boxes and summary is None and fleet_path is None:
        raise ConfigError(f"{path}: no recording and no summary.json; give the folder of a run, or a recording")
    start_ns = first_ns(boxes)
    drawn, heard, file = timelines(boxes), links(boxes), None
    known = {box.robot for box in boxes}
    if fleet_path is not None and (not boxes or known != set(boxes[0].fleet.robot)):
        file = open_fleet_file(fleet_path)
        more = overheard(file, start_ns, known)
        start_ns = more.start_ns
        drawn = sorted([*drawn, *more.timelines], key=lambda timeline: timeline.robot)
        heard = _joined(heard, more, known)
    fleet = boxes[0].fleet if boxes else file.fleet if file else load_fleet(path / "fleet.toml")
    clock = _clock([*(box.path for box in boxes), *([file.path] if file else [])])
    return Run(path, fleet, boxes, file, drawn, heard, summary, _truths(summary, fleet), start_ns, clock)


def _recordings(path: Path) -> tuple[list[BlackBox], Path | None]:
    if path.is_dir():
        return open_boxes(black_boxes(path)), next(iter(recordings(path, "fleet")), None)
    if head(parts(path)[0]).run.get("kind") == "fleet":
        return [], path
    return open_boxes([path]), None


def _clock(paths: Iterable[Path]) -> list[Moment]:
    """The notes of one clock in all these recordings."""
    notes = (
        moment(record.log_time_ns, record.data)
        for path in paths
        for record in read(path)
        if record.channel == CLOCK.name
    )
    return in_dive(each for each in notes if each is not None)


def _joined(heard: Sequence[Link], more: Overheard, known: set[str]) -> list[Link]:
    """Links by black boxes where both ends left one, by the fleet file where not."""
    between = [link for link in heard if link.src in known and link.dst in known]
    return sorted([*between, *(link for link in more.links if not {link.src, link.dst} <= known)])


def _summary(run: Path) -> dict[str, Any] | None:
    """What the demo found; None for a run without one."""
    path = run / "summary.json"
    if not path.exists():
        return None
    try:
        summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise ConfigError(f"{run}: no usable summary.json; repair it, or remove it to do without the truth") from None
    return summary


def _truths(summary: dict[str, Any] | None, fleet: Fleet) -> dict[str, Vector]:
    if summary is None:
        return {}
    first: dict[str, dict[str, Any]] = {next(iter(fleet.target)): {"truth_m": summary["truth_m"]}}  # of older summaries
    resting = {target: about for target, about in summary.get("targets", first).items() if not about.get("swims")}
    return {target: tuple(about["truth_m"]) for target, about in resting.items()}
