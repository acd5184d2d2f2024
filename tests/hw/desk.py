"""A control module on a desk: the firmware as a process, its hardware bus in our hands, its tether a real pty."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hw.firmware import bus, wire
from tests.hw.firmware.nominal_plant import AIR_PA, PA_PER_M

FIRMWARE = Path(wire.__file__).parent
PATIENCE_S = 60.0  # of the wall: a machine may be busy
MICROPYTHON = shutil.which("micropython", path=str(Path(sys.executable).parent)) or shutil.which("micropython")


class Desk:
    """Lock-step: nothing moves but through `tick`, and board time is what `tick` says."""

    def __init__(self, interpreter: str, directory: Path, flash: dict[str, Any], times: str = "") -> None:
        """times: what a cycle takes, as hw.firmware.bus.TIMES; without it nothing does."""
        self.times = times
        self.flash_path = directory / "flash.json"
        self.flash_path.write_text(json.dumps(flash))
        self.interpreter = interpreter
        self.master, self.slave = os.openpty()
        for fd in (self.master, self.slave):
            tty.setraw(fd)
            os.set_blocking(fd, False)
        self.now_us = 5_000_000
        self.pressure_pa = [AIR_PA + 0.3 * PA_PER_M] * 4
        self.answered = 15
        self.battery_mv = 15000
        self.yaw_rate = bus.NO_RATE
        self.leak = 0
        self.open_loop = False
        self.frame_us = self.pins_us = self.busy_us = 0  # in the last answer, as hw.firmware.bus.ACT
        self.frames: list[tuple[int, tuple[Any, ...]]] = []
        self.framer = wire.Framer(lambda kind, _seq, payload: self.frames.append((kind, wire.unpack(kind, payload))))
        self.writer = wire.Writer()
        self.req_id = 0
        self.said: list[str] = []  # by a driver that reads the tether in our place
        self.power_on()

    def power_on(self) -> None:
        self.bus, theirs = socket.socketpair()
        self.bus.settimeout(PATIENCE_S)
        self.process = subprocess.Popen(
            [self.interpreter, str(FIRMWARE / "main.py"), str(self.master), str(theirs.fileno()), str(self.flash_path)],
            pass_fds=[self.master, theirs.fileno()],
            stderr=subprocess.PIPE,
            env={**os.environ, bus.TIMES: self.times},
        )
        theirs.close()

    def power_off(self) -> int:
        """Close the bus; the exit status of the firmware."""
        self.bus.close()
        status = self.process.wait(PATIENCE_S)
        assert self.process.stderr is not None
        self.process.stderr.close()
        return status

    def tick(self, n: int = 1) -> tuple[Any, ...]:
        """n control cycles; the pins after the last: clock, 8 pulses, 4 servos, lamp, armed."""
        for _ in range(n):
            self.now_us += 10_000
            ripple_pa = 0.1 * (self.now_us // 10_000 % 3 == 0)  # a sensor that stands still is none
            pressure_pa = [pa + ripple_pa for pa in self.pressure_pa]
            sensors = (pressure_pa, self.battery_mv, 100, self.leak, self.answered)
            self.bus.sendall(bus.tick(self.now_us, *sensors, yaw_rate=self.yaw_rate, open_loop=self.open_loop))
            answer = b""
            while len(answer) < bus.ACT_SIZE:
                chunk = self.bus.recv(bus.ACT_SIZE - len(answer))
                assert chunk, "the firmware has gone"
                answer += chunk
            *act, self.frame_us, self.pins_us, self.busy_us = struct.unpack(bus.ACT, answer)
            assert act[0] == self.now_us
            self.listen()
        return tuple(act)

    def listen(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while chunk := os.read(self.slave, 4096):
                self.framer.feed(chunk, len(chunk))

    def say(self, kind: int, *fields: Any) -> int:
        """Write a frame to the tether; its sequence number."""
        seq = self.writer.seq
        os.write(self.slave, self.writer.frame(kind, *fields))
        return seq

    def heard(self, kind: int) -> list[tuple[Any, ...]]:
        """All frames of a kind since the last call of `forget`."""
        return [fields for got, fields in self.frames if got == kind]

    def forget(self) -> None:
        self.frames.clear()

    def until(self, done: Callable[[], Any], ticks: int = 50) -> Any:
        """Tick until `done` says something true: a pty hands bytes over some time later, not at once."""
        for _ in range(ticks):
            self.tick()
            if answer := done():
                return answer
        raise AssertionError(f"nothing within {ticks} ticks; heard {self.frames[-3:]}")

    def greet(self, schema: int | None = None) -> int:
        """HELLO; the boot id that comes back."""
        self.forget()
        self.say(wire.HELLO, wire.PROTOCOL, wire.schema_crc() if schema is None else schema, 77)
        return int(self.until(lambda: self.heard(wire.HELLO_ACK))[0][4])

    def set_point(self, depth_m: float = 0.3, servos: tuple[int, int, int, int] = (1500, 1500, 1500, 1500)) -> None:
        """Send a set-point, and tick until the telemetry shows that it has arrived."""
        seq = self.say(
            wire.SETPOINT,
            round(depth_m * 1e4),
            0,
            0,
            0,
            0,
            0,
            *servos,
            300,
            wire.VALID_ALL,
            500,
            self.now_us // 100_000,
        )
        self.until(lambda: any(told[30] == seq for told in (self.heard(wire.TELEM) or self.heard(wire.TELEM_1))[-1:]))

    def order(self, kind: int, boot_id: int, *more: int) -> int:
        """A command; the result in its acknowledgement, the last one where it takes time."""
        self.req_id += 1
        self.say(kind, self.req_id, boot_id, *more)

        def results() -> list[int]:
            return [ack[2] for ack in self.heard(wire.ACK) if ack[0] == self.req_id and ack[2] != wire.RUNNING]

        return int(self.until(results, 300)[0])

    def arm(self) -> int:
        """Handshake, ESCs neutral for 3 s, set-point, ARM; the boot id."""
        boot_id = self.greet()
        self.tick(310)
        self.set_point()
        assert self.order(wire.ARM, boot_id) == wire.OK
        return boot_id

    def events(self, code: int) -> list[tuple[Any, ...]]:
        return [event for event in self.heard(wire.EVENT) if event[1] == code]

    def close(self) -> None:
        if self.process.poll() is None:
            self.bus.close()
            try:
                self.process.wait(2.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        if self.process.stderr is not None:
            self.process.stderr.close()
        os.close(self.master)
        os.close(self.slave)
