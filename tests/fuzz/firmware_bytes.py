"""The firmware's tether, orders, ladder and control under whatever may come down the line, in whatever state they are.

Frames with random fields, orders that are meant for this boot under numbers used again and again, mutated frames and
noise; sensors that leap, fail and come back; armed most of the time. After each cycle: nothing broke off, pulses,
servos and lamp are within their limits, a disarmed robot is at rest, and what the board says is well formed.
"""

from __future__ import annotations

import random
from typing import Any, NamedTuple

from hw.firmware import failsafe, parameters, wire
from tests.fuzz.wire_frames import frame, mutated, noise, random_fields
from tests.hw.firmware.bare_board import CYCLE_US, BareBoard, BareHal
from tests.hw.firmware.nominal_plant import AIR_PA, PA_PER_M

ORDERS = [row[0] for row in wire.TABLE if row[3].startswith("req_id boot_id") and row[0] != wire.PARAM_VALUE]
LIFE_CYCLES = 400  # of one boot with one set of parameters
LOWEST_US, HIGHEST_US = 1100, 1900
SERVO_US = 500, 2500
DIVERGED = "law diverged"  # the one fault that is meant: sensors leapt farther than water lets a robot


class Counts(NamedTuple):
    """What a run has seen."""

    cycles: int
    armed: int  # cycles
    levels: frozenset[int]  # of the ladder
    frames_ok: int  # that the board took for whole


def run(count: int, seed: int) -> None:
    """Send `count` streams. AssertionError with the seed, the number of the stream and its bytes at the first wrong."""
    fuzz(count, seed)


def fuzz(count: int, seed: int) -> Counts:
    """The same; what was reached."""
    rng = random.Random(seed)
    cycles = armed = sent = frames_ok = 0
    levels: set[int] = set()
    while sent < count:
        life = Life(rng)
        for _ in range(LIFE_CYCLES):
            streams = [life.stream() for _ in range(min(rng.randrange(6), count - sent))]
            sent += len(streams)
            try:
                life.tick(streams)
            except Exception as error:
                text = " ".join(stream.hex() for stream in streams)
                raise AssertionError(f"seed {seed}, up to stream {sent}, {text}: {error!r}") from error
            cycles += 1
            armed += life.board.hal.armed
            levels.add(life.board.control.ladder.level)
            if sent >= count or life.board.control.ladder.level == failsafe.LATCHED:
                break
        frames_ok += life.board.firmware.tether._framer.rx_ok
    return Counts(cycles, armed, frozenset(levels), frames_ok)


class Life:
    """One board, from one start to its last cycle."""

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        flash: dict[str, Any] = {
            "tare_pa": [AIR_PA + rng.uniform(-200, 200) for _ in range(4)],
            "wiring": failsafe.WIRING,
        }
        for name, _, lowest, highest, kind in rng.sample(parameters.TABLE, rng.randrange(5)):
            value = rng.choice((lowest, highest, rng.uniform(lowest, highest)))
            flash[name] = round(value) if kind == parameters.WHOLE else value
        self.board = BareBoard(BareHal(flash))
        self.broken: list[tuple[str, Exception]] = []
        self.board.firmware.tether.fault = lambda where, error: self.broken.append((where, error))
        if rng.random() < 0.8:
            self.board.greet()

    def stream(self) -> bytes:
        """Something for the tether."""
        rng, writer = self.rng, self.board.writer
        chance = rng.random()
        if chance < 0.1:
            return noise(rng)
        if chance < 0.4:  # an order for this boot, under one of few numbers
            kind = rng.choice(ORDERS)
            if kind in (wire.ESTOP, wire.REBOOT) and rng.random() < 0.9:
                kind = wire.MODE
            one = frame(writer, kind, (rng.randrange(4), self.board.boot_id, *random_fields(rng, kind)[2:]))
        elif chance < 0.6:
            depth_100um = rng.randrange(10_000)
            small = [rng.randrange(-2000, 2000) for _ in range(5)]
            one = frame(writer, wire.SETPOINT, (depth_100um, *small, *[1500] * 4, 0, wire.VALID_ALL, 500, 7))
        else:
            kind = rng.choice(wire.TABLE)[0]
            one = frame(writer, kind, random_fields(rng, kind))
        return mutated(rng, one) if rng.random() < 0.3 else one

    def tick(self, streams: list[bytes]) -> None:
        """One cycle with all of this on the line. AssertionError where it leaves its limits."""
        rng, hal, control = self.rng, self.board.hal, self.board.control
        hal.to_board = b"".join(streams)
        self.sensors()
        if control.state == wire.DISARMED and rng.random() < 0.3:
            control.arm()  # the checks would need three quiet seconds
        hal.us += rng.choice((0, CYCLE_US, CYCLE_US, CYCLE_US, 3 * CYCLE_US, 1 << 32)) - CYCLE_US
        self.board.tick()
        assert all(where == "control" and str(error) == DIVERGED for where, error in self.broken), self.broken
        assert all(type(us) is int and LOWEST_US <= us <= HIGHEST_US for us in hal.pulses_us), hal.pulses_us
        assert all(SERVO_US[0] <= us <= SERVO_US[1] for us in hal.servos_us), hal.servos_us
        assert 0 <= hal.light_permille <= 1000 and hal.armed == control.state in (wire.DISARMED, wire.ARMED)
        assert hal.armed or hal.pulses_us == control.neutral_us
        assert not hal.armed or control.ladder.level < failsafe.DISARM
        assert self.board.framer.rx_bad == 0
        self.board.frames.clear()
        if self.board.firmware.tether.orders.reboot:
            self.board.reboot()
            self.board.firmware.tether.fault = lambda where, error: self.broken.append((where, error))

    def sensors(self) -> None:
        """Mostly a robot that moves a little; at times what no water does."""
        rng, hal = self.rng, self.board.hal
        for k in range(4):
            hal.pressure_pa[k] += rng.uniform(-20.0, 20.0)
        chance = rng.random()
        if chance < 0.01:
            hal.pressure_pa = [rng.uniform(0.0, 200_000.0) for _ in range(4)]
        elif chance < 0.02:
            hal.pressure_pa = [AIR_PA + rng.uniform(0.0, 1.5) * PA_PER_M] * 4
        elif chance < 0.03:
            hal.answered, hal.battery_mv, hal.leak = rng.randrange(16), rng.randrange(65536), rng.randrange(2)
        elif chance < 0.1:
            hal.answered, hal.battery_mv, hal.leak = 15, 15000, 0
