"""A request number that is used again: an answer is to what was asked, never to what was asked before."""

from __future__ import annotations

import itertools
import math

import pytest

from hw.firmware import wire
from hw.firmware.parameters import TABLE
from hw.stm32.driver import IDS
from tests.hw.firmware.bare_board import BareBoard

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
