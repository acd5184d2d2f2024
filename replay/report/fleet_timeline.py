"""The timeline of a run as its fleet file tells it: what robots show on the network, for those without a black box.

It has what each robot believed, whom it says it heard, its depth and tilt. It has no frames, no sweeps, no pressures
and no pulses, and not what a robot really took in: that is in black boxes alone.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Container
from pathlib import Path
from typing import NamedTuple

import numpy as np

from agent.core.codec import READABLE, Refusal, decode
from agent.core.config import ConfigError, Fleet
from agent.core.messages import Answer, Estimate, LogLine, State
from replay.check.black_box import attached_toml, head, schema_of
from replay.check.links import Link
from replay.files.channels import network_topic
from replay.files.log import parts, read
from replay.report.robot_timeline import Account, Posture, RobotTimeline, label


class FleetFile(NamedTuple):
    path: Path
    fleet: Fleet
    run: dict[str, str]  # the header
    complete: bool  # finished by its writer, nothing torn


class Overheard(NamedTuple):
    timelines: list[RobotTimeline]
    links: list[Link]  # as the robots count what they heard, of what the recorder saw
    start_ns: int | None  # since when times are counted; None: nobody showed anything


def open_fleet_file(path: Path) -> FleetFile:
    """Read the header. Raises ConfigError if it is no fleet file, or one of another version."""
    heads = [head(file) for file in parts(path)]
    run, text = heads[0].run, heads[0].attachments.get("fleet.toml")
    if run.get("kind") != "fleet" or text is None:
        raise ConfigError(f"{path}: is no recording of a fleet; give what `aucamp record` wrote")
    schema_of(path, run)
    fleet = attached_toml(path, "fleet.toml", heads[0].attachments, Fleet)
    return FleetFile(path, fleet, run, all(each.complete for each in heads))


def overheard(file: FleetFile, start_ns: int | None = None, known: Container[str] = ()) -> Overheard:
    """The robots of a fleet file by name, those in `known` left out. Times are by the robots' own clocks, since
    `start_ns`, or since the first state of any of them. What does not decode is passed over.
    """
    robots = {name: _Robot() for name in file.fleet.robot}
    said: dict[tuple[str, str], set[tuple[int, int]]] = {}
    for record in read(file.path):
        row = network_topic(record.channel)
        if row is None:
            continue
        topic, chunks = row
        try:
            message = decode(record.data, topic.message, topic.limit, READABLE)
        except Refusal:
            continue
        robot = robots.get(chunks[topic.writer])
        if robot is None:
            continue
        if isinstance(message, Estimate):
            said.setdefault((message.src, message.dst), set()).add((message.incarnation, message.seq))
            robot.accounts[message.target].say(message)
        elif isinstance(message, State):
            start_ns = message.sent_ns if start_ns is None else start_ns
            robot.show(message, (message.sent_ns - start_ns) * 1e-9)
        elif isinstance(message, LogLine) and start_ns is not None:
            robot.log.append(((message.sent_ns - start_ns) * 1e-9, message))
        elif isinstance(message, Answer) and start_ns is not None:
            robot.answers.append(((message.sent_ns - start_ns) * 1e-9, message))
    found = [
        timeline
        for name, robot in robots.items()
        if name not in known
        for timeline in robot.timelines(name, file.fleet)
    ]
    heard = {(src, dst): n for dst, robot in robots.items() for src, n in robot.heard().items()}
    pairs = sorted({*said, *(pair for pair, n in heard.items() if n)})
    links = [Link(*pair, len(said.get(pair, ())), heard.get(pair, 0), 0, 0) for pair in pairs]
    return Overheard(found, links, start_ns)


class _Robot:
    """What one robot showed."""

    def __init__(self) -> None:
        self.accounts: defaultdict[str, Account] = defaultdict(Account)
        self.log: list[tuple[float, LogLine]] = []
        self.answers: list[tuple[float, Answer]] = []
        self._newest: dict[int, State] = {}  # by incarnation
        self._starts_s: list[float] = []
        self._postures: list[tuple[float, float, float, float]] = []  # t_s, depth, roll, pitch

    def show(self, state: State, t_s: float) -> None:
        if state.incarnation not in self._newest:
            self._starts_s.append(t_s)
        self._newest[state.incarnation] = state
        self.accounts[state.target].show(state, t_s)
        if state.depth_m is not None and state.roll_deg is not None and state.pitch_deg is not None:
            self._postures.append((t_s, state.depth_m, state.roll_deg, state.pitch_deg))

    def heard(self) -> Counter[str]:
        """Messages from each neighbour, by this robot's own count, over all of its starts."""
        total: Counter[str] = Counter()
        for state in self._newest.values():
            total.update({neighbour.robot: neighbour.heard for neighbour in state.neighbours})
        return total

    def timelines(self, name: str, fleet: Fleet) -> list[RobotTimeline]:
        """One for each target; none of a robot that was never up."""
        if not self._newest:
            return []
        postures = np.array(self._postures, float).reshape(-1, 4)
        unknown = np.full((len(postures), 12), np.nan)
        t_s, depth_m, roll_deg, pitch_deg = postures.T
        posture = Posture(t_s, depth_m, roll_deg, pitch_deg, unknown[:, :4], unknown[:, 4:])
        ends_s = max(account.states[-1][0] for account in self.accounts.values() if account.states)
        return [
            RobotTimeline(
                robot=name,
                target=target,
                label=label(name, target, fleet),
                boxes=(),
                starts_s=tuple(self._starts_s),
                ends_s=ends_s,
                states=tuple(self.accounts[target].states),
                beliefs=tuple(self.accounts[target].beliefs),
                sweeps=(),
                posture=posture,
                set_depth_m=(),
                log=tuple(self.log),
                answers=tuple(self.answers),
            )
            for target in fleet.target
        ]
