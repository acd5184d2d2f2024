"""Which clock a fleet lives by: that of its dive in the twin, or the system's."""

from __future__ import annotations

from agent.clock.clock import Clock, SystemClock
from agent.clock.run_clock import RunClock
from agent.core.config import ConfigError, Fleet
from agent.robot.fleet_rules import two_worlds
from hw.twin.devices.twin_folder import clock_path


def fleet_clock(fleet: Fleet) -> Clock:
    """The one clock of all robots. Raises ConfigError for a fleet of which only a part is in the twin."""
    if (why := two_worlds(fleet)) is not None:
        raise ConfigError(f"fleet '{fleet.fleet}': {why}")
    in_twin = any(robot.serial.startswith("twin:") for robot in fleet.robot.values())
    return RunClock(clock_path(fleet)) if in_twin else SystemClock()
