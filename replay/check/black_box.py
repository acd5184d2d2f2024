"""A robot's recording as the argument list it is: what `Agent.step` was called with, and what it answered.

The file says everything that a fresh `Agent` needs: fleet file and calibration as attachments, robot and incarnation in
its header. Between the steps nothing else reaches the kernel, so nothing else is read here.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, TypeVar

from agent.core.codec import READABLE
from agent.core.config import ConfigError, Fleet, convert
from agent.core.messages import SCHEMA
from agent.core.ranging.camera_model import Calibration
from agent.robot.step import Agent
from replay.files.channels import STEP_IN, STEP_OUT
from replay.files.info import damages
from replay.files.log import info, parts, read
from replay.files.mcap_walk import run_note
from replay.files.names import standing
from replay.files.suspect import suspecting

T = TypeVar("T")

NEEDED = "give the black box of a robot: the <robot>.mcap that its agent wrote"
DIGITS = 20  # of a number in a header that is repeated in a line for people
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
    schema: int = SCHEMA  # of its messages

    def agent(self) -> Agent:
        """The robot's agent as it was before its first step."""
        return Agent(self.fleet, self.robot, self.calibration, self.incarnation, schema=self.schema)

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
            has = "only the recording of a fleet" if recordings(path, "fleet") else "no recording (.mcap)"
            raise ConfigError(f"{path}: has {has} in it; {NEEDED}, or the folder of a run with some")
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
    return sorted(first for first in there if _kind(parts(first)[0]) == kind)


def _kind(file: Path) -> str | None:
    """What the header of a file says. Raises ConfigError for a finished file that has lost it: it may be any."""
    run, sound = run_note(file)
    if not run and not sound and file.suffix == ".mcap":
        raise ConfigError(f"{file}: damaged: its header cannot be read; move it away to do without it")
    return run.get("kind")


def open_box(path: Path) -> BlackBox:
    """Read the header of a black box. Raises ConfigError as `open_boxes` does."""
    with suspecting(path):
        return _open_box(path)


def _open_box(path: Path) -> BlackBox:
    heads = [head(file) for file in parts(path)]
    run, attachments = heads[0].run, heads[0].attachments
    if run.get("kind") != "black box":
        kinds = {"fleet": "is the recording of a fleet, which holds no inputs of a robot"}
        raise ConfigError(f"{path}: {kinds.get(run.get('kind', ''), 'is no black box')}; {NEEDED}")
    schema = schema_of(path, run)
    needs = [name for name in ("robot", "incarnation") if name not in run]
    needs += [name for name in ("fleet.toml", "calibration.toml") if name not in attachments]
    if needs:
        raise ConfigError(f"{path}: has no {needs[0]}, so its agent cannot be built again; record with this version")
    if (part := run.get("part", "1")) != "1":
        raise ConfigError(f"{path}: is part {part[:DIGITS]}, and its steps build on those before; give the first part")
    fleet = attached_toml(path, "fleet.toml", attachments, Fleet)
    if run["robot"] not in fleet.robot or not run["incarnation"].isdecimal():
        raise ConfigError(f"{path}: damaged: its header names no robot of its fleet, or no start; take another copy")
    return BlackBox(
        path=path,
        robot=run["robot"],
        incarnation=int(run["incarnation"]),
        fleet=fleet,
        calibration=attached_toml(path, "calibration.toml", attachments, Calibration),
        run=run,
        recorded=sum(each.steps for each in heads),
        complete=all(each.complete for each in heads),
        schema=schema,
    )


def schema_of(path: Path, run: Mapping[str, str]) -> int:
    """The schema of a recording's messages, by its header. Raises ConfigError if we cannot read it."""
    schema = run.get("schema", str(SCHEMA))
    if schema not in map(str, READABLE):
        said = schema[:DIGITS]
        raise ConfigError(f"{path}: message schema {said}, ours is {SCHEMA}; replay it with the version it names")
    return int(schema)


def attached_toml(path: Path, name: str, attachments: Mapping[str, str], kind: type[T]) -> T:
    """An attachment as the struct it holds. Raises ConfigError, one line."""
    try:
        return convert(tomllib.loads(attachments[name]), kind, path / name)
    except (tomllib.TOMLDecodeError, RecursionError):
        raise ConfigError(f"{path}: damaged: {name} in it is no TOML; take another copy of the file") from None


class Head(NamedTuple):
    """What is needed of one file before its messages are read."""

    run: dict[str, str]
    attachments: dict[str, str]
    steps: int
    complete: bool


def head(file: Path) -> Head:
    """What a file says of itself, after a walk through all of it. Raises ConfigError where it is not as it was written.

    A torn file is not refused: what is before the tear is sound.
    """
    about = info(file)
    if about.damage:
        lasts = any(each.lasts for each in about.damage)
        remedy = "take another copy of it" if lasts else "`aucamp replay recover` makes a sound copy; open that one"
        raise ConfigError(f"{file}: damaged: {damages(about.damage)}; {remedy}")
    if about.torn and not about.run and about.channels:
        raise ConfigError(f"{file}: damaged: its header cannot be read; take another copy of it")
    steps = about.channels[STEP_IN.name].messages if STEP_IN.name in about.channels else 0
    return Head(about.run, about.attachments, steps, about.complete)
