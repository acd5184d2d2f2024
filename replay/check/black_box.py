"""A robot's recording as the argument list it is: what `Agent.step` was called with, and what it answered.

The file says everything that a fresh `Agent` needs: fleet file and calibration as attachments, robot and incarnation in
its header. Between the steps nothing else reaches the kernel, so nothing else is read here.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from agent.kernel.config import ConfigError, Fleet
from agent.kernel.core import Agent
from agent.kernel.messages import SCHEMA
from agent.kernel.ranging.calibration import Calibration
from agent.kernel.toml_files import convert
from replay.files.channels import STEP_IN, STEP_OUT
from replay.files.log import info, parts, read
from replay.files.mcap_file import summary
from replay.files.names import standing

STEP_BYTES = 4 * 1024 * 1024  # limit of one step: this is the robot's own file, not a stranger's message


class Step(NamedTuple):
    number: int
    now_ns: int
    inputs: bytes
    outputs: bytes | None  # None: they are not in the file


class BlackBox(NamedTuple):
    """One start of one robot."""

    path: Path
    robot: str
    incarnation: int
    fleet: Fleet
    calibration: Calibration
    run: dict[str, str]  # the header
    recorded: int  # steps in the file, sound or not
    complete: bool  # finished by its writer, nothing torn

    def agent(self) -> Agent:
        """The robot's agent as it was before its first step."""
        return Agent(self.fleet, self.robot, self.calibration, self.incarnation)

    def steps(self) -> Iterator[Step]:
        """The steps in the order they were taken, up to the first that is missing: later ones build on it."""
        waiting: Step | None = None
        expected = 0
        for record in read(self.path):
            if record.channel == STEP_IN.name:
                if waiting is not None:
                    yield waiting
                if record.sequence != expected:
                    return
                waiting = Step(record.sequence, record.log_time_ns, record.data, None)
                expected += 1
            elif record.channel == STEP_OUT.name and waiting is not None and record.sequence == waiting.number:
                yield waiting._replace(outputs=record.data)
                waiting = None
        if waiting is not None:
            yield waiting


def open_boxes(paths: Iterable[Path]) -> list[BlackBox]:
    """The black boxes among files and folders, by folder, robot and start; later parts come with their first one.

    Raises ConfigError if there is none, or if one of them cannot be replayed by this version.
    """
    found = []
    for path in paths:
        files = black_boxes(path) if path.is_dir() else [path]
        if not files:
            raise ConfigError(f"{path}: no black box; give a <robot>.mcap of an agent, or the folder of a run")
        found += [open_box(file) for file in files]
    return sorted(found, key=lambda box: (str(box.path.parent), box.robot, box.incarnation))


def black_boxes(folder: Path) -> list[Path]:
    """The black boxes in a folder by their first part, whether finished, mended or torn."""
    return recordings(folder, "black box")


def recordings(folder: Path, kind: str) -> list[Path]:
    """The recordings of a kind in a folder, "black box" or "fleet", as `black_boxes` does."""
    ending = re.compile(r"(\.part\d{3,})?(\.recovered)?\.mcap(\.active)?$")
    firsts = {folder / ending.sub(".mcap", file.name) for file in folder.iterdir() if ending.search(file.name)}
    there = [first for first in firsts if standing(first) is not None]
    return sorted(first for first in there if head(parts(first)[0]).run.get("kind") == kind)


def open_box(path: Path) -> BlackBox:
    """Read the header of a black box. Raises ConfigError as `open_boxes` does."""
    heads = [head(file) for file in parts(path)]
    run, attachments = heads[0].run, heads[0].attachments
    if run.get("kind") != "black box":
        raise ConfigError(f"{path}: is no black box; give a <robot>.mcap of an agent")
    if (schema := run.get("schema", str(SCHEMA))) != str(SCHEMA):
        raise ConfigError(f"{path}: message schema {schema}, ours is {SCHEMA}; replay it with the version it names")
    needs = [name for name in ("robot", "incarnation") if name not in run]
    needs += [name for name in ("fleet.toml", "calibration.toml") if name not in attachments]
    if needs:
        raise ConfigError(f"{path}: has no {needs[0]}, so its agent cannot be built again; record with this version")
    if run.get("part", "1") != "1":
        raise ConfigError(f"{path}: is part {run['part']}, and its steps build on those before; give the first part")
    return BlackBox(
        path=path,
        robot=run["robot"],
        incarnation=int(run["incarnation"]),
        fleet=convert(tomllib.loads(attachments["fleet.toml"]), Fleet, path / "fleet.toml"),
        calibration=convert(tomllib.loads(attachments["calibration.toml"]), Calibration, path / "calibration.toml"),
        run=run,
        recorded=sum(each.steps for each in heads),
        complete=all(each.complete for each in heads),
    )


class Head(NamedTuple):
    """What is needed of one file before its messages are read."""

    run: dict[str, str]
    attachments: dict[str, str]
    steps: int
    complete: bool


def head(file: Path) -> Head:
    """What a file says of itself: read from the end of a finished one, which is quick; else by a walk through it."""
    about = summary(file)
    if about is not None and "aucamp.end" in about.notes:
        return Head(about.notes.get("aucamp.run", {}), about.attachments, about.messages.get(STEP_IN.name, 0), True)
    torn = info(file)
    steps = torn.channels[STEP_IN.name].messages if STEP_IN.name in torn.channels else 0
    return Head(torn.run, torn.attachments, steps, False)
