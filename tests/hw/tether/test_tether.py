"""The board's end of the tether in whole numbers: what it rounds, what it clips, what it takes for a slow cycle."""

from __future__ import annotations

import itertools
import math
import random
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hw.firmware import parameters, wire
from tests.hw.desk import MICROPYTHON
from tests.hw.firmware.bare_board import FIRMWARE, BareBoard

CHECK = Path(__file__).with_name("check_tether.py")
SHALLOWEST, DEEPEST = (
    -1_000_000,
    188_000_000,
)  # 100 nm; three good sensors at their limits, the fourth made up from them
I16 = (-32768, 32767)


class Bounded(int):
    """A whole number that fails as soon as arithmetic leaves its bits, sign and all."""

    bits = 32


def _checked(name: str) -> Any:
    plain = getattr(int, name)

    def act(self: Bounded, *others: int) -> Bounded:
        value = plain(int(self), *(int(other) for other in others))
        assert -(1 << self.bits - 1) <= value < 1 << self.bits - 1, f"{name}{(int(self), *others)} is {value}"
        return type(self)(value)

    return act


for _name in ("add", "sub", "mul", "floordiv", "lshift", "rshift", "and", "or"):
    setattr(Bounded, f"__{_name}__", _checked(f"__{_name}__"))
    setattr(Bounded, f"__r{_name}__", _checked(f"__r{_name}__"))
Bounded.__neg__ = _checked("__neg__")


class Small(Bounded):
    """What MicroPython holds on a chip of 32 bits without taking memory."""

    bits = 31


@pytest.fixture
def board() -> BareBoard:
    board = BareBoard()
    board.greet()
    return board


@pytest.fixture
def tether(board) -> Any:
    return sys.modules[type(board.firmware.tether).__module__]


def telemetry(board: BareBoard, **values: Any) -> dict[str, Any]:
    """What is said of such a state, by field; repeated ones as tuples."""
    control, line = board.control, board.firmware.tether
    plane = SimpleNamespace(
        bad=0,
        disagree=False,
        tare_mPa=[1] * 4,
        zeta_100nm=values.get("zeta_100nm", [0] * 4),
        roll_100nrad=values.get("roll_100nrad", 0),
        pitch_100nrad=values.get("pitch_100nrad", 0),
        depth_100nm=values.get("depth_100nm", 0),
    )
    law = SimpleNamespace(disturbance=values.get("disturbance", [0, 0, 0]).__getitem__)
    real = control.plane, control.law
    control.plane, control.law = plane, law
    try:
        line.say_telemetry()
    finally:
        control.plane, control.law = real
    frames: list[tuple[Any, ...]] = []
    framer = wire.Framer(lambda kind, _seq, payload: frames.append(wire.unpack(kind, payload)))
    chunk = bytes(board.hal.from_board)
    board.hal.from_board.clear()
    framer.feed(chunk, len(chunk))
    ((_, _, _, flags, *rest),) = frames
    return {"flags": flags, "zeta": rest[:4], "tilt": rest[4:6], "depth": rest[6], "disturbance": rest[7:10]}


def off(said: list[int], exact: list[float], per_million: float) -> float:
    """The farthest from it, without so many millionths, which is what a factor of 16 bits is wrong by."""
    return max(abs(a - b) - 1e-6 * per_million * abs(b) for a, b in zip(said, exact, strict=True))


def test_depths_angles_and_disturbances_are_rounded_to_the_wire(board):
    rng = random.Random(3)
    for _ in range(2000):
        zeta = [rng.randint(SHALLOWEST, DEEPEST) for _ in range(4)]
        roll, pitch = (rng.randint(-15_700_000, 15_700_000) for _ in range(2))
        depth, push = rng.randint(-1_000_000, 32_000_000), rng.randint(-32_000_000, 32_000_000)
        moments = [rng.randint(-3_200_000, 3_200_000) for _ in range(2)]
        said = telemetry(
            board,
            zeta_100nm=zeta,
            roll_100nrad=roll,
            pitch_100nrad=pitch,
            depth_100nm=depth,
            disturbance=[push, *moments],
        )
        assert off(said["zeta"], [1e-6 * wire.PA_PER_M * z for z in zeta], per_million=1.1) < 0.502
        assert off(said["tilt"], [math.degrees(1e-7 * angle) * 100 for angle in (roll, pitch)], per_million=3.0) < 0.502
        assert said["depth"] == pytest.approx(depth * 1e-3, abs=0.5)
        assert said["disturbance"] == pytest.approx([push * 1e-3, *(m * 1e-2 for m in moments)], abs=0.5)


def test_what_does_not_fit_the_wire_is_clipped(board):
    for sign, limit in zip((-1, 1), I16, strict=True):
        said = telemetry(board, depth_100nm=sign * 40_000_000, disturbance=[sign * 10**8] * 3)
        assert (said["depth"], said["disturbance"]) == (limit, [limit] * 3)
    said = telemetry(board, depth_100nm=3_000_000, disturbance=[0, 0, -4_000_000])
    assert (said["depth"], said["disturbance"]) == (3000, [0, 0, -32768]), "the others stay what they are"


def test_no_number_of_telemetry_needs_more_than_a_machine_word(board, tether, monkeypatch):
    monkeypatch.setattr(tether, "int", Bounded, raising=False)
    rng = random.Random(4)
    edges = [SHALLOWEST, -1, 0, 4095, 4096, DEEPEST - 1, DEEPEST]
    for z in [*edges, *(rng.randint(SHALLOWEST, DEEPEST) for _ in range(2000))]:
        said = telemetry(board, zeta_100nm=[z, -z, z // 2, 0])
        assert off(said["zeta"], [1e-6 * wire.PA_PER_M * zeta for zeta in (z, -z, z // 2, 0)], per_million=1.1) < 0.502
    with pytest.raises(AssertionError, match="mul"):
        telemetry(board, zeta_100nm=[1 << 30] * 4)


def test_no_number_of_telemetry_takes_memory(board):
    for tilt, depth, push in itertools.product((-31_500_000, 31_500_000), (SHALLOWEST, DEEPEST), (-(10**9), 10**9)):
        said = telemetry(
            board,
            roll_100nrad=Small(tilt),
            pitch_100nrad=Small(tilt),
            depth_100nm=Small(depth),
            disturbance=[Small(push)] * 3,
        )
        assert abs(said["tilt"][0]) == 18048


def test_a_set_point_is_taken_over_without_a_number_that_takes_memory(board, tether, monkeypatch):
    real = tether.read_set_point

    def small(payload: memoryview, out: list[int]) -> None:
        real(payload, out)
        out[:13] = [Small(value) for value in out[:13]]

    monkeypatch.setattr(tether, "read_set_point", small)
    for value, us, ms in ((-32768, 500, 0), (32767, 2500, 65535), (-1, 1500, 500), (100, 1501, 1)):
        fields = (*[value] * 6, *[us] * 4, 1000, wire.VALID_ALL, ms, 0xFFFFFFFF - ms)
        board.say(wire.SETPOINT, *fields)
        board.tick()
        asked = board.control.set_point
        assert board.faults == 0 and asked.depth_100nm == 1000 * value and asked.force_uN == [1000 * value] * 2
        assert asked.tilt_100nrad == pytest.approx([math.radians(value * 0.01) * 1e7] * 2, rel=3e-6, abs=1.0)
        assert (asked.yaw_uNm, asked.ttl_us, asked.host_time) == (100 * value, 1000 * ms, 0xFFFFFFFF - ms)
        assert board.hal.servos_us == [us] * 4 and board.hal.light_permille == 1000


def test_parts_of_a_set_point_that_are_not_valid_keep_what_was_set(board):
    before = (*[5] * 6, 1500, 1501, 1502, 1503, 20, wire.VALID_ALL, 500, 7)
    after = (*[9] * 6, 1600, 1601, 1602, 1603, 30)
    asked, hal = board.control.set_point, board.hal

    def parts() -> list[Any]:
        force = [*asked.force_uN, asked.yaw_uNm]
        return [asked.depth_100nm, [*asked.tilt_100nrad], force, [*hal.servos_us], hal.light_permille]

    for bit in range(5):
        board.say(wire.SETPOINT, *before)
        board.tick()
        first = parts()
        board.say(wire.SETPOINT, *after, 1 << bit, 500, 8)
        board.tick()
        changed = [old != new for old, new in zip(first, parts(), strict=True)]
        assert changed == [i == bit for i in range(5)]


@pytest.mark.parametrize("k", range(4))
@pytest.mark.parametrize("us", [499, 2501])
def test_a_pulse_that_is_no_servo_s_moves_none(board, k, us):
    servos = [1600] * 4
    servos[k] = us
    board.say(wire.SETPOINT, *[0] * 6, *servos, 0, wire.VALID_ALL, 500, 7)
    board.tick()
    assert board.hal.servos_us == [1500] * 4 and board.faults == 0


def seconds(line: Any, hal: Any, *longest_us: int, lost: int = 0) -> None:
    """A STATUS after each; ticks are lost in the first."""
    hal.late = (hal.late + lost) & 0xFFFF
    for us in longest_us:
        for took in (4000, us, 3000):
            line.took(took)
        line.say_status()


def test_a_slow_cycle_counts_for_one_to_two_seconds(board):
    line, hal = board.firmware.tether, board.hal
    seconds(line, hal, 5000, 5000)
    assert line.slowest_us() == 5000
    line.took(9500)
    assert line.slowest_us() == 9500, "in the second that runs"
    line.say_status()
    line.took(4000)
    assert line.slowest_us() == 9500, "in the last one"
    seconds(line, hal, 4000)
    assert line.slowest_us() == 4000


@pytest.mark.parametrize("late", [0, 65535])
def test_a_lost_tick_is_a_slow_cycle_however_long_cycles_are_said_to_be(board, late):
    line, hal = board.firmware.tether, board.hal
    hal.late = late
    seconds(line, hal, 4000, 4000)
    assert line.slowest_us() == 4000
    hal.late = (late + 1) & 0xFFFF
    assert line.slowest_us() == 65535
    seconds(line, hal, 4000)
    assert line.slowest_us() == 65535
    seconds(line, hal, 4000)
    assert line.slowest_us() == 4000


def test_a_board_that_loses_ticks_is_not_armed_and_says_why(board):
    board.hold(320)
    board.hal.late += 1
    ((_, fields),) = board.answers(wire.ARM, 1, board.boot_id)
    assert fields[2] == wire.REFUSED
    board.tick(2)
    assert board.heard(wire.EVENT)[-1][5] == 1 << wire.ARM_CHECKS.index("control cycle too slow")
    board.hold(210)
    assert board.heard(wire.STATUS)[-1][8] == board.hal.late
    ((_, fields),) = board.answers(wire.ARM, 2, board.boot_id)
    assert fields[2] == wire.OK


def test_the_pulse_frame_is_set_at_boot_and_when_the_parameter_is(board, monkeypatch):
    frames: list[int] = []
    monkeypatch.setattr(board.hal, "begin_pulses", frames.append)
    board.reboot()
    assert frames == [5000]
    number = parameters.NAMES.index("pulse_frame_us")
    for us in (2500.0, 20000.0, 2499.0, 3000.5):
        board.say(wire.PARAM_SET, 5, board.boot_id, number, 1, 0, us)
        board.tick()
    board.say(wire.PARAM_SET, 6, board.boot_id, 2, 0, 0, 9.0)
    board.tick()
    assert frames == [5000, 2500, 20000]


@pytest.mark.skipif(MICROPYTHON is None, reason="the MicroPython Unix port is not installed")
def test_telemetry_and_set_points_leave_nothing_in_the_heap():
    ran = subprocess.run([str(MICROPYTHON), CHECK, FIRMWARE], capture_output=True, text=True, timeout=60)
    assert ran.stdout.split() == ["0", "0"], ran.stderr
