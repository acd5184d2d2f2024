"""The steps of a robot as a black box without frames: all that `aucamp replay check` needs."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from agent.core.codec import decode, encode
from agent.core.config import Fleet, dump
from agent.core.messages import Arg, Order
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import Inputs, Ordered, Outputs
from agent.process.agent_process import run_facts
from agent.robot.step import Agent
from replay.files.channels import STEP_IN, STEP_OUT, Entry
from replay.files.mcap_file import Part

LIMIT = 10**6  # bytes of a step's inputs


class StepBox:
    """One file, written step by step and finished when the context ends."""

    def __init__(self, file: Path, fleet: Fleet, robot: str, calibration: Calibration, incarnation: int) -> None:
        self._part, self._steps = Part(file), 0
        attachments = {"fleet.toml": dump(fleet), "calibration.toml": dump(calibration)}
        self._part.start(run_facts(fleet, robot, incarnation), attachments)

    def __enter__(self) -> "StepBox":
        return self

    def __exit__(self, *_: object) -> None:
        self.finish()

    def add(self, now_ns: int, inputs: bytes, outputs: bytes) -> None:
        """What went into the next step, and what came out."""
        for channel, data in ((STEP_IN.name, inputs), (STEP_OUT.name, outputs)):
            self._part.add(Entry(channel, now_ns, now_ns, self._steps, data, "msgpack", {}))
        self._steps += 1

    def finish(self) -> None:
        self._part.finish("aucamp.end", {"cause": "clean"})


class Said(NamedTuple):
    """An order that somebody gives."""

    at_s: float  # since the start
    verb: str
    args: Mapping[str, Arg] = {}
    console: str = "ann"
    seen_s: float | None = math.inf  # when the State was said that was looked at; infinite: in the step before
    number: int | None = None  # None: one more than the order before
    again: bool = False  # the order before, once more
    robot: str = "r1"  # who is ordered


class Recorded(Agent):
    """An agent whose steps go into a black box. It takes them in through bytes, so that nothing else reaches it."""

    def __init__(
        self, file: Path, fleet: Fleet, name: str, calibration: Calibration, start_ns: int, orders: Sequence[Said] = ()
    ) -> None:
        super().__init__(fleet, name, calibration, start_ns)
        self._start_ns, self._before_ns = start_ns, start_ns
        mine = (said for said in orders if said.robot == name)
        self._to_order, self._given = sorted(mine, key=lambda said: said.at_s), 0
        self._order = Order(id=0, verb="clock")  # the newest
        self.box = StepBox(file, fleet, name, calibration, start_ns)

    def step(self, inputs: Inputs, now_ns: int) -> Outputs:
        if orders := tuple(self._due(now_ns)):
            inputs = replace(inputs, orders=orders)
        data = encode(inputs)
        outputs = super().step(decode(data, Inputs, limit=LIMIT), now_ns)
        self.box.add(now_ns, data, encode(outputs))
        self._before_ns = now_ns
        return outputs

    def _due(self, now_ns: int) -> Iterator[Ordered]:
        """Each order once."""
        while self._given < len(self._to_order) and now_ns - self._start_ns >= self._to_order[self._given].at_s * 1e9:
            said = self._to_order[self._given]
            self._given += 1
            if not said.again:
                number, seen = said.number or self._given, None
                if said.seen_s is not None:
                    since_ns = self._before_ns if math.isinf(said.seen_s) else self._start_ns + round(said.seen_s * 1e9)
                    seen = self._start_ns, since_ns
                self._order = Order(id=number, verb=said.verb, args=said.args, seen=seen)
            yield Ordered(arrived_ns=now_ns, console=said.console, payload=encode(self._order))
