"""Two robots of the tank, their twin and their agents, each a process as a user starts it, on the dive's own clock."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from types import MappingProxyType
from typing import Any

from msgspec.structs import replace

from agent.clock.clock import RunClock
from agent.core.config import dump
from agent.core.ranging.camera_model import Calibration
from agent.core.topics import STATE
from agent.demo.demo import demo_fleet
from agent.process.command import temporary_folder
from agent.process.transport import Observer
from hw.twin.twin_folder import clock_path
from tests.killing import killed_after
from tests.known_lens import TWIN, TWIN_CAMERA
from tests.network.dives.shown_states import ShownStates
from tests.places import ROOT
from tests.waiting import until

READY_S = 180.0  # of the wall: on a fresh machine every kernel is compiled first
ENDS_S = 30.0  # of the wall

Between = Callable[[Path], AbstractContextManager[Path]]  # the twin's folder -> the one that r1 takes for it


class DiveOfTwo:
    """r1 and r2 with calibrations that nobody made in this dive: r1's is its own of another day, r2's is r1's."""

    def __init__(
        self, folder: Path, twin_folder: Path, environment: Mapping[str, Mapping[str, str]] = MappingProxyType({})
    ) -> None:
        """`environment`: of a process, beside ours."""
        self.folder, self._twin_folder = folder, twin_folder
        self.fleet = demo_fleet(2, "evidence", 0.0, 0, False, twin_folder)
        self.path = folder / "fleet.toml"
        self.path.write_text(dump(self.fleet))
        self._environment = environment
        for name, robot in self.fleet.robot.items():
            known = Calibration(robot=name, made="2026-01-01", source="a test", focus=TWIN, camera=TWIN_CAMERA)
            (folder / robot.calibration).parent.mkdir(exist_ok=True)
            (folder / robot.calibration).write_text(dump(known))
        self.clock = RunClock(clock_path(self.fleet))
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def start_twin(self, speed: str = "max") -> None:
        self._start("twin", "twin", str(self.path), "--speed", speed)
        until((self._twin_folder / "ready").exists, READY_S, lambda: self.log("twin"))

    def start_agents(self, twin_of_r1: Path) -> None:
        of_r1 = replace(self.fleet, twin=replace(self.fleet.twin, dir=str(twin_of_r1)))
        (self.folder / "fleet_of_r1.toml").write_text(dump(of_r1))
        for name in self.fleet.robot:
            self.start_agent(name)

    def start_agent(self, name: str) -> None:
        path = self.folder / "fleet_of_r1.toml" if name == "r1" else self.path
        self._start(name, "agent", str(path), "--robot", name, "--out", str(self.folder), "--arm")

    def check(self) -> None:
        for name, process in self.processes.items():
            assert process.poll() is None, f"{name} ended: {self.log(name)}"

    def signal(self, name: str, number: int) -> None:
        self.processes[name].send_signal(number)

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text()

    def end(self) -> None:
        """Agents first; each ends by itself."""
        for names in (tuple(self.fleet.robot), ("twin",)):
            for name in names:
                self.signal(name, signal.SIGTERM)
            for name in names:
                assert self.processes[name].wait(ENDS_S) == 0, self.log(name)

    def _start(self, name: str, *arguments: str) -> None:
        with (self.folder / f"{name}.log").open("wb") as log:
            command = [sys.executable, "-m", "agent", *arguments]
            environment = {**os.environ, "PYTHONPATH": str(ROOT), **self._environment.get(name, {})}
            self.processes[name] = subprocess.Popen(command, stdout=log, stderr=log, env=environment)


@contextmanager
def dive_of_two(
    folder: Path, between: Between = nullcontext, speed: str = "max", **otherwise: Any
) -> Iterator[tuple[DiveOfTwo, ShownStates]]:
    """Both are armed and well, and hear each other. `between`: something stands between r1 and its devices. `speed`: of
    the dive's clock. `otherwise`: see DiveOfTwo."""
    with temporary_folder() as twin_folder:
        dive = DiveOfTwo(folder, twin_folder, **otherwise)
        with killed_after(dive.processes), Observer(dive.fleet, dive.clock.now_ns, (STATE,)) as observer:
            shown = ShownStates(observer, tuple(dive.fleet.robot), dive.check)
            dive.start_twin(speed)
            with between(twin_folder) as twin_of_r1:
                dive.start_agents(twin_of_r1)
                well = "armed and well"
                shown.until(well, lambda s: s.armed and not s.faults and s.neighbours[0].heard > 0, READY_S)
                yield dive, shown
