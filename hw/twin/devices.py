"""One robot's control module as the agent meets it: a serial port, and behind it the firmware in its own process."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import struct
import subprocess
import sys
import time
import tty
from collections.abc import Sequence
from pathlib import Path
from typing import IO, NamedTuple

from hw.firmware.bus import ACT, ACT_SIZE, TICK

FIRMWARE = Path(__file__).parents[1] / "firmware" / "main.py"

BATTERY_MV, CURRENT_10MA = 14_800, 150  # a full four-cell pack that does not sag yet
ALL_SENSORS = 0b1111

# A control module that is busy answers within 1 ms; the pace of the water waits no longer for one that is late.
PATIENCE_S = 0.002
STOP_S = 0.3  # from the end of its bus to the kill


class Act(NamedTuple):
    """What the pins of the board do since `clock_us`."""

    clock_us: int
    pulses_us: tuple[int, ...]  # (8,) T1-T8
    servos_us: tuple[int, ...]  # (4,) camera pan, camera tilt, lamp pan, lamp tilt
    lamp_permille: int
    armed: bool


class Board:
    """A firmware process between its pty and its bus. Nothing happens before start()."""

    def __init__(
        self,
        robot: str,
        folder: Path,
        tare_pa: Sequence[float],
        firmware: Path = FIRMWARE,
        interpreter: str = sys.executable,
    ) -> None:
        self.robot = robot
        self.port = folder / f"{robot}.serial"
        self._flash = folder / f"{robot}.flash.json"
        self._log = folder / f"{robot}.firmware.log"
        self._tare_pa = [float(p) for p in tare_pa]
        self._command = [interpreter, str(firmware)]
        self._process: subprocess.Popen[bytes] | None = None
        self._slave = -1
        self._bus: socket.socket | None = None
        self._rest = b""
        self._asked_us = -1  # clock of the last tick sent
        self._answered_us = -1

    def start(self) -> None:
        """Burn the flash, open the port and boot."""
        self._flash.write_text(json.dumps({"tare_pa": self._tare_pa}))
        master, self._slave = os.openpty()
        tty.setraw(self._slave)  # one setting for both ends; a cooked pty would echo and rewrite CR and LF
        os.set_blocking(master, False)
        self._bus, theirs = socket.socketpair()
        self._bus.setblocking(False)
        try:
            with self._log.open("wb") as log:
                self._process = self._boot(master, theirs.fileno(), log)
        finally:
            # The firmware alone holds the master: when it dies, the agent's port hangs up as if unplugged.
            os.close(master)
            theirs.close()
        # We keep the slave open, else the firmware would read EIO whenever the agent closes its end.
        self.port.symlink_to(os.ttyname(self._slave))

    def _boot(self, serial_fd: int, bus_fd: int, log: IO[bytes]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [*self._command, str(serial_fd), str(bus_fd), str(self._flash)],
            pass_fds=(serial_fd, bus_fd),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            process_group=0,  # Ctrl-C is for the twin, which then ends the bus
        )

    @property
    def alive(self) -> bool:
        return self._bus is not None

    def tick(self, clock_us: int, pressure_pa: Sequence[float]) -> None:
        """One tick of the hardware: the firmware's time goes on, and this is what its sensors read."""
        if self._bus is None:
            return
        record = struct.pack(TICK, clock_us, *pressure_pa, BATTERY_MV, CURRENT_10MA, 0, ALL_SENSORS)
        try:
            self._bus.send(record)  # whole or not at all: the kernel queues a record this small in one piece
            self._asked_us = clock_us
        except BlockingIOError:
            pass  # the firmware hangs and its queue is full: its hardware ticks on without it
        except OSError:
            self._unplug()

    def act(self, patience_s: float) -> Act | None:
        """The newest answer since the last call, waiting up to patience_s for the one to the last tick."""
        newest: bytes | None = None
        deadline_s = time.monotonic() + patience_s
        while self._bus is not None:
            try:
                chunk = self._bus.recv(64 * ACT_SIZE)
            except BlockingIOError:
                left_s = deadline_s - time.monotonic()
                if self._answered_us >= self._asked_us or left_s <= 0:
                    break
                select.select([self._bus], [], [], left_s)
                continue
            except OSError:
                chunk = b""
            if not chunk:
                self._unplug()
                break
            data = self._rest + chunk
            whole = len(data) - len(data) % ACT_SIZE
            self._rest = data[whole:]
            if whole:
                newest = data[whole - ACT_SIZE : whole]
                self._answered_us = int.from_bytes(newest[:8], "little")
        if newest is None:
            return None
        clock_us, *pins, lamp, armed = struct.unpack(ACT, newest)
        return Act(clock_us, tuple(pins[:8]), tuple(pins[8:]), lamp, bool(armed))

    def _unplug(self) -> None:
        """The firmware is gone: no bus any more, hence no pulses."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def last_words(self) -> str:
        """The last line that the firmware printed, for the message that reports its death."""
        lines = self._log.read_text(errors="replace").strip().splitlines() if self._log.exists() else []
        return lines[-1] if lines else "it printed nothing"

    def close(self) -> None:
        """End the firmware, by the end of its bus or by force, and remove the port."""
        if self._bus is not None:
            with contextlib.suppress(OSError):  # it may have died just now
                self._bus.shutdown(socket.SHUT_WR)
        if self._process is not None:
            try:
                self._process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._process = None
        self._unplug()  # only now: closing a socket with answers in it would be a reset, not an end
        if self._slave >= 0:
            os.close(self._slave)
            self._slave = -1
        self.port.unlink(missing_ok=True)
