"""Whether anything in a dive came late, from what it left: recordings and logs. All in run time."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import NamedTuple

from agent.core.codec import decode
from agent.core.step_io import Inputs, Sighting
from replay.files.channels import STEP_IN, VISION
from replay.files.log import read

MAX_INPUTS = 1 << 20
LONGEST_STEP_S = 0.08  # steps are 0.05 s apart, and time waits for one that is 0.025 s late


class Timing(NamedTuple):
    """Of one robot, the worst of the whole dive."""

    step_gap_s: float  # between two steps of its loop, 0.05 by design
    silence_s: float  # between telemetry of its control module, 0.02 by design
    sweep_gap_frames: int  # of the sensor, between two lens positions of a sweep
    frames: int


def timing(black_box: Path) -> Timing:
    """What the recording of one robot shows."""
    steps_ns: list[int] = []
    telemetry_ns: list[int] = []
    seen: dict[tuple[int, int], int] = {}  # sweep and index -> number of the sensor's frame
    frames = 0
    for record in read(black_box):
        if record.channel == STEP_IN.name:
            steps_ns.append(record.log_time_ns)
            telemetry_ns += [t.t_ns for t in decode(record.data, Inputs, limit=MAX_INPUTS).telemetry]
        elif record.channel == VISION.name:
            sighting = decode(record.data, Sighting)
            frames += 1
            if sighting.sweep:
                seen[sighting.sweep, sighting.index] = sighting.frame
    gaps = [seen[sweep, index + 1] - frame for (sweep, index), frame in seen.items() if (sweep, index + 1) in seen]
    return Timing(longest(steps_ns) * 1e-9, longest(telemetry_ns) * 1e-9, max(gaps, default=0), frames)


def longest(stamps_ns: list[int]) -> int:
    return max((b - a for a, b in itertools.pairwise(stamps_ns)), default=0)


def nothing_came_late(twin_log: str, *boxes: Path) -> None:
    """The twin has nothing to tell but how it began and how time went, and no step waited for the machine."""
    began, went = twin_log.splitlines()
    assert began.startswith("twin: r1, r2") and "s of dive in" in went and "times real time" in went, twin_log
    for box in boxes:
        assert (found := timing(box)).step_gap_s < LONGEST_STEP_S, (box, found)
