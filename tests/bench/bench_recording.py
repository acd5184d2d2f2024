"""What recording a dive takes, and checking it again: processor time."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from agent.core.step_io import Sighting
from agent.experiments.claim import Figure, Row
from agent.process.command import Failed
from agent.robot.fleet_reader import load_fleet
from replay.check.check import check
from replay.files.channels import Entry
from replay.files.frames import frame_entries
from replay.files.log import LogWriter, read
from replay.viewers.viewer_channels import ViewerChannels
from tests.bench.timing import Settings, claim_of_costs, medians_ms
from tests.perception.painted import ball_frame
from tests.places import GOLDEN, ROOT

FLEET = load_fleet(ROOT / "agent" / "fleets" / "tank.toml")
CHECKED = ("three", "three_evidence", "swim")
FRAME_NS = 100_000_000
FLUSHED_NS = 300_000_000


def black_box(image: np.ndarray) -> list[Entry]:
    """The steps of one robot, and ten frames a second."""
    steps = [Entry(*record, "msgpack", {}) for record in read(GOLDEN / "three" / "r1.mcap")]
    entries = list(steps)
    for number, now_ns in enumerate(range(steps[0].log_time_ns, steps[-1].log_time_ns, FRAME_NS)):
        seen = Sighting(t_ns=now_ns, frame=number, target="ball", found=False)
        entries += frame_entries("r1", number, now_ns, image, (0, 0, 640, 480), seen, False)
    return sorted(entries, key=lambda entry: entry.log_time_ns)


def written(path: Path, entries: Sequence[Entry]) -> None:
    """Through the writer, 0.3 s of messages at a time, so that it flushes as it does in a dive. Raises Failed."""
    path.unlink(missing_ok=True)
    with LogWriter(path, {}, derive=ViewerChannels(FLEET, "r1")) as log:
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


def write(times: int, folder: Path) -> Row:
    box = black_box(ball_frame((0.0, 0.0, 0.46)))
    row = medians_ms({"box": lambda: written(folder / "r1.mcap", box)}, times, time.process_time)
    return {"box_core": 1e8 * row["box"] / (box[-1].log_time_ns - box[0].log_time_ns)}


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
        Figure("replay.three", "three moored robots are checked, against real time", "times", least=20.0),
        Figure("replay.three_evidence", "the same, by evidence", "times", least=20.0),
        Figure("replay.swim", "a robot that swims is checked, against real time", "times", least=20.0),
    ),
    explanation="""Processor time of all threads of one process. The writer flushes as it does in a dive, and makes the
        channels for viewers. A check gives every recorded input to a fresh agent.""",
)
