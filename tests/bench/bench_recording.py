"""What recording a dive takes, and checking it again: processor time."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from agent.core import topics
from agent.core.codec import decode, encode
from agent.core.step_io import Outputs, Sighting
from agent.experiments.claim import Figure, Row
from agent.process.command import Failed
from agent.robot.fleet_reader import load_fleet
from replay.check.check import check
from replay.files.channels import STEP_OUT, Entry
from replay.files.frames import frame_entries
from replay.files.log import LogWriter, read
from replay.viewers.viewer_channels import ViewerChannels
from tests.bench.timing import Settings, claim_of_costs, medians_ms
from tests.perception.painted import ball_frame
from tests.places import GOLDEN, ROOT

FLEET = load_fleet(ROOT / "agent" / "fleets" / "tank.toml")
DIVE = GOLDEN / "three"  # recordings of three moored robots, without frames
CHECKED = ("three", "three_evidence", "swim")
FRAME_NS = 100_000_000
FLUSHED_NS = 300_000_000


# --- what is recorded ---


def black_box(image: np.ndarray) -> list[Entry]:
    """The steps of one robot, and ten frames a second."""
    steps = [Entry(*record, "msgpack", {}) for record in read(DIVE / "r1.mcap")]
    times_ns = range(steps[0].log_time_ns, steps[-1].log_time_ns, FRAME_NS)
    frames = [entry for number, now_ns in enumerate(times_ns) for entry in recorded(image, number, now_ns)]
    return sorted([*steps, *frames], key=lambda entry: entry.log_time_ns)


def recorded(image: np.ndarray, number: int, now_ns: int, lossless: bool = False) -> tuple[Entry, Entry]:
    seen = Sighting(t_ns=now_ns, frame=number, target="ball", found=False)
    return frame_entries("r1", number, now_ns, image, (0, 0, 640, 480), seen, lossless)


def fleet_file() -> list[Entry]:
    """What three robots say and show, as `aucamp record` hears it."""
    entries = []
    for name in ("r1", "r2", "r3"):
        for record in read(DIVE / f"{name}.mcap"):
            if record.channel != STEP_OUT.name:
                continue
            outputs = decode(record.data, Outputs)
            told = {topics.key(topics.LINK, fleet="tank", src=name, dst=one.dst): one for one in outputs.says}
            if outputs.state is not None:
                told[topics.key(topics.STATE, fleet="tank", robot=name)] = outputs.state
            entries += [Entry(f"/zenoh/{key}", *record[1:4], encode(one), "msgpack", {}) for key, one in told.items()]
    return sorted(entries, key=lambda entry: entry.log_time_ns)


# --- the ways ---


def ours(path: Path, entries: Sequence[Entry], derive: ViewerChannels) -> None:
    """Through the writer, 0.3 s of messages at a time, so that it flushes as it does in a dive. Raises Failed."""
    path.unlink(missing_ok=True)
    with LogWriter(path, {}, derive=derive) as log:
        until_ns = entries[0].log_time_ns
        for entry in entries:
            if entry.log_time_ns >= until_ns:
                until_ns += FLUSHED_NS
                log._wake.set()  # its own clock is real time, this run is faster
                while len(log._backlog):
                    time.sleep(0.0005)
            log.put(entry)
    if log.failed:
        raise Failed(str(log.failed))


def plain(path: Path, entries: Sequence[Entry]) -> None:
    """By the MCAP library as it comes: one large chunk and no flush, which is lost when the process is killed."""
    ids: dict[str, int] = {}
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for entry in entries:
            if entry.channel not in ids:
                ids[entry.channel] = writer.register_channel(entry.channel, entry.encoding, 0)
            writer.add_message(ids[entry.channel], entry.log_time_ns, entry.data, entry.publish_time_ns, entry.sequence)
        writer.finish()


def write(times: int, folder: Path) -> Row:
    """A black box and a fleet's file; the black box by the library; one frame of it."""
    image, path = ball_frame((0.0, 0.0, 0.46)), folder / "r1.mcap"
    box, fleet = black_box(image), fleet_file()
    ways = {
        "box": lambda: ours(path, box, ViewerChannels(FLEET, "r1")),
        "box_by_mcap": lambda: plain(path, box),
        "fleet": lambda: ours(path, fleet, ViewerChannels(FLEET)),
        "jpeg": lambda: recorded(image, 1, 0),
        "png": lambda: recorded(image, 1, 0, lossless=True),
    }
    row = medians_ms(ways, times, time.process_time)
    dive_ms = 1e-6 * (box[-1].log_time_ns - box[0].log_time_ns)
    return {**row, "box_core": 100.0 * row["box"] / dive_ms, "fleet_core": 100.0 * row["fleet"] / dive_ms}


def replay(times: int, folder: Path) -> Row:
    """How many times faster than the dive its recordings are checked, from file to verdict. Raises Failed."""
    dives = {name: check([GOLDEN / name]) for name in CHECKED}
    if wrong := [name for name, found in dives.items() if found.exit_code]:
        raise Failed(f"{', '.join(wrong)}: not reproduced, so this measures the wrong thing")
    seconds = {name: max(each.recorded_s for each in found.results) for name, found in dives.items()}
    row = medians_ms({name: lambda name=name: check([GOLDEN / name]) for name in CHECKED}, times, time.process_time)
    return {name: 1e3 * seconds[name] / row[name] for name in CHECKED}


CASES = {"write": write, "replay": replay}


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        return [CASES[case](settings.times, Path(folder))]


CLAIM = claim_of_costs(
    run=run,
    cases=CASES,
    figures=(
        Figure("write.box_core", "a robot records its steps and ten frames a second", "% of a core"),
        Figure("write.box/box_by_mcap", "the same, against the MCAP library, unsafe", "times"),
        Figure("write.fleet_core", "what three robots say and show is recorded", "% of a core"),
        Figure("write.png/jpeg", "a lossless frame, against JPEG", "times"),
        Figure("replay.three", "three moored robots are checked, against real time", "times", least=20.0),
        Figure("replay.three_evidence", "the same, by evidence", "times", least=20.0),
        Figure("replay.swim", "a robot that swims is checked, against real time", "times", least=20.0),
    ),
    explanation="""Processor time of all threads of one process. The writer flushes as it does in a dive, and makes the
        channels for viewers; the MCAP library keeps all in one chunk, which is lost with the process. A check gives
        every recorded input to a fresh agent.""",
)
