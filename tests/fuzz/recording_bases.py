"""Small sound recordings of each kind, to be harmed: as today's writers make them, and as older ones did."""

from __future__ import annotations

import tempfile
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import cv2
from mcap.writer import Writer

from replay.check.reexecute import open_box
from replay.files.channels import STEP_OUT, Entry
from replay.files.info import info
from replay.files.log import read
from replay.files.mcap_file import Part
from replay.recorder import BlackBoxWriter, black_box_log
from tests.golden.make import Case, dive
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run
from tests.replay.paced_clock import PacedClock
from tests.replay.small_box import CALIBRATION, FLEET, START_NS, STEP_NS, disc, seen

STEPS = 24  # of the robots' own steps: the first words and states; sweeps are in the long one
CHUNK_BYTES = 16 * 1024
SMALL = (0, 0, 64, 48)


class Base(NamedTuple):
    """A sound recording."""

    label: str
    path: Path
    name: str  # what its mutants are called
    digests: bool


@cache
def bases() -> tuple[Base, ...]:
    """All of them, in a folder that goes with the process."""
    folder = Path(_folder().name)
    golden = GOLDEN / "schema1"
    dive(Case("evidence", 9.0), folder / "today")
    new = _box(folder / "today" / "r1.mcap", folder / "r1.mcap", STEPS)
    torn = folder / "torn.mcap"
    torn.write_bytes(new.read_bytes()[: round(0.8 * new.stat().st_size)])
    return (
        Base("new", new, "r1.mcap", True),
        Base("old", _old(golden / "r1.mcap", folder / "old.mcap"), "r1.mcap", False),
        Base("long", _box(folder / "today" / "r2.mcap", folder / "long.mcap", 180), "r2.mcap", True),
        Base("frames", _frames(folder / "frames"), "r1.mcap", True),
        Base("fleet", _fleet(folder / "today", folder), "fleet.mcap", True),
        Base("torn", torn, "r1.mcap.active", False),
    )


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory()


def _box(source: Path, out: Path, steps: int) -> Path:
    """The first steps of a black box, written by today's writer."""
    about = info(source)
    part = Part(out)
    part.start(about.run, about.attachments)
    for record in takewhile(lambda each: each.sequence < steps, read(source)):
        part.add(Entry(*record, "msgpack", {}))
        if record.channel == STEP_OUT.name and record.sequence % (steps // 2) == steps // 2 - 1:
            part.flush()
    part.finish("aucamp.end", {"cause": "clean", "dropped": "{}"})
    return out


def _old(source: Path, out: Path) -> Path:
    """The same as recorders wrote it before digests."""
    about = info(source)
    with out.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES)
        writer.start()
        writer.add_metadata("aucamp.run", {key: said for key, said in about.run.items() if "sha256" not in key})
        for name, text in about.attachments.items():
            writer.add_attachment(0, 0, name, "text/plain", text.encode())
        channels = {name: writer.register_channel(name, "msgpack", 0) for name in about.channels}
        for each in takewhile(lambda each: each.sequence < STEPS, read(source)):
            writer.add_message(channels[each.channel], each.log_time_ns, each.data, each.publish_time_ns, each.sequence)
        writer.add_metadata("aucamp.end", about.end)
        writer.finish()
    return out


def _frames(folder: Path) -> Path:
    """A black box with a sweep of small frames, and the channels for viewers."""
    clock = PacedClock(START_NS, 1.0)
    run = {"kind": "black box", "robot": "r1", "incarnation": 1}
    with black_box_log(folder, FLEET, "r1", CALIBRATION, run, True) as log:
        box = BlackBoxWriter(log, "r1", clock.now_ns)
        for step in range(11):
            clock.go_on(STEP_NS * 1e-9)
            small = cv2.resize(disc(step), (SMALL[2], SMALL[3]))
            box.frame(small, SMALL, seen(clock.now_ns(), step))
            box.serial(True, b"\x01telemetry\x00")
    return log.path


def _fleet(today: Path, folder: Path) -> Path:
    """A fleet file of three robots."""
    short = folder / "three"
    short.mkdir()
    for robot in ("r1", "r2", "r3"):
        _box(today / f"{robot}.mcap", short / f"{robot}.mcap", STEPS)
        assert open_box(short / f"{robot}.mcap").complete
    return overheard_run(short, folder / "fleet.mcap")
