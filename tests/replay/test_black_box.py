"""What the loop leaves in the black box: every step, also the one that broke."""

import threading
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from agent.clock.clock import SystemClock
from agent.core.codec import decode, encode
from agent.core.messages import LogLine, State
from agent.core.step_io import Inputs, Outputs, SetPoint, Sighting
from agent.process.agent_process import Runtime
from replay.files.channels import LINES, STEP_IN, STEP_OUT, VISION
from replay.files.frames import EXACT_EVERY, WHOLE_EVERY, Frames, Picture, pixels
from replay.files.info import info
from replay.files.log import read
from replay.recorder import BlackBoxWriter, black_box_log
from tests.replay.small_box import CALIBRATION, FLEET, START_NS, disc, seen, state


class Still:
    """Camera, control module and network of a robot to which nothing happens."""

    def drain(self) -> tuple[tuple, tuple]:
        return (), ()

    def orders(self) -> tuple:
        return ()

    def send(self, set_point: SetPoint, now_ns: int) -> None: ...

    def show(self, message: State | LogLine) -> None: ...


class StillCamera(Still):
    def drain(self) -> tuple:
        return ()

    views = drain


class Breaks:
    """An agent whose third step raises."""

    def __init__(self) -> None:
        self.steps = 0

    def step(self, inputs: Inputs, now_ns: int) -> Outputs:
        self.steps += 1
        if self.steps == 3:
            raise ZeroDivisionError
        return Outputs(set_point=SetPoint(depth_m=0.1 * self.steps), state=state(now_ns, self.steps))


def test_the_inputs_that_broke_a_step_are_recorded(tmp_path: Path) -> None:
    log = black_box_log(tmp_path, FLEET, "r1", CALIBRATION, {"kind": "black box"}, views=True)
    still = Still()
    with pytest.raises(ZeroDivisionError), log:
        box = BlackBoxWriter(log, "r1", lambda: START_NS)
        Runtime("r1", Breaks(), StillCamera(), still, still, box.step, SystemClock()).run(threading.Event())
    records = [record for record in read(log.path) if record.channel in (STEP_IN.name, STEP_OUT.name)]
    assert [(record.channel, record.sequence) for record in records] == [
        (STEP_IN.name, 0),
        (STEP_OUT.name, 0),
        (STEP_IN.name, 1),
        (STEP_OUT.name, 1),
        (STEP_IN.name, 2),
    ]
    assert records[4].data == encode(Inputs())
    assert decode(records[3].data, Outputs).set_point.depth_m == 0.2
    assert info(log.path).end["cause"] == "exception:ZeroDivisionError"


class Talks(Still):
    """A control module whose driver has something to say."""

    def drain(self) -> tuple[tuple, tuple]:
        return (), (("warning", "cable: bytes are lost"),)


def test_lines_that_no_step_says_are_recorded(tmp_path: Path) -> None:
    with black_box_log(tmp_path, FLEET, "r1", CALIBRATION, {"kind": "black box"}, views=True) as log:
        box = BlackBoxWriter(log, "r1", lambda: START_NS)
        runtime = Runtime("r1", Breaks(), StillCamera(), Talks(), Still(), box.step, SystemClock(), keep=box.line)
        runtime.step(0)
        runtime.step(1)
    said = [decode(record.data, LogLine).text for record in read(log.path) if record.channel == LINES.name]
    assert said == 2 * ["cable: bytes are lost"]
    assert info(log.path).channels[LINES.name].metadata["schema"] == LINES.schema


def test_a_second_start_keeps_the_first_recording(tmp_path: Path) -> None:
    paths = []
    for _ in range(2):
        with black_box_log(tmp_path, FLEET, "r1", CALIBRATION, {}, views=False) as log:
            paths.append(log.path.name)
    assert paths == ["r1.mcap", "r1.2.mcap"]
    assert set(info(tmp_path / "r1.2.mcap").attachments) == {"fleet.toml", "calibration.toml"}


WHOLE, PART = (0, 0, 640, 480), (190, 110, 260, 260)


def recorded(
    folder: Path, said: Iterable[Sighting], lossless: bool = False, measured=PART, coarse: bool = False
) -> list[Picture]:
    """What a black box has of whole frames with these sightings."""
    log = black_box_log(folder, FLEET, "r1", CALIBRATION, {"kind": "black box"}, views=False)
    with log:
        box = BlackBoxWriter(log, "r1", lambda: START_NS, lossless)
        for k, sighting in enumerate(said):
            box.frame(disc(k % 3), WHOLE, sighting, measured=measured, coarse=coarse)
    frames, found = Frames(), []
    for record in read(log.path):
        frames.take(record.channel, record.sequence, record.data)
        if record.channel == VISION.name:
            found.append(frames.at(record.sequence))
    return found


def test_of_a_sweep_the_part_that_was_measured_is_recorded_and_says_where_it_lies(tmp_path: Path) -> None:
    swept = [seen(START_NS, 1)] * (EXACT_EVERY + 2)
    pictures = recorded(tmp_path, swept)
    assert len(pictures) == len(swept)
    assert [k for k, each in enumerate(pictures) if each.roi == WHOLE] == list(range(0, len(swept), WHOLE_EVERY))
    assert [k for k, each in enumerate(pictures) if each.format == "png"] == [0, EXACT_EVERY]
    x, y, width, height = PART
    assert pictures[1].roi == PART and pixels(pictures[1]).shape == (height, width, 3)
    there = pixels(pictures[1]).astype(int) - disc(1)[y : y + height, x : x + width]
    assert np.abs(there).mean() < 4.0, "another part of the frame would be another picture"
    assert len(pictures[1].data) < 0.4 * len(pictures[WHOLE_EVERY].data)


def test_what_is_recorded_bit_by_bit_stays_whole_and_a_part_outside_the_frame_is_refused(tmp_path: Path) -> None:
    pictures = recorded(tmp_path / "a", [seen(START_NS, 1)] * 3, lossless=True)
    assert {(each.roi, each.format) for each in pictures} == {(WHOLE, "png")}
    with pytest.raises(ValueError, match="is not within"):
        recorded(tmp_path / "b", [seen(START_NS, 1)] * 2, measured=(600, 0, 41, 40))


def test_a_frame_in_which_no_clarity_is_measured_is_coarse(tmp_path: Path) -> None:
    still = [seen(START_NS, 0)] * 3
    fine, coarse = (
        [len(each.data) for each in recorded(tmp_path / str(way), still, measured=None, coarse=way)][1:]
        for way in (False, True)
    )
    assert max(coarse) < 0.7 * min(fine)
