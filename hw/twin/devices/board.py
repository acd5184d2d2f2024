"""One robot's control module as the agent meets it: a serial port, and behind it a board that runs the firmware.

The board does what a board does whatever its firmware thinks: it boots when power comes, and its watchdog resets a
firmware that is silent for half a second. Flash outlives both. No boot is armed by the one before.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agent.clock import machine
from hw.firmware import bus
from hw.firmware.wire import BY_WATCHDOG, POWER_ON
from hw.twin.devices.boot import Act, Boot, boot
from hw.twin.devices.cycle_times import CycleTimes, read_table
from hw.twin.physics.cable import Cable

FIRMWARE = Path(__file__).parents[2] / "firmware" / "main.py"


def interpreter() -> str:
    """The board's own interpreter where its Unix port is installed, beside this Python or on PATH; else this Python."""
    beside = str(Path(sys.executable).parent)
    return shutil.which("micropython", path=beside) or shutil.which("micropython") or sys.executable


BATTERY_MV, CURRENT_10MA = 14_800, 150  # a four-cell pack, nothing running but the electronics
ALL_SENSORS = 0b1111

PATIENCE_S = 2.0  # of the wall: time stands while a firmware is busy, and goes on without one that hangs
WATCHDOG_US = 500_000  # as hal_stm32 sets the chip's independent watchdog; it begins with the first answer
RESTART_US = 1_000_000  # a firmware that ends at once is started once a second


class Board:
    """A control module between its cable and its bus. Nothing happens before start(); time is the clock of `tick`.

    `settings` go to the flash beside the tare, for example {"law": "pid"}. `times`: what a cycle takes on this board;
    without it what it is estimated to take.
    """

    def __init__(
        self,
        robot: str,
        folder: Path,
        tare_pa: Sequence[float],
        firmware: Path = FIRMWARE,
        interpreter: str = sys.executable,
        settings: Mapping[str, Any] | None = None,
        times: CycleTimes | None = None,
    ) -> None:
        self.robot = robot
        self.port = folder / f"{robot}.serial"
        self._flash = folder / f"{robot}.flash.json"
        self._log = folder / f"{robot}.firmware.log"
        self._burnt = {"tare_pa": [float(p) for p in tare_pa], **(settings or {})}
        self._command = [interpreter, str(firmware)]
        self._times = read_table().times if times is None else times
        self._percent = 100
        self._cable = Cable(self.port)
        self._said: list[tuple[int, bytes]] = []  # on the UART, and when the cycle is over that said it
        self._boot: Boot | None = None
        self._clock_us = 0
        self._booted_us = 0
        self._plug_us: int | None = None  # when the cable, when power comes back
        self._power_us: int | None = None
        self._told = ""

    def start(self) -> None:
        """Burn the flash, boot and open the port."""
        self._flash.write_text(json.dumps(self._burnt))
        self._log.write_bytes(b"")
        self._power_up(POWER_ON)
        self._cable.plug()

    @property
    def driving(self) -> bool:
        """Whether the firmware drives the pins: not before its first answer, nor after its end."""
        return self._boot is not None and not self._boot.ended and self._boot.answered_us >= 0

    @property
    def alive(self) -> bool:
        """Whether a firmware runs, be it stopped."""
        return self._boot is not None and not self._boot.ended

    @property
    def overdue(self) -> bool:
        """Whether a firmware that runs free has left the last tick that it was waited for without an answer."""
        return self._boot is not None and not self._boot.ended and self._boot.late and not self._boot.stopped

    def tick(
        self,
        clock_us: int,
        pressure_pa: Sequence[float],
        answered: int = ALL_SENSORS,
        battery_mv: int = BATTERY_MV,
        current_10ma: int = CURRENT_10MA,
        leak: bool = False,
        yaw_rate_cdeg_s: int = bus.NO_RATE,
    ) -> None:
        """One tick of the hardware: time goes on, and this is what the sensors read."""
        self._clock_us = clock_us
        self._look_after()
        if self._plug_us is not None and clock_us >= self._plug_us and self._power_us is None:
            self._plug_us = None
            self._cable.plug()
        running = self._boot
        if running is None:
            return
        running.write_uart(self._cable.receive())
        since_boot_us = clock_us - self._booted_us
        begins_us = running.begins_us(since_boot_us)
        if begins_us is not None:
            sensors = (pressure_pa, battery_mv, current_10ma, leak, answered)
            waited_us = begins_us - since_boot_us
            record = bus.tick(begins_us, *sensors, waited_us, self._percent, yaw_rate_cdeg_s)
            running.tick(begins_us, record)

    def act(self, patience_s: float) -> Act | None:
        """The newest answer since the last call, waiting up to patience_s for the one to the last tick."""
        if self._boot is None:
            return None
        act = self._boot.act(patience_s)
        if said := self._boot.read_uart():
            self._said.append((self._booted_us + self._boot.over_us, said))
        while self._said and self._said[0][0] <= self._clock_us + bus.TICK_US:
            self._cable.send(self._said.pop(0)[1])
        return act and act._replace(since_us=self._booted_us + act.since_us)

    def unread(self) -> int:
        """Bytes on the cable that the agent has not taken."""
        return self._cable.unread()

    def unplug(self, for_us: int) -> None:
        """Pull the serial cable; the firmware runs on and hears nothing."""
        self._cable.unplug()
        self._plug_us = self._clock_us + for_us

    def cut_power(self, for_us: int) -> None:
        """No firmware, no pulses, and no port, for the adapter hangs on the same supply."""
        self.unplug(for_us)
        self._power_us = self._clock_us + for_us
        if self._boot is not None:
            self._boot.kill()
            self._boot = None

    def hang(self) -> None:
        """The firmware stops where it is; the watchdog will notice."""
        if self.alive and self._boot is not None:
            self._boot.stop()

    def slow_down(self, by: float) -> None:
        """From now on everything takes so many times as long as it should."""
        self._percent = round(100 * by)

    def close(self) -> None:
        """End the firmware and remove the port."""
        if self._boot is not None:
            self._boot.close()
            self._boot = None
        self._cable.unplug()
        self._plug_us = self._power_us = None

    def _look_after(self) -> None:
        """Power and watchdog."""
        if self._power_us is not None:
            if self._clock_us >= self._power_us:
                self._power_us = None
                self._power_up(POWER_ON)
        elif self._boot is None:
            pass  # never started, or closed
        elif self._boot.ended:
            self._boot.close()
            self._tell(f"the firmware of {self.robot} has ended: {self._last_words()}")
            if self._clock_us - self._booted_us >= RESTART_US:
                self._power_up(POWER_ON)
        elif self._is_hung(self._boot):
            self._tell(f"the firmware of {self.robot} hung; its watchdog has reset it")
            self._boot.kill()
            self._power_up(BY_WATCHDOG)

    def _is_hung(self, running: Boot) -> bool:
        """Silent for half a second of its clock, and of ours: a twin that catches up lets a firmware no time."""
        if running.answered_us < 0 or self._clock_us - self._booted_us - running.answered_us < WATCHDOG_US:
            return False
        return running.stopped or machine.monotonic_s() - running.answered_s >= WATCHDOG_US * 1e-6

    def _power_up(self, cause: int) -> None:
        if self._boot is not None:
            self._boot.close()
            self._boot = None
        self._booted_us = self._clock_us
        self._said.clear()
        self._boot = boot(self._command, self._flash, self._log, cause, self._times)

    def _tell(self, text: str) -> None:
        """Tell whoever watches the twin; of a firmware that ends every second for the same reason, once."""
        if text != self._told:
            sys.stderr.write(f"twin: {text}\n")
        self._told = text

    def _last_words(self) -> str:
        lines = self._log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it printed nothing"
