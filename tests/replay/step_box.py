"""The steps of a robot as a black box without frames: all that `aucamp replay check` needs."""

from pathlib import Path

from agent.agent_process import run_facts
from agent.kernel.config import Fleet
from agent.kernel.ranging.calibration import Calibration
from agent.kernel.toml_files import dump
from replay.files.backlog import Entry
from replay.files.channels import STEP_IN, STEP_OUT
from replay.files.mcap_file import Part


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
