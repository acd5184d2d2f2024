"""Orders to the firmware through its pty: parameters, modes, tare, reboot; each executed once."""

from __future__ import annotations

import itertools
import json
import math
import struct
import zlib

import numpy as np
import pytest

from hw.firmware import failsafe, parameters, thrust, wire
from hw.firmware.parameters import TABLE
from hw.stm32.driver import IDS
from tests.hw.firmware.bare_board import BareBoard, BareHal
from tests.hw.firmware.nominal_plant import AIR_PA

NEUTRAL = (1500,) * 8


@pytest.fixture
def desk(put_on_desk, interpreter):
    return put_on_desk(interpreter)


def value_of(desk, kind: int, boot_id: int, name: str, *more: float) -> tuple[float, int]:
    """Value and flags that come back from a PARAM_GET or PARAM_SET."""
    desk.req_id += 1
    desk.say(kind, desk.req_id, boot_id, IDS[name], *more)
    rows = desk.until(lambda: [row for row in desk.heard(wire.PARAM_VALUE) if row[0] == desk.req_id])
    assert rows[0][1:4] == (boot_id, IDS[name], TABLE[IDS[name]][4])
    return rows[0][5], rows[0][4]


def refused(desk) -> set[str]:
    mask = desk.until(lambda: desk.events(wire.EV_ARM_REFUSED))[-1][5]
    return {check for i, check in enumerate(wire.ARM_CHECKS) if mask >> i & 1}


def test_parameters_get_set_list_save(desk):
    boot_id = desk.greet()
    assert value_of(desk, wire.PARAM_GET, boot_id, "net_weight_N") == (0.0, 0)
    assert value_of(desk, wire.PARAM_SET, boot_id, "net_weight_N", 0, 0, 1.25) == (1.25, wire.UNSAVED)
    desk.tick(2)
    assert desk.heard(wire.TELEM)[-1][-3] == 1, "dirty"
    desk.req_id += 1
    desk.forget()
    desk.say(wire.PARAM_LIST, desk.req_id, boot_id)
    rows = desk.until(lambda: len(rows := desk.heard(wire.PARAM_VALUE)) == len(TABLE) and rows)
    assert [row[2] for row in rows] == list(range(len(TABLE)))
    values = [row[5] for row in rows]
    assert values[IDS["net_weight_N"]] == 1.25 and values[IDS["law"]] == 2
    desk.greet()
    ack = desk.heard(wire.HELLO_ACK)[-1]
    assert ack[7] == zlib.crc32(struct.pack(f"<{len(values)}f", *values)) and ack[8] == len(TABLE)
    assert desk.order(wire.PARAM_SAVE, boot_id) == wire.OK
    desk.forget()
    desk.tick(2)
    assert desk.heard(wire.TELEM)[-1][-3] == 0
    burnt = json.loads(desk.flash_path.read_text())
    assert burnt["net_weight_N"] == 1.25 and burnt["law"] == "observer" and burnt["tare_pa"] == [AIR_PA] * 4
    desk.power_off()
    desk.power_on()
    assert value_of(desk, wire.PARAM_GET, desk.greet(), "net_weight_N") == (1.25, 0)


@pytest.mark.parametrize("value", [math.nan, math.inf, -31.0, 1e30])
def test_a_value_out_of_range_changes_nothing(desk, value):
    boot_id = desk.greet()
    assert desk.order(wire.PARAM_SET, boot_id, IDS["net_weight_N"], 0, 0, value) == wire.RANGE
    assert value_of(desk, wire.PARAM_GET, boot_id, "net_weight_N") == (0.0, 0)


def test_what_cannot_be_ordered_is_out_of_range(desk):
    boot_id = desk.greet()
    assert desk.order(wire.PARAM_GET, boot_id, len(TABLE)) == wire.RANGE
    assert desk.order(wire.PARAM_SET, boot_id, IDS["law"], 1, 0, 1.5) == wire.RANGE, "not a whole number"
    assert desk.order(wire.MODE, boot_id, 9, 0) == wire.RANGE
    assert desk.order(wire.MODE, boot_id, wire.BENCH, 9) == wire.RANGE
    assert desk.order(wire.REBOOT, boot_id, 12345) == wire.RANGE


def test_armed_nothing_is_set_saved_tared_or_rebooted(desk):
    boot_id = desk.arm()
    for kind, more in (
        (wire.PARAM_SET, (IDS["law"], 1, 0, 1.0)),
        (wire.PARAM_SAVE, ()),
        (wire.TARE, (0,)),
        (wire.REBOOT, (wire.REBOOT_MAGIC,)),
    ):
        assert desk.order(kind, boot_id, *more) == wire.REFUSED
    assert desk.tick()[-1] == wire.ARMED


def test_orders_for_another_boot_are_stale_but_for_stops(desk):
    boot_id = desk.arm()
    for kind, more in ((wire.MODE, (wire.SURFACE, 0)), (wire.PARAM_LIST, ()), (wire.ARM, ())):
        assert desk.order(kind, boot_id ^ 1, *more) == wire.STALE_BOOT
    assert desk.tick()[-1] == wire.ARMED
    assert desk.order(wire.DISARM, boot_id ^ 1) == wire.OK
    assert desk.tick()[-1] == wire.DISARMED


def test_neutral_pulses_and_the_law_are_parameters(put_on_desk, interpreter):
    flash = {"tare_pa": [AIR_PA] * 4, "wiring": failsafe.WIRING, "law": "pid", "zero_2_us": 1510, "net_weight_N": 2.0}
    desk = put_on_desk(interpreter, flash)
    boot_id = desk.arm()
    assert value_of(desk, wire.PARAM_GET, boot_id, "law")[0] == 1
    act = desk.tick()
    lift = [us - (1510 if j == 1 else 1500) for j, us in enumerate(act[1:5])]
    assert min(lift) > 30 and max(lift) - min(lift) <= 1, "half a newton each, carried from the first cycle"
    assert desk.order(wire.DISARM, boot_id) == wire.OK
    assert desk.tick()[1:9] == (1500, 1510, *(1500,) * 6)


def test_mode_bench_turns_one_thruster_slowly_and_stops_with_the_host(desk):
    boot_id = desk.greet()
    assert desk.order(wire.MODE, boot_id, wire.BENCH, 6) == wire.OK
    desk.tick(310)
    desk.set_point()
    assert desk.order(wire.ARM, boot_id) == wire.OK
    desk.set_point()
    assert desk.tick()[1:9] == (1500, 1500, 1500, 1500, 1500, 1560, 1500, 1500)
    assert desk.heard(wire.TELEM)[-1][3] >> wire.MODE_SHIFT == wire.BENCH
    assert desk.order(wire.MODE, boot_id, wire.HOLD, 0) == wire.REFUSED, "it lies on a table"
    desk.set_point()
    assert desk.order(wire.MODE, boot_id, wire.BENCH, 1) == wire.OK
    assert desk.tick()[1] == 1560
    assert desk.tick(55)[-1] == wire.DISARMED, "half a second of silence"
    assert desk.tick()[1:9] == NEUTRAL


def lift(pulses_us):
    """Of T1-T4 by the board's own curve, of the full thrust of one."""
    off_us = np.array(pulses_us) - thrust.NEUTRAL_US
    forces = np.interp(np.abs(off_us), thrust.CURVE_US, thrust.CURVE) / thrust.CURVE[-1]
    return np.where(off_us > 0, forces, -0.8 * forces).sum()


def test_mode_stabilise_leaves_depth_alone_until_the_host_is_silent(desk):
    boot_id = desk.greet()
    assert desk.order(wire.MODE, boot_id, wire.STABILISE, 0) == wire.OK
    desk.tick(310)
    desk.set_point()
    assert desk.order(wire.ARM, boot_id) == wire.OK
    desk.set_point(depth_m=0.6)
    act = desk.tick(20)
    assert abs(lift(act[1:5])) < 0.002, "30 cm off, and no lift: nudges come to nothing"
    desk.tick(60)
    assert desk.heard(wire.TELEM)[-1][3] >> wire.MODE_SHIFT == wire.HOLD
    assert desk.tick()[-1] == wire.ARMED


def test_mode_surface_goes_up_until_armed_again(desk):
    boot_id = desk.greet()
    assert desk.order(wire.MODE, boot_id, wire.SURFACE, 0) == wire.REFUSED, "not armed"
    boot_id = desk.arm()
    assert desk.order(wire.MODE, boot_id, wire.SURFACE, 0) == wire.OK
    for _ in range(10):
        desk.set_point()
        act = desk.tick(20)
    assert min(act[1:5]) > 1550, "upwards, though the host asks for the depth that there is"
    assert desk.heard(wire.TELEM)[-1][2] == failsafe.SURFACE
    assert any(event[5] == wire.REASONS.index("order") for event in desk.events(wire.EV_LADDER))
    desk.set_point()
    assert desk.order(wire.ARM, boot_id) == wire.OK
    desk.tick(2)
    assert desk.heard(wire.TELEM)[-1][2] == failsafe.OK


def test_reboot_by_order_is_a_new_boot_and_ends_a_latched_fault(desk):
    boot_id = desk.greet()
    assert desk.order(wire.ESTOP, boot_id) == wire.OK
    assert desk.order(wire.REBOOT, boot_id, wire.REBOOT_MAGIC) == wire.OK
    again = desk.greet()
    assert again != boot_id
    assert desk.heard(wire.HELLO_ACK)[-1][5] == wire.BY_ORDER
    assert desk.order(wire.TARE, boot_id, 0) == wire.STALE_BOOT
    desk.arm()
    assert desk.tick()[-1] == wire.ARMED


def test_after_the_watchdog_only_a_reboot_helps(put_on_desk, interpreter, monkeypatch):
    monkeypatch.setenv("AUCAMP_RESET_CAUSE", str(wire.BY_WATCHDOG))
    desk = put_on_desk(interpreter)
    boot_id = desk.greet()
    desk.tick(310)
    desk.set_point()
    assert desk.order(wire.ARM, boot_id) == wire.REFUSED
    assert refused(desk) == {"fault latched"}
    assert desk.order(wire.REBOOT, boot_id, wire.REBOOT_MAGIC) == wire.OK
    desk.arm()


def test_a_tare_is_begun_once_and_answered_at_its_end(desk):
    desk.pressure_pa = [AIR_PA + 10.0] * 4
    boot_id = desk.greet()
    desk.say(wire.TARE, 900, boot_id, 0)
    desk.tick(20)
    desk.say(wire.TARE, 900, boot_id, 0)
    desk.say(wire.TARE, 901, boot_id, 0)
    desk.tick(20)
    desk.say(wire.ARM, 902, boot_id)
    acks = desk.until(lambda: len(acks := desk.heard(wire.ACK)) == 5 and acks, 300)
    assert [(ack[0], ack[2]) for ack in acks] == [
        (900, wire.RUNNING),
        (900, wire.RUNNING),
        (901, wire.BUSY),
        (902, wire.BUSY),
        (900, wire.OK),
    ]


@pytest.mark.parametrize(
    "wrong", [[AIR_PA + 600.0, AIR_PA, AIR_PA, AIR_PA], [AIR_PA + 20_000.0] * 4], ids=["disagree", "under water"]
)
def test_a_wrong_tare_is_refused_and_the_old_one_stands(desk, wrong):
    desk.pressure_pa = wrong
    boot_id = desk.greet()
    assert desk.order(wire.TARE, boot_id, 0) == wire.REFUSED
    assert json.loads(desk.flash_path.read_text())["tare_pa"] == [AIR_PA] * 4


@pytest.mark.parametrize(
    ("hours", "checks"),
    [
        (11.9, set()),
        (12.1, {"tare older than 12 h"}),
        (49.71 * 24, {"tare older than 12 h"}),  # where milliseconds of 32 bits begin again
        (50.1 * 24, {"tare older than 12 h"}),
        (-1 / 36e3, set()),  # a clock that is a tenth of a second behind the one that was told with the tare
        (-9.9 / 60, set()),
        (-10.1 / 60, {"tare older than 12 h"}),  # whose clock that is nobody knows
    ],
)
def test_a_tare_lasts_twelve_hours(put_on_desk, interpreter, hours, checks):
    """The desk tells its clock in each set-point; flash was written hours before, on the far side of 2**32."""
    made_ds = round(50 - hours * 36e3) & 0xFFFFFFFF
    desk = put_on_desk(interpreter, {"tare_pa": [AIR_PA] * 4, "wiring": failsafe.WIRING, "tare_host_ds": made_ds})
    boot_id = desk.greet()
    desk.tick(310)
    desk.set_point()
    assert desk.order(wire.ARM, boot_id) == (wire.REFUSED if checks else wire.OK)
    if checks:
        assert refused(desk) == checks


@pytest.mark.parametrize(("made", "version", "old"), [("ms", 1, False), ("ms", 3, True), ("ds", 1, True)])
def test_a_tare_that_was_timed_in_another_unit_is_old(made, version, old):
    """Nobody can tell its age: a host of an older release made it, or asks."""
    board = BareBoard(BareHal({"tare_pa": [AIR_PA] * 4, "wiring": failsafe.WIRING, f"tare_host_{made}": 7}))
    board.say(wire.HELLO, version, wire.SCHEMA_CRC[version], 1)
    board.hold(320)
    ((_, fields),) = board.answers(wire.ARM, 1, board.boot_id)
    assert fields[2] == (wire.REFUSED if old else wire.OK)
    board.tick(2)
    refusals = {event[5] for event in board.heard(wire.EVENT) if event[1] == wire.EV_ARM_REFUSED}
    assert refusals == ({1 << wire.ARM_CHECKS.index("tare older than 12 h")} if old else set())


@pytest.mark.parametrize(("hours", "old"), [(11.9, False), (12.1, True), (72.0, True)])
def test_a_tare_of_this_boot_ages_too(hours, old):
    board = BareBoard(BareHal({"wiring": failsafe.WIRING}))
    board.hal.pressure_pa = [AIR_PA] * 4
    board.greet()
    board.hold(10)
    board.say(wire.TARE, 1, board.boot_id, 0)
    board.hold(320)
    assert board.control.plane.tare_mPa is not None
    later_ds = 7 + round(hours * 36e3)
    board.hold(10, later_ds)
    ((_, fields),) = board.answers(wire.ARM, 2, board.boot_id)
    assert fields[2] == (wire.REFUSED if old else wire.OK)


def test_a_tare_carries_its_time(desk):
    desk.pressure_pa = [AIR_PA + 0.3 * wire.PA_PER_M] * 4
    boot_id = desk.greet()
    desk.set_point()
    told_ds = desk.now_us // 100_000
    assert desk.order(wire.TARE, boot_id, 300) == wire.OK
    burnt = json.loads(desk.flash_path.read_text())
    assert burnt["tare_pa"] == pytest.approx([AIR_PA] * 4, abs=3.0), "30 cm of fresh water"
    assert abs(burnt["tare_host_ds"] - told_ds) <= 1
    desk.arm()


def test_table_of_parameters_is_sound():
    assert len(set(parameters.NAMES)) == len(TABLE)
    for i, (_, default, lowest, highest, _) in enumerate(TABLE):
        assert lowest <= default <= highest and parameters.in_range(i, default)
    with pytest.raises(ValueError, match="law = pip; write pi pid observer"):
        parameters.from_flash({"law": "pip"})
    with pytest.raises(ValueError, match="lag_s = 9"):
        parameters.from_flash({"lag_s": 9})


# --- reused numbers ---
# A request number that is used again: an answer is to what was asked, never to what was asked before.

ORDERS = [
    (wire.ARM,),
    (wire.DISARM,),
    (wire.ESTOP,),
    *((wire.MODE, mode, thruster) for mode in (wire.HOLD, wire.STABILISE, wire.SURFACE, wire.BENCH, 255)
      for thruster in (0, 3)),
    *((wire.PARAM_GET, i) for i in (0, 2, len(TABLE), 999)),
    *((wire.PARAM_SET, i, 0, 0, value) for i in (0, IDS["heave_kg"], 65535)
      for value in (1.0, 2.5, math.nan, -math.inf)),
    (wire.PARAM_LIST,),
    (wire.PARAM_SAVE,),
    *((wire.TARE, depth_mm) for depth_mm in (0, 300, -32768, 32767)),
    *((wire.REBOOT, magic) for magic in (0, wire.REBOOT_MAGIC)),
]  # fmt: skip


def ask(board: BareBoard, number: int, order: tuple[float, ...]) -> str:
    """What is answered at once, without the number; as text, where one NaN is like another."""
    return str([(kind, fields[1:]) for kind, fields in board.answers(int(order[0]), number, board.boot_id, *order[1:])])


def board_that_greets(armed: bool) -> BareBoard:
    board = BareBoard()
    board.greet()
    if armed:
        board.set_point()
        board.control.arm()  # the checks take three seconds, and there are thousands of pairs
    return board


@pytest.mark.parametrize("armed", [False, True], ids=["disarmed", "armed"])
def test_every_pair_of_orders_under_one_number_is_answered_as_under_two(armed):
    for first, second in itertools.permutations(ORDERS, 2):
        answers = []
        for number in (5, 6):
            board = board_that_greets(armed)
            ask(board, 5, first)
            answers.append(ask(board, number, second))
            assert board.faults == 0, (first, second)
        assert answers[0] == answers[1], (first, second)


def test_a_repeat_is_answered_from_memory_and_not_done_twice():
    board = board_that_greets(armed=False)
    order = (wire.PARAM_SET, IDS["heave_kg"], 0, 0, 9.0)
    first = ask(board, 5, order)
    law = board.control.law
    assert ask(board, 5, order) == first and board.control.law is law


@pytest.mark.parametrize("kind", [wire.DISARM, wire.ESTOP])
def test_a_stop_is_done_each_time_that_it_is_said(kind):
    board = board_that_greets(armed=True)
    for _ in range(2):
        board.control.arm()
        ask(board, 5, (kind,))
        assert board.control.state == wire.DISARMED


def test_a_tare_that_leaves_no_air_above_the_water_is_refused_and_the_old_one_stands():
    board = board_that_greets(armed=False)
    before = list(board.control.plane.tare_mPa)
    ask(board, 5, (wire.TARE, 32767))  # 3.3 bar of water over sensors at one bar
    board.tick(201)
    assert board.heard(wire.ACK)[-1][2] == wire.REFUSED
    assert board.control.plane.tare_mPa == before and board.hal.flash["tare_pa"] == [mPa / 1000 for mPa in before]
