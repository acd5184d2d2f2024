"""`aucamp board reboot`: a control module begun anew by order, which is the way out of a latched fault."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Event

from agent.clock.clock import Clock, wait
from agent.core.step_io import Telemetry
from agent.process.command import Failed
from agent.process.transport import fleet_clock
from agent.robot.fleet_reader import load_fleet, load_robot
from hw.firmware.failsafe import LATCHED
from hw.stm32.driver import Stm32, open_port_path
from hw.twin.twin_folder import twin_dir

LIMIT_S = 10.0  # of the clock: to be greeted, to be answered, and to be greeted again
WORDS_S = 1.0  # what is wrong with this boot, a board tells whoever greets it
LOOK_S = 0.05


def reboot(fleet_path: Path, name: str, say: Callable[[str], None], limit_s: float = LIMIT_S) -> None:
    """Reboot a robot's module and say what it says. Raises ConfigError, and Failed where it is armed, silent, or
    latched again. The port must be free: a robot's agent holds it.
    """
    fleet = load_fleet(fleet_path)
    robot = load_robot(fleet, name, fleet_path)
    clock = fleet_clock(fleet)
    board = Stm32(open_port_path(robot.serial, twin_dir(fleet)), clock)
    board.start()
    try:
        Rebooting(board, name, clock, say, limit_s).run()
    finally:
        board.let_surface()  # not `close`: a robot that is found on its way up goes on


class Rebooting:
    """One board, from greeting to greeting."""

    def __init__(self, board: Stm32, name: str, clock: Clock, say: Callable[[str], None], limit_s: float) -> None:
        self._board, self._name, self._clock, self._say, self._limit_s = board, name, clock, say, limit_s
        self._newest: Telemetry | None = None
        self._said = "not a word"  # the newest line of the board, or about it

    def run(self) -> None:
        if not self._until(lambda: self._board.greeting is not None and self._newest is not None):
            raise Failed(f"{self._name}: no board answers ({self._said}); is it on, and its port free?")
        self._until(lambda: False, WORDS_S)
        before = self._board.greeting
        asked = self._board.reboot()
        self._until(asked.done)
        result = asked.result(0).result if asked.done() else "no answer"
        if result == "refused":
            raise Failed(f"{self._name}: its motors are on, and it goes on; let it surface, or stop it, then reboot it")
        if result != "ok":
            raise Failed(f"{self._name}: the order to reboot ended with '{result}'; take its power off and on")
        self._newest = None
        greeted = self._until(lambda: self._board.greeting != before and self._newest is not None)
        if not greeted or self._newest is None:
            raise Failed(f"{self._name}: rebooted, and silent since; take its power off and on")
        if self._newest.ladder == LATCHED:
            self._until(lambda: False, WORDS_S)
            raise Failed(f"{self._name}: rebooted, and latched again ({self._said}); put that right first")
        self._say(f"{self._name}: rebooted; arm it with: aucamp agent FLEET --robot {self._name} --arm")

    def _until(self, done: Callable[[], bool], limit_s: float | None = None) -> bool:
        """Whether it was so before the limit; what the board says meanwhile is passed on."""
        until_ns = self._clock.now_ns() + round((self._limit_s if limit_s is None else limit_s) * 1e9)
        while not done():
            if self._clock.now_ns() >= until_ns:
                return False
            wait(self._clock, Event(), LOOK_S)
            telemetry, lines = self._board.drain()
            self._newest = telemetry[-1] if telemetry else self._newest
            for line in lines:
                self._said = line.text
                self._say(f"{self._name}: {line.text}")
        return True
