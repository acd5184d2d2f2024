"""One robot's control module as the agent meets it: a serial port, and behind it a board that runs the firmware.

Whatever its firmware does, a board boots when power comes, and its watchdog resets a firmware that is silent for half
a second. Flash outlives both. No boot is armed by the one before.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import termios
import tty
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from msgspec import Meta, structs
from numpy.typing import NDArray

from agent.clock import machine
from agent.core.config import Struct, convert, read_toml
from hw.firmware import bus
from hw.firmware.bus import ACT, ACT_SIZE, TICK_US, TIMES
from hw.firmware.failsafe import WIRING
from hw.firmware.wire import BY_WATCHDOG, POWER_ON

# --- board ---

FIRMWARE = Path(__file__).parents[1] / "firmware" / "main.py"


def interpreter() -> str:
    """The board's own interpreter where its Unix port is installed, beside this Python or on PATH; else this Python."""
    beside = str(Path(sys.executable).parent)
    return shutil.which("micropython", path=beside) or shutil.which("micropython") or sys.executable


BATTERY_MV, CURRENT_10MA = 14_800, 150  # a four-cell pack, nothing running but the electronics
ALL_SENSORS = 0b1111

PATIENCE_S = 2.0  # of the wall clock: time stands while a firmware is busy, and goes on without one that hangs
WATCHDOG_US = 500_000  # as hal_stm32 sets the chip's independent watchdog; it begins with the first answer
RESTART_US = 1_000_000  # a firmware that ends at once is started once a second


class Board:
    """A control module between its cable and its bus, tared, its wiring checked. Nothing happens before start(); time
    is the clock of `tick`.

    `settings` go to the flash beside the tare, for example {"law": "pid"}. `times`: what a cycle takes on this board;
    without it what it is estimated to take. `cable`: what joins it to its agent; without it a serial port.
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
        cable: Carrier | None = None,
    ) -> None:
        self.robot = robot
        self.port = folder / f"{robot}.serial"
        self._flash = folder / f"{robot}.flash.json"
        self._log = folder / f"{robot}.firmware.log"
        self._burnt = {"tare_pa": [float(p) for p in tare_pa], "wiring": WIRING, **(settings or {})}
        self._command = [interpreter, str(firmware)]
        self._times = read_table().times if times is None else times
        self._percent = 100
        self._cable = cable or Cable(self.port)
        self._said: list[tuple[int, bytes]] = []  # when a cycle is over, and what it wrote to the UART
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
        open_loop: bool = False,
        gravity_mg: tuple[int, int] = bus.NO_GRAVITY,
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
            motion = yaw_rate_cdeg_s, open_loop, gravity_mg
            record = bus.tick(begins_us, *sensors, waited_us, self._percent, *motion)
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
        """Silent for half a second of its clock, and of the wall clock: a twin that catches up leaves it no time."""
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
        """Tell the twin's user; of a firmware that ends every second for the same reason, once."""
        if text != self._told:
            sys.stderr.write(f"twin: {text}\n")
        self._told = text

    def _last_words(self) -> str:
        lines = self._log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it printed nothing"


# --- cycle times ---
#
# What a control cycle takes on the board, part by part: the twin's firmware gets no tick before the cycle is over.
# cycle_times.toml is estimated from counted instructions, by `python -m tests.studies.board --write`.

TABLE = Path(__file__).with_name("cycle_times.toml")

Microseconds = Annotated[float, Meta(ge=0)]


class CycleTimes(Struct, frozen=True, kw_only=True):
    """Of the control law that ships. The fields stand in the order in which hal_unix counts."""

    armed_us: Microseconds  # a cycle that sends and hears nothing, with its I2C and ADC
    disarmed_us: Microseconds
    sent_frame_us: Microseconds  # on top of its bytes
    sent_byte_us: Microseconds  # with the UART, which the firmware waits for
    heard_byte_us: Microseconds
    collect_us: Microseconds  # a garbage collection
    heap_free_us: Microseconds  # looking how much memory is free

    def record(self) -> str:
        """For the environment of the firmware: whole nanoseconds."""
        return " ".join(str(round(1000.0 * us)) for us in structs.astuple(self))


class Table(Struct, frozen=True, kw_only=True):
    """cycle_times.toml."""

    firmware: str  # digest of the sources that the times are of
    times: CycleTimes


def read_table(path: Path = TABLE) -> Table:
    """Raises ConfigError."""
    return convert(read_toml(path), Table, path)


NO_TIME = CycleTimes(
    armed_us=0, disarmed_us=0, sent_frame_us=0, sent_byte_us=0, heard_byte_us=0, collect_us=0, heap_free_us=0
)

# --- firmware process ---

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
    """The firmware from one boot to its end.

    It is a process between its bus, which stands for sensors and pins, and its UART.
    """

    def __init__(self, process: subprocess.Popen[bytes], bus: socket.socket, uart: socket.socket) -> None:
        """Made by `boot`, which passes the twin's ends of both sockets."""
        self.stopped = False  # by `stop`
        self.ended = False
        self.late = False  # it has not answered the last tick that it was waited for
        self.asked_us = -1  # clock of the last tick sent, of the last one answered
        self.answered_us = -1
        self.answered_s = machine.monotonic_s()
        self.over_us = 0  # clock at the end of the last answered cycle, as long as it takes on a real board
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

        A firmware that missed a tick is not waited for until it has caught up.
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


# --- serial cable ---


class Carrier(Protocol):
    """What a board needs of a cable. Bytes for an end that is not there are lost."""

    def plug(self) -> None: ...
    def unplug(self) -> None: ...

    def receive(self) -> bytes:
        """What the agent wrote since the last call."""

    def unread(self) -> int:
        """Bytes that the agent's end has not been read of."""

    def send(self, data: bytes) -> None:
        """Write to the agent."""


class Cable:
    """Between the agent's computer and one control module: a pty behind a path that can vanish.

    Plugged in, `path` leads to the agent's end. Bytes for an end that is not there are lost. The twin carries the bytes
    itself, once a tick, because only the holder of the pty's master can pull the cable: when the master closes, the
    agent's end hangs up as a USB adapter does.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._master = self._slave = -1

    @property
    def plugged(self) -> bool:
        return self._master >= 0

    def plug(self) -> None:
        """A new pty at the old path."""
        if self.plugged:
            return
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)  # one setting for both ends; a cooked pty would echo and rewrite CR and LF
        os.set_blocking(self._master, False)
        # The twin holds the agent's end open too: its raw mode and the path stay while no agent has it open.
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        if not self.plugged:
            return
        self.path.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1

    def receive(self) -> bytes:
        """What the agent wrote since the last call."""
        if self.plugged:
            with contextlib.suppress(BlockingIOError):
                return os.read(self._master, CHUNK)
        return b""

    def unread(self) -> int:
        """Bytes that the agent's end has not been read of."""
        if not self.plugged:
            return 0
        answer = fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4))
        return int.from_bytes(answer, sys.byteorder)

    def send(self, data: bytes) -> None:
        """Write to the agent; what its buffer does not take is lost, as on a wire without a listener."""
        if self.plugged and data:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, data)


# --- sensor faults ---


class SensorFaults:
    """What is broken between the water and the firmware: sensors and the leak probe of all robots, none at first.

    Sensors are counted from 1 to 4, as on the paper's drawings. A fault lasts until `mend`.
    """

    def __init__(self, robots: int) -> None:
        self.answered = [ALL_SENSORS] * robots  # bit masks of the sensors that do
        self.leak = [False] * robots
        self._stuck_pa = np.full((robots, 4), np.nan)
        self._offset_pa = np.zeros((robots, 4))
        self._last_pa = np.zeros((robots, 4))
        self._order = np.tile(np.arange(4), (robots, 1))  # which sensor hangs on each channel
        self._any = False

    def corrupt(self, readings_pa: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 4) readings as they arrive, from those of sensors that are well; a dead one reads 0."""
        if self._any:
            stuck = ~np.isnan(self._stuck_pa)
            readings_pa = np.take_along_axis(readings_pa, self._order, axis=1)
            readings_pa = np.where(stuck, self._stuck_pa, readings_pa + self._offset_pa)
            bits = (np.array(self.answered)[:, None] >> np.arange(4)) & 1
            readings_pa = readings_pa * bits
        self._last_pa = readings_pa
        return readings_pa

    def kill(self, robot: int, sensor: int) -> None:
        """The sensor does not answer any more."""
        self.answered[robot] &= ~(1 << self._index(sensor))
        self._any = True

    def stick(self, robot: int, sensor: int) -> None:
        """The sensor repeats its last reading."""
        k = self._index(sensor)
        self._stuck_pa[robot, k] = self._last_pa[robot, k]
        self._any = True

    def shift(self, robot: int, sensor: int, offset_pa: float) -> None:
        """The sensor reads too much, by more each time that this is called."""
        self._offset_pa[robot, self._index(sensor)] += offset_pa
        self._any = True

    def cross(self, robot: int, first: int, second: int) -> None:
        """Two sensors change places on the bus. Faults are counted by places."""
        a, b = self._index(first), self._index(second)
        self._order[robot, [a, b]] = self._order[robot, [b, a]]
        self._any = True

    def mend(self, robot: int, sensor: int) -> None:
        """The sensor is well again."""
        k = self._index(sensor)
        self.answered[robot] |= 1 << k
        self._stuck_pa[robot, k], self._offset_pa[robot, k] = np.nan, 0.0

    @staticmethod
    def _index(sensor: int) -> int:
        if sensor not in range(1, 5):
            raise ValueError(f"no sensor {sensor}; they are 1 to 4")
        return sensor - 1
