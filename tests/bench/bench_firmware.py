"""What a control cycle costs on this machine: the firmware as a process, fed as the twin feeds it."""

from __future__ import annotations

import json
import os
import resource
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import tty
from pathlib import Path
from typing import Any

from hw.firmware import bus, wire
from tests.bench.board.proxy import HEAP, cycle_cost
from tests.bench.board.tools import which

CYCLES = 3000
CYCLE_US = 10_000
ARMED = 14  # its place in the answer on the bus
SHARE = 0.04  # of a core, at most: three of these run beside vision
COST_RUNS = 3
FIRMWARE = Path(wire.__file__).parent
BOARD_HEAP = 108_600  # bytes free on an STM32F407 before the firmware is imported
PRESSURE_PA = (104262.0,) * 4  # 0.3 m of water over a tare of 101325 Pa


def run() -> dict[str, dict[str, Any]]:
    """CPU time and turn-around of a cycle in us, armed, set-points at 20 Hz, telemetry at 50 Hz."""
    with tempfile.TemporaryDirectory() as directory:
        flash = Path(directory) / "flash.json"
        flash.write_text(json.dumps({"tare_pa": [101325.0] * 4}))
        cpu_us = _cycle_us(flash, CYCLES)
    budget_us = SHARE * CYCLE_US
    against = f"budget {budget_us:.0f} us, {SHARE:.0%} of a core"
    process = {"value": cpu_us, "unit": "us", "against": against, "ratio": cpu_us / budget_us}
    return {"firmware_cycle_cpu": process, **_costs()}


def _costs() -> dict[str, dict[str, Any]]:
    """Time and memory of a cycle in one process, without pipes, for each law under MicroPython."""
    micropython = which("micropython")
    rows: dict[str, dict[str, Any]] = {}
    for law in ("observer", "pid", "pi") if micropython else ():
        unix, cpython = [micropython, "-X", HEAP], [sys.executable]
        us, cpython_us = (
            statistics.median(cycle_cost(program, FIRMWARE, law, "us") for _ in range(COST_RUNS))
            for program in (unix, cpython)
        )
        taken = cycle_cost(unix, FIRMWARE, law, "bytes")
        against = f"a proxy for the board; under CPython {cpython_us:.0f} us"
        rows[f"firmware_step_us_{law}"] = {"value": us, "unit": "us", "against": against, "ratio": us / cpython_us}
        rows[f"firmware_step_bytes_{law}"] = {
            "value": taken,
            "unit": "bytes",
            "against": "a proxy: free heap of the board, where objects are half as large",
            "ratio": 0.5 * taken / BOARD_HEAP,
        }
    return rows


def _cycle_us(flash: Path, cycles: int) -> float:
    """CPU time of the firmware process per armed cycle, start-up taken off by a run of another length."""
    return (_cpu_s(flash, 2 * cycles) - _cpu_s(flash, cycles)) / cycles * 1e6


def _cpu_s(flash: Path, cycles: int) -> float:
    master, slave = os.openpty()
    for fd in (master, slave):
        tty.setraw(fd)
    os.set_blocking(master, False)
    ours, theirs = socket.socketpair()
    main = Path(wire.__file__).with_name("main.py")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process = subprocess.Popen(
        [sys.executable, main, str(master), str(theirs.fileno()), flash], pass_fds=[master, theirs.fileno()]
    )
    theirs.close()
    host = _Host(slave)
    listener = threading.Thread(target=host.listen)
    listener.start()
    with ours:
        for cycle in range(1, cycles + 400):
            if cycle % 5 == 0:
                host.talk(cycle)
            ours.sendall(bus.tick(cycle * CYCLE_US, PRESSURE_PA, 15000, 100, 0, 15))
            pins = struct.unpack(bus.ACT, ours.recv(bus.ACT_SIZE, socket.MSG_WAITALL))
    process.wait()
    os.close(master)
    listener.join()
    os.close(slave)
    if not pins[ARMED]:
        raise RuntimeError("the firmware never armed: this measures the wrong thing")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


class _Host:
    """Greets, arms, sends set-points, and reads what comes."""

    def __init__(self, fd: int) -> None:
        self.fd, self.boot_id, self.writer = fd, 0, wire.Writer()

    def on_frame(self, kind: int, _seq: int, payload: memoryview) -> None:
        if kind == wire.HELLO_ACK:
            self.boot_id = wire.unpack(kind, payload)[4]

    def talk(self, cycle: int) -> None:
        if cycle == 5:
            os.write(self.fd, self.writer.frame(wire.HELLO, wire.PROTOCOL, wire.schema_crc(), 1))
        if cycle % 50 == 0 and cycle >= 320:
            os.write(self.fd, self.writer.frame(wire.ARM, cycle & 0xFFFF, self.boot_id))
        os.write(
            self.fd, self.writer.frame(wire.SETPOINT, 3000, 0, 0, 0, 0, 0, *[1500] * 4, 0, wire.VALID_ALL, 500, cycle)
        )

    def listen(self) -> None:
        framer = wire.Framer(self.on_frame)
        while True:
            try:
                chunk = os.read(self.fd, 4096)
            except OSError:
                return
            framer.feed(chunk, len(chunk))


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
