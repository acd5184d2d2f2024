"""Which clock a fleet lives by: that of its dive in the twin, or the system's."""

from __future__ import annotations

from agent.clock.clock import Clock, SystemClock
from agent.clock.run_clock import RunClock
from agent.kernel.config import ConfigError, Fleet
from hw.twin.devices.twin_folder import clock_path


def fleet_clock(fleet: Fleet) -> Clock:
    """The one clock of all robots. Raises ConfigError for a fleet of which only a part is in the twin."""
    homes = {
        f"robot.{name}.{key}": url.startswith("twin:")
        for name, robot in fleet.robot.items()
        for key, url in (("serial", robot.serial), ("camera", robot.camera))
    }
    if not any(homes.values()):
        return SystemClock()
    if not all(homes.values()):
        real, twin = (next(key for key, in_twin in homes.items() if in_twin is value) for value in (False, True))
        raise ConfigError(
            f"fleet '{fleet.fleet}': '{real}' is a real device and '{twin}' lives in the twin, whose time is not "
            f"the system's; give all robots twin: devices, or none"
        )
    return RunClock(clock_path(fleet))
