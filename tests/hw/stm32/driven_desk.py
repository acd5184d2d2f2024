"""A control module on a desk with the driver at its tether: board time passes in `drive` alone."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

from agent.core.step_io import SetPoint, Telemetry
from hw.stm32.driver import Stm32
from tests.hw.desk import Desk

HOVER = SetPoint(depth_m=0.3, servos_us=(1400, 1600, 1500, 1500), light=0.5)


def drive(desk: Desk, driver: Stm32, done: Callable[[], bool], ticks: int = 1200, send: bool = True) -> list[Telemetry]:
    """Turn the board's clock until `done`; what the driver heard meanwhile. Wall time only lets threads run."""
    telemetry = []
    for i in range(ticks):
        if send and i % 5 == 0:
            driver.send(HOVER, time.time_ns())
        desk.tick()
        got, lines = driver.drain()
        telemetry += got
        desk.said += [line.text for line in lines]
        if done():
            return telemetry
        time.sleep(0.001)
    raise AssertionError(f"not within {ticks} ticks; said {desk.said}")


class Port:
    """A path that can vanish and come back, as a cable does."""

    def __init__(self, desk: Desk, directory: Path) -> None:
        self.path = directory / "r1.serial"
        self.target = os.ttyname(desk.slave)
        self.plug()

    def plug(self) -> None:
        self.path.symlink_to(self.target)
