"""Aucamp from Python: look into a recording, run a robot's steps again, listen to a running fleet.

    import aucamp

    run = aucamp.replay("runs/20260101T120000Z")
    for row in run.table("r1"):
        print(row["time_s"], row["posterior_x_m"])
    print(run.rerun("r1").verdict)

    for state in aucamp.listen("fleet.toml"):
        print(state.robot, state.posterior_m)

This is a door and no room: the work is done by `agent` and `replay`, where all else can be had.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from agent.clock import machine
from agent.core.codec import decode
from agent.core.config import ConfigError, Fleet
from agent.core.messages import State
from agent.core.step_io import Inputs, Outputs
from agent.core.topics import STATE
from agent.ground.bridges.outward import own_word
from agent.process.certificates import credentials
from agent.process.transport import LOOKER, Observer
from agent.robot.fleet_reader import load_fleet
from replay.check.reexecute import STEP_BYTES, BlackBox, Reexecution, reexecute
from replay.export import tables
from replay.files.info import suspecting
from replay.files.recover import auto_recovered
from replay.report.lead import truth_at
from replay.report.timeline import Run, open_run

__all__ = ["Recording", "Step", "listen", "replay"]

LOOK_S = 0.02  # between two looks at what has arrived


class Step(NamedTuple):
    """One step of a robot's kernel, twenty a second."""

    t_ns: int  # by the robot's clock
    inputs: Inputs
    outputs: Outputs | None  # None: the recording ends before them


class Recording:
    """A run's folder, or one recording. `replay` opens it."""

    def __init__(self, run: Run) -> None:
        self._run = run

    @property
    def fleet(self) -> Fleet:
        return self._run.fleet

    @property
    def robots(self) -> list[str]:
        """Of which there is something."""
        return sorted({timeline.robot for timeline in self._run.timelines})

    def table(self, robot: str, kind: str = "state") -> list[dict[str, Any]]:
        """Rows as `aucamp export csv` has them. kind: state, telemetry, sightings, sweeps, log.

        Units are in the columns' names; time_s is a number, since the first step of any robot. Raises ConfigError for
        a robot or a kind that is not there.
        """
        self._known(robot)
        kinds = {table.kind: table.rows for table in tables(self._run, robot)}
        if kind not in kinds:
            raise ConfigError(f"table '{kind}': there is none; take one of {', '.join(kinds)}")
        with suspecting(self._run.path):
            return [{**row, "time_s": float(row["time_s"])} for row in kinds[kind]]

    def errors(self, robot: str, target: str | None = None) -> list[tuple[float, float]]:
        """(time_s, m): how far what the robot believed was from the truth, after each iteration.

        target: the first of the fleet file if not given. Empty where no twin has left the truth, which lies in a run's
        folder, beside the recordings. Raises ConfigError for a robot or a target that is not there.
        """
        self._known(robot)
        name = target or next(iter(self.fleet.target))
        if name not in self.fleet.target:
            raise ConfigError(f"{self._run.path}: no target '{name}'; there is {', '.join(self.fleet.target)}")
        true_m = truth_at(self._run, name)
        held = (each for timeline in self._run.about(name) if timeline.robot == robot for each in timeline.held)
        return [(b.t_s, math.dist(x_m, there)) for b, x_m in held if (there := true_m(b.t_s)) is not None]

    def steps(self, robot: str) -> Iterator[Step]:
        """What went into each step and what came out, decoded. Raises ConfigError without a black box of the robot."""
        for box in self._boxes(robot):
            for step in box.steps():
                with suspecting(box.path):
                    outputs = None if step.outputs is None else decode(step.outputs, Outputs, limit=STEP_BYTES)
                    inputs = decode(step.inputs, Inputs, limit=STEP_BYTES)
                yield Step(step.now_ns, inputs, outputs)

    def rerun(self, robot: str) -> Reexecution:
        """All steps of the robot's last start once more, by the code of today: what `aucamp replay check` compares."""
        return reexecute(self._boxes(robot)[-1])

    def _boxes(self, robot: str) -> list[BlackBox]:
        self._known(robot)
        boxes = [box for box in self._run.boxes if box.robot == robot]
        if not boxes:
            raise ConfigError(f"{self._run.path}: has no black box of {robot}; its agent writes one")
        return boxes

    def _known(self, robot: str) -> None:
        if robot not in self.robots:
            raise ConfigError(f"{self._run.path}: has nothing of a robot '{robot}'; there is {', '.join(self.robots)}")


def replay(path: str | Path) -> Recording:
    """Open the folder of a run, a black box or a fleet's recording. Raises ConfigError for what is none.

    What is torn is mended beside it first, with a warning that says what was lost.
    """
    with suspecting(Path(path)):
        (there,) = auto_recovered([Path(path)], lambda line: warnings.warn(line, stacklevel=3))
        return Recording(open_run(there))


def listen(fleet: str | Path, name: str = LOOKER, for_s: float | None = None) -> Iterator[State]:
    """States of all robots as they come, five a second of each; without end unless `for_s` is given.

    fleet: its fleet file. name: in a secured fleet the observer whose certificate is used. Messages that cannot be
    read are passed over. Raises ConfigError for a file that is no fleet's.
    """
    path = Path(fleet)
    of, until_s = load_fleet(path), math.inf if for_s is None else machine.monotonic_s() + for_s
    with Observer(of, machine.monotonic_ns, (STATE,), name=name, keys=credentials(of, name, path)) as observer:
        while machine.monotonic_s() < until_s:
            for seen in observer.drain():
                if isinstance(said := own_word(seen), State):
                    yield said
            machine.sleep(LOOK_S)
