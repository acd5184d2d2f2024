"""What breaks off within a cycle: it is left out, counted and told, and the motors stop only as the ladder says."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

import pytest

from hw.firmware import failsafe, wire
from tests.hw.firmware.bare_board import CYCLE_US, BareBoard, BareHal, firmware_main
from tests.hw.firmware.nominal_plant import AIR_PA, PA_PER_M

CONTROL = firmware_main().motor_control
LOST_CYCLES = CONTROL._LOST_US // CYCLE_US


def breaks(*_: Any) -> None:
    raise ZeroDivisionError("on purpose")


def breaks_when(bad: Callable[[], bool], do: Callable[..., Any]) -> Callable[..., Any]:
    """`do`, but for when `bad` says so."""
    return lambda *fields: breaks() if bad() else do(*fields)


@pytest.fixture
def board():
    board = BareBoard()
    board.arm()
    board.hold(100)
    board.frames.clear()
    return board


def text(board: BareBoard) -> str:
    """All lines for people since frames were last cleared."""
    return "\n".join(said.decode() for _, said in board.heard(wire.LOG))


def ladder(board: BareBoard) -> tuple[int, str]:
    return board.control.ladder.level, wire.REASONS[board.control.ladder.reason]


def test_a_frame_that_breaks_its_parser_is_left_out_and_the_stop_behind_it_is_heard(board):
    board.firmware.tether.orders._mode = breaks
    board.hal.leak = 0
    board.say(wire.MODE, 3, board.boot_id, wire.STABILISE, 0)
    board.say(wire.DISARM, 4, board.boot_id)
    board.tick(2)
    assert [(ack[0], ack[2]) for ack in board.heard(wire.ACK)] == [(3, wire.REFUSED), (4, wire.OK)]
    assert board.faults == 1 and board.control.state == wire.DISARMED
    board.tick(10)
    assert "fault 1, order: ZeroDivisionError" in text(board)


@pytest.mark.parametrize("part", ["listen", "_on_set_point", "say_telemetry", "say_one", "say_status"])
def test_a_broken_tether_does_not_stop_the_control_law(board, part):
    """Heard or not, each cycle makes its pulses; where no set-point comes through, the ladder says what then."""
    setattr(board.firmware.tether, part, breaks)
    before = board.control.law._state[0][0]
    for mm in range(1, 9):  # it sinks
        board.hal.pressure_pa = [AIR_PA + (0.3 + 1e-3 * mm) * PA_PER_M] * 4
        board.hold(5)
    assert (
        board.control.state == wire.ARMED
        and board.control.law._state[0][0] == pytest.approx(3_080_000, abs=1e4) != before
    )
    assert min(board.hal.pulses_us[:4]) > 1530, "too deep: up"
    board.hold(60)
    assert board.faults >= 1
    deaf = part in ("listen", "_on_set_point")
    assert ladder(board) == ((failsafe.HOLD, "host silent") if deaf else (failsafe.OK, "none"))


def test_faults_are_told_once_a_second_with_their_number(board):
    board.firmware.tether._on_hello = breaks
    for _ in range(250):
        board.set_point()
        board.say(wire.HELLO, 1, 2, 3)
        board.tick()
    assert board.faults == 250
    assert text(board).count("ZeroDivisionError") == 3 and "fault 201, frame" in text(board)


def test_a_fault_without_memory_for_words_is_counted(board):
    board.firmware.tether._on_hello = breaks
    board.firmware.tether.log = breaks
    board.say(wire.HELLO, 1, 2, 3)
    board.tick()
    assert board.faults == 1 and board.control.state == wire.ARMED


def test_an_order_to_arm_that_breaks_off_leaves_the_motors_off():
    board = BareBoard()
    board.greet()
    board.tick(301)
    board.set_point()
    board.tick()
    arm = board.control.arm

    def arm_and_break() -> None:
        arm()
        breaks()

    board.control.arm = arm_and_break
    ((_, fields),) = board.answers(wire.ARM, 1, board.boot_id)
    assert fields[2] == wire.REFUSED and board.control.state == wire.DISARMED


def test_flash_that_cannot_be_written_refuses_the_order_and_no_more():
    class WornOut(BareHal):
        def save_flash(self, flash: dict[str, Any]) -> None:
            raise OSError(5)

    board = BareBoard(WornOut())
    board.greet()
    ((_, fields),) = board.answers(wire.PARAM_SAVE, 1, board.boot_id)
    assert fields[2] == wire.REFUSED
    board.hal.pressure_pa = [AIR_PA] * 4
    board.answers(wire.TARE, 2, board.boot_id, 0)
    board.tick(201)
    assert board.heard(wire.ACK)[-1][:3] == (2, wire.TARE, wire.REFUSED) and board.faults == 2


@pytest.mark.parametrize("part", ["step", "result"])
def test_a_tare_that_breaks_off_is_refused_once_and_no_order_waits_for_it(part, monkeypatch):
    board = BareBoard()
    board.greet()
    board.hal.pressure_pa = [AIR_PA] * 4
    board.answers(wire.TARE, 2, board.boot_id, 0)
    monkeypatch.setattr(board.firmware.tether.orders._tare, part, breaks)
    board.tick(250)
    assert [ack[:3] for ack in board.heard(wire.ACK)] == [(2, wire.TARE, wire.RUNNING), (2, wire.TARE, wire.REFUSED)]
    ((_, fields),) = board.answers(wire.PARAM_SAVE, 3, board.boot_id)
    assert fields[2] == wire.OK and board.faults == 1


def test_an_event_or_a_value_that_cannot_be_said_does_not_block_those_behind_it(board):
    say_value, orders = board.firmware.tether.orders._say_value, board.firmware.tether.orders
    orders._say_value = lambda req_id, i: breaks() if i == 2 else say_value(req_id, i)
    board.firmware.tether.event(wire.EV_LADDER, 0, 0, wire.INFO, 1 << 20)  # more than its field holds
    board.firmware.tether.event(wire.EV_LADDER, 0, 0, wire.INFO, 9)
    board.say(wire.PARAM_LIST, 5, board.boot_id)
    board.hold(40)
    assert [event[5] for event in board.heard(wire.EVENT)] == [9, 9, 9]
    heard = [value[2] for value in board.heard(wire.PARAM_VALUE)]
    assert heard == [0, 1, *range(3, len(board.control.values))], "all but the one that broke off"
    assert board.faults == 4


@pytest.mark.parametrize("part", ["law", "pulses", "sensors"])
def test_one_fault_of_the_control_law_is_a_cycle_with_the_pulses_of_the_last(board, part, monkeypatch):
    board.hal.pressure_pa = [AIR_PA + 0.31 * PA_PER_M] * 4
    board.hold(10)
    before = list(board.hal.pulses_us)
    with monkeypatch.context() as broken:
        where = {"law": (board.control.law, "step"), "pulses": (board.control, "_drive")}
        broken.setattr(*where.get(part, (board.control.plane, "step")), breaks)
        board.tick()
    assert board.hal.pulses_us == before and board.faults == 1
    board.hold(300)
    assert board.control.state == wire.ARMED and ladder(board) == (failsafe.OK, "none")
    assert board.hal.pulses_us != before and board.faults == 1


def test_a_control_law_that_breaks_off_again_and_again_brings_the_robot_up_under_control(board):
    """Every third cycle is lost: more than can be made up for. The law works in the others, and with it the ascent."""
    count = iter(range(10_000))
    board.control.law.step = breaks_when(lambda: next(count) % 3 == 0, board.control.law.step)
    board.hold(3 * CONTROL._FAULTS_LIMIT + 3)
    assert ladder(board) == (failsafe.SURFACE, "control fault")
    assert any(event[5] == wire.REASONS.index("control fault") for event in board.heard(wire.EVENT))
    board.hold(200)
    assert board.control.state == wire.ARMED and min(board.hal.pulses_us[:4]) > 1530
    assert ladder(board)[0] == failsafe.SURFACE, "set-points do not call it back"


def test_a_control_law_that_never_works_again_stops_the_motors_after_half_a_second(board):
    board.control.law.step = breaks
    board.hold(LOST_CYCLES - 1)
    assert board.control.state == wire.ARMED and ladder(board)[0] == failsafe.SURFACE
    board.hold(1)
    assert board.control.state == wire.DISARMED and board.hal.pulses_us == [1500] * 8
    assert ladder(board) == (failsafe.DISARM, "control fault")
    board.hold(10)
    assert any(
        event[3] == failsafe.DISARM and event[5] == wire.REASONS.index("control fault")
        for event in board.heard(wire.EVENT)
    )


def test_a_fault_a_second_is_made_up_for(board):
    count = iter(range(10_000))
    board.control.law.step = breaks_when(lambda: next(count) % 100 == 0, board.control.law.step)
    board.hold(1000)
    assert CONTROL._FAULT_CYCLES < 100 and board.faults == 10
    assert board.control.state == wire.ARMED and ladder(board) == (failsafe.OK, "none")


def on_the_bench() -> BareBoard:
    """Thruster 3 turns."""
    board = BareBoard()
    board.greet()
    board.answers(wire.MODE, 5, board.boot_id, wire.BENCH, 3)
    board.arm(req_id=6)
    board.hold(5)
    assert board.hal.pulses_us[2] == 1560
    return board


def test_on_the_bench_the_first_fault_of_the_control_stops_the_thruster():
    board = on_the_bench()
    board.control._turn_one = breaks
    board.hold(1)
    assert board.control.state == wire.DISARMED and board.hal.pulses_us == [1500] * 8


def poison_observer(law: Any, speed: int) -> None:
    law._state[0][1] = speed


def poison_pid(law: Any, integral: float) -> None:
    law._integral[0] = integral


@pytest.mark.parametrize(
    ("law", "poison", "value"),
    [
        ("observer", poison_observer, 1 << 40),
        ("observer", poison_observer, -(1 << 29)),
        *[(law, poison_pid, value) for law in ("pid", "pi") for value in (math.nan, math.inf, -1e30)],
    ],
)
def test_a_law_that_has_left_the_world_begins_anew_instead_of_running_the_motors_full(law, poison, value):
    board = BareBoard(BareHal({"tare_pa": [AIR_PA] * 4, "wiring": failsafe.WIRING, "law": law}))
    board.arm()
    board.hold(20)
    before = list(board.hal.pulses_us)
    poison(board.control.law, value)
    board.hold(1)
    assert board.hal.pulses_us == before
    board.hold(50)
    assert board.control.state == wire.ARMED and all(abs(us - 1500) < 100 for us in board.hal.pulses_us)
    assert board.faults == 1


def test_a_servo_pulse_that_is_no_servos_leaves_the_gimbal_where_it_is(board):
    for us in (0, 499, 2501, 65535):
        fields = (3000, 0, 0, 0, 0, 0, 1600, us, 1500, 1500, 0, wire.VALID_ALL, 500, 7)
        board.say(wire.SETPOINT, *fields)
        board.tick()
        assert board.hal.servos_us == [1500] * 4
    board.say(wire.SETPOINT, 3000, 0, 0, 0, 0, 0, 500, 2500, 1500, 1500, 0, wire.VALID_ALL, 500, 7)
    board.tick()
    assert board.hal.servos_us == [500, 2500, 1500, 1500]


@pytest.mark.parametrize("armed", [False, True])
def test_light_that_nobody_asks_for_any_more_goes_out_within_a_second(armed):
    board = BareBoard()
    if armed:
        board.arm()
    else:
        board.greet()
    lit = (3000, 0, 0, 0, 0, 0, 1500, 1500, 1500, 1500, 600, wire.VALID_ALL, 500, 7)
    for _ in range(120):  # a host that talks
        board.say(wire.SETPOINT, *lit)
        board.tick()
        assert board.hal.light_permille == 600
    board.tick(50)
    assert board.hal.light_permille == 600
    board.tick(50)
    assert board.hal.light_permille == 0
    board.say(wire.SETPOINT, *lit)
    board.tick()
    assert board.hal.light_permille == 600


# --- what a program on the bench leaves on ---


@pytest.mark.parametrize("mode", [wire.BENCH, wire.STABILISE])
def test_the_mode_that_a_host_leaves_on_is_not_the_next_ones(mode):
    board = BareBoard()
    board.greet()
    board.answers(wire.MODE, 5, board.boot_id, mode, 3)
    board.tick(50)
    board.greet(host=2)
    board.hold(301)
    assert board.answers(wire.ARM, 1, board.boot_id)[0][1][2] == wire.OK
    board.hold(50)
    assert board.control.mode == wire.HOLD and board.hal.pulses_us != [1500, 1500, 1560, *[1500] * 5]


def test_nor_does_it_arm_a_robot_whose_wires_nobody_has_checked():
    board = BareBoard(BareHal({"tare_pa": [AIR_PA] * 4}))
    board.greet()
    board.answers(wire.MODE, 5, board.boot_id, wire.BENCH, 3)
    board.greet(host=2)
    board.hold(301)
    assert board.answers(wire.ARM, 1, board.boot_id)[0][1][2] == wire.REFUSED


def test_a_thruster_that_turns_on_the_bench_stops_when_another_host_greets():
    board = on_the_bench()
    board.greet()
    assert board.hal.pulses_us[2] == 1560, "the same host may greet again"
    board.greet(host=2)
    board.tick(4)
    assert board.hal.pulses_us == [1500] * 8 and board.control.state == wire.DISARMED
    assert (wire.EV_DISARMED, wire.REASONS.index("host silent")) in {(e[1], e[5]) for e in board.heard(wire.EVENT)}


# --- a battery's noise ---


def test_one_low_sample_of_the_battery_refuses_no_order_to_arm():
    board = BareBoard()
    board.greet()
    board.hold(301)
    board.hal.battery_mv = 11_000
    assert board.answers(wire.ARM, 1, board.boot_id)[0][1][2] == wire.OK
    board.hal.battery_mv = 15_000
    board.hold(2)
    telemetry = board.heard(wire.TELEM)[-1]
    assert not telemetry[3] & wire.FLAG_BATTERY and telemetry[27] > 14_900, "nor is it told"


@pytest.mark.parametrize(("mv", "ends"), [(12_100, "none"), (11_900, "battery low")])
def test_a_battery_is_low_by_what_it_says_in_the_mean(mv, ends):
    board, dice = BareBoard(), random.Random(4)
    board.arm()
    for _ in range(600):
        board.hal.battery_mv = round(dice.gauss(mv, 150))
        board.hold(1)
    assert ladder(board)[1] == ends


def test_a_battery_that_has_just_been_plugged_in_is_believed_at_once():
    board = BareBoard()
    board.hal.battery_mv = 100  # on USB
    board.hold(100)
    assert board.control.battery_low
    board.hal.battery_mv = 15_000
    board.hold(1)
    assert not board.control.battery_low and board.control.battery_mv == 15_000
