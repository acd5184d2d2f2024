"""A dive with stand-ins: a firmware of a few lines in place of the real one, or no firmware and no port at all."""

import fcntl
import os
import select
import struct
import termios
import time

import numpy as np

from agent.core.config import Fleet, Pose, Robot, Target, Twin
from hw.twin.board import Board
from hw.twin.dive import Dive, run_in_lock_step
from hw.twin.physics.sensors import PA_PER_M
from tests.waiting import until

# Echoes its serial bytes with 1 added; arms at 0.1 s and then pushes up; "die" on the serial port ends it.
FIRMWARE = """
import json, os, struct, sys
serial, bus, flash = int(sys.argv[1]), int(sys.argv[2]), json.load(open(sys.argv[3]))
TICK, ACT = struct.Struct("<QHH4IHHBBhBhH"), struct.Struct("<Q8H4HHBHII")
assert len(flash["tare_pa"]) == 4
while True:
    record = os.read(bus, TICK.size)
    if not record:
        sys.exit()
    clock_us, *rest = TICK.unpack(record)
    try:
        heard = os.read(serial, 4096)
    except BlockingIOError:
        heard = b""
    if heard == b"die":
        sys.exit("the board is on fire")
    if heard:
        os.write(serial, bytes((byte + 1) % 256 for byte in heard))
    armed = clock_us >= 100_000
    up = 1580 if armed else 1500
    pins_us, busy_us = flash.get("takes_us", (0, 0))
    pins = (up, up, up, up, 1500, 1500, 1500, 1500, 1700, 1400, 1500, 1500, 0, armed)
    os.write(bus, ACT.pack(clock_us, *pins, 5000, pins_us, busy_us))
"""


def fleet(names=("r1", "r2"), seed=4, turn_deg=0.0):
    """Robots side by side, each turned by `turn_deg` more than the one before."""
    robots = {
        name: Robot(
            listen=f"tcp/127.0.0.1:{17401 + i}",
            serial=f"twin:{name}",
            camera=f"twin:{name}",
            pose=Pose(x_m=0.4 + 0.6 * i, y_m=0.5, yaw_deg=turn_deg * i),
            calibration="none.toml",
        )
        for i, name in enumerate(names)
    }
    return Fleet(fleet="tank", target={"ball": Target(radius_m=0.07)}, robot=robots, twin=Twin(seed=seed))


# --- a firmware of a few lines ------------------------------------------------------------------------------------


def pid(board: Board) -> int:
    """Process of the firmware."""
    return board._boot._process.pid


def gone(process: int) -> bool:
    """Whether it has ended and been reaped."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


def catch_up(board: Board) -> None:
    """Let a firmware answer all that it was asked."""

    def caught_up() -> bool:
        board.act(0.0)
        return not board.overdue

    until(caught_up)


def tell(board: Board, port: int, data: bytes) -> None:
    """Write to the port, and wait until the kernel, which does so in the background, has handed it all over."""

    def arrived() -> int:
        return struct.unpack("i", fcntl.ioctl(board._cable._master, termios.FIONREAD, bytes(4)))[0]

    os.write(port, data)
    until(lambda: arrived() >= len(data))


def answer(dive: Dive, port: int, data: bytes) -> bytes:
    """What the first robot's firmware says to `data`: as many bytes."""
    tell(dive.boards[0], port, data)
    run_in_lock_step(dive, 3)
    return read_all(port, len(data))


def read_all(fd, count, limit_s=5.0):
    data, end_s = b"", time.monotonic() + limit_s
    while len(data) < count and time.monotonic() < end_s:
        if select.select([fd], [], [], 0.05)[0]:
            data += os.read(fd, count - len(data))
    return data


# --- no firmware at all -------------------------------------------------------------------------------------------


class RecordingBoard:
    """Stands in for a board: takes what the hardware says, drives the pins that it is given."""

    def __init__(self):
        self.ticks = []
        self.driving = False

    def act(self, patience_s):
        return None

    def tick(self, *readings):
        self.ticks.append(readings)


def boardless_dive(**keywords):
    made = Dive(fleet(), ["r1", "r2"], 0, **keywords)
    made.boards = [RecordingBoard(), RecordingBoard()]
    return made


def readings_m(made, robot=0):
    return (np.array(made._readings_pa[robot]) - made.tare_pa[robot]) / PA_PER_M


def run(made, ticks):
    for _ in range(ticks):
        made.tick(0.0)
