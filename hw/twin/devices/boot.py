"""The firmware from one boot to its end: a process between its bus, which stands for sensors and pins, and its UART."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import struct
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from agent.clock import machine
from hw.firmware.bus import ACT, ACT_SIZE, TICK_US, TIMES
from hw.twin.devices.cycle_times import CycleTimes

RESET_CAUSE = "AUCAMP_RESET_CAUSE"  # the environment variable that stands for the chip's register; hal_unix reads it

STOP_S = 0.3  # from the end of its bus to the kill
CHUNK = 65536


class Act(NamedTuple):
    """What the pins of the board do after a cycle, and since when."""

    since_us: int  # the thrusters' first pulse frame after they were written
    pulses_us: tuple[int, ...]  # (8,) T1-T8
    servos_us: tuple[int, ...]  # (4,) camera pan, camera tilt, lamp pan, lamp tilt
    lamp_permille: int
    armed: bool


class Boot:
    """One running firmware."""

    def __init__(self, process: subprocess.Popen[bytes], bus: socket.socket, uart: socket.socket) -> None:
        """Made by `boot`, which hands over the twin's ends of both sockets."""
        self.stopped = False  # by `stop`
        self.ended = False
        self.late = False  # it has not answered the last tick that it was waited for
        self.asked_us = -1  # clock of the last tick sent, of the last one answered
        self.answered_us = -1
        self.answered_s = machine.monotonic_s()
        self.over_us = 0  # clock at the end of the last cycle that it has answered, on the board that it stands for
        self._process, self._bus, self._uart = process, bus, uart
        self._rest = b""

    def begins_us(self, tick_us: int) -> int | None:
        """When the board begins a cycle that has this tick to begin with: then, or once the one before is over.

        None: there will be another tick before that, and this one is lost.
        """
        begins_us = max(tick_us, self.over_us)
        return begins_us if begins_us < tick_us + TICK_US else None

    def tick(self, clock_us: int, record: bytes) -> None:
        """Send a record of the bus; clock_us is when the cycle begins."""
        if self.ended:
            return
        try:
            self._bus.send(record)  # whole or not at all: the kernel queues a record this small in one piece
            self.asked_us = clock_us
        except BlockingIOError:
            pass  # the firmware hangs and its queue is full: its hardware ticks on without it
        except OSError:
            self.ended = True

    def act(self, patience_s: float) -> Act | None:
        """The newest answer since the last call, waiting up to patience_s for the one to the last tick.

        One that missed a tick is not waited for until it has caught up.
        """
        newest: bytes | None = None
        deadline_s = machine.monotonic_s() + (0.0 if self.late or self.stopped else patience_s)
        while not self.ended:
            try:
                chunk = self._bus.recv(64 * ACT_SIZE)
            except BlockingIOError:
                left_s = deadline_s - machine.monotonic_s()
                if self.answered_us >= self.asked_us or left_s <= 0:
                    break
                select.select([self._bus], [], [], left_s)
                continue
            except OSError:
                chunk = b""
            if not chunk:
                self.ended = True
                break
            data = self._rest + chunk
            whole = len(data) - len(data) % ACT_SIZE
            self._rest = data[whole:]
            if whole:
                newest = data[whole - ACT_SIZE : whole]
                self.answered_us, self.answered_s = int.from_bytes(newest[:8], "little"), machine.monotonic_s()
        self.late = self.answered_us < self.asked_us
        if newest is None:
            return None
        clock_us, *pins, lamp, armed, frame_us, pins_us, busy_us = struct.unpack(ACT, newest)
        self.over_us = clock_us + busy_us
        since_us = -(-(clock_us + pins_us) // frame_us) * frame_us
        return Act(since_us, tuple(pins[:8]), tuple(pins[8:]), lamp, bool(armed))

    def write_uart(self, data: bytes) -> None:
        """Bytes arrive at the UART; what does not fit is lost."""
        if data:
            with contextlib.suppress(OSError):
                self._uart.send(data)

    def read_uart(self) -> bytes:
        """What it wrote to the UART since the last call. After its answer to a tick: all that the tick led to."""
        with contextlib.suppress(OSError):
            return self._uart.recv(CHUNK)
        return b""

    def stop(self) -> None:
        """Hang it, as an endless loop with interrupts off would."""
        self._process.send_signal(signal.SIGSTOP)
        self.stopped = True

    def kill(self) -> None:
        """End it now, as a reset or the loss of power does."""
        self._process.kill()
        self.close()

    def close(self) -> None:
        """End the firmware, by the end of its bus or by force."""
        with contextlib.suppress(OSError):  # it may have died just now
            self._bus.shutdown(socket.SHUT_WR)
        try:
            self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self.ended = True
        self._bus.close()  # only now: closing a socket with answers in it would be a reset, not an end
        self._uart.close()


def boot(command: Sequence[str], flash: Path, log: Path, cause: int, times: CycleTimes) -> Boot:
    """Start `command` UART_FD BUS_FD FLASH; what it prints is added to `log`. Raises OSError if it cannot be run.

    `cause` is one of wire.POWER_ON and wire.BY_WATCHDOG; `times` is what its cycles take.
    """
    with contextlib.ExitStack() as ours, contextlib.ExitStack() as theirs:
        pairs = [socket.socketpair() for _ in range(2)]
        for mine, its in pairs:
            ours.callback(mine.close)
            theirs.callback(its.close)
            mine.setblocking(False)
        (bus, its_bus), (uart, its_uart) = pairs
        its_uart.setblocking(False)
        out = theirs.enter_context(log.open("ab"))
        process = subprocess.Popen(
            [*command, str(its_uart.fileno()), str(its_bus.fileno()), str(flash)],
            pass_fds=(its_uart.fileno(), its_bus.fileno()),
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=out,
            env={**os.environ, RESET_CAUSE: str(cause), TIMES: times.record()},
            process_group=0,  # Ctrl-C is for the twin, which then ends the bus
        )
        ours.pop_all()
        return Boot(process, bus, uart)
