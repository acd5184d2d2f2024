"""What the loop leaves in the black box: every step, also the one that broke."""

import threading
from pathlib import Path

import pytest

from agent.clock.clock import SystemClock
from agent.core.codec import decode, encode
from agent.core.messages import LogLine, State
from agent.core.step_io import Inputs, Outputs, SetPoint
from agent.process.agent_process import Runtime
from replay.files.channels import STEP_IN, STEP_OUT
from replay.files.info import info
from replay.files.log import read
from replay.recorder import BlackBoxWriter, black_box_log
from tests.replay.small_box import CALIBRATION, FLEET, START_NS, state


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


def test_a_second_start_keeps_the_first_recording(tmp_path: Path) -> None:
    paths = []
    for _ in range(2):
        with black_box_log(tmp_path, FLEET, "r1", CALIBRATION, {}, views=False) as log:
            paths.append(log.path.name)
    assert paths == ["r1.mcap", "r1.2.mcap"]
    assert set(info(tmp_path / "r1.2.mcap").attachments) == {"fleet.toml", "calibration.toml"}
