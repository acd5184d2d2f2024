"""The conversation with the control module, without any port: who is believed, what is repeated, how orders end."""

from __future__ import annotations

from agent.core.step_io import SetPoint
from hw.firmware import parameters, wire
from hw.stm32.protocol import CURABLE, NO_ANSWER, NO_BOARD, OVERTAKEN, HostProtocol, event_line
from tests.hw.stm32.fake_board import FakeBoard, kinds

MS = 1_000_000


def test_commands_are_repeated_then_given_up_then_asked_anew():
    protocol = HostProtocol(1)
    FakeBoard(protocol).greet()
    protocol.arm()
    sent = [(ms, protocol.due(ms * 1_000_000)) for ms in range(0, 2000, 10)]
    times = [ms for ms, out in sent if out]
    assert times[:4] == [0, 100, 200, 300]
    assert times[4] == 900
    assert len({out[1:-1] for ms, out in sent[:31] if out}) == 4, "numbered frames"


def test_nothing_is_believed_before_the_greeting():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.telemetry()
    assert not protocol.telemetry
    board.greet()
    board.telemetry()
    assert len(protocol.telemetry) == 1


def test_another_schema_is_no_greeting():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet(schema=1)
    board.telemetry()
    assert not protocol.telemetry
    assert protocol.lines[-1].level == "error" and "flash" in protocol.lines[-1].text
    protocol.arm()
    assert wire.ARM not in kinds(protocol.due(10**9))


def test_lost_frames_and_late_readers_are_counted():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    board.writer.seq += 3
    for _ in range(300):
        board.telemetry()
    assert protocol.counters.lost == 3
    assert protocol.counters.dropped == 300 - len(protocol.telemetry) > 0


def test_set_point_is_clipped_not_wrapped():
    protocol = HostProtocol(1)
    frame = protocol.set_point(
        SetPoint(depth_m=99.0, force_n=(-99.0, 0.0), servos_us=(-5, 70000, 1500, 1500), light=7.0), 0
    )
    got = []
    wire.Framer(lambda kind, _seq, payload: got.append(wire.unpack(kind, payload))).feed(frame, len(frame))
    assert got[0][0] == 32767 and got[0][3] == -32768
    assert got[0][6:11] == (0, 65535, 1500, 1500, 1000)


def test_a_failsafe_that_is_over_is_said_to_be():
    assert event_line(wire.EV_LADDER, 0, 1, 1, 0).text.startswith("board: failsafe level 0 -> 1: ")
    assert event_line(wire.EV_LADDER, 1, 0, 0, 0) == ("info", "board: failsafe over, it was level 1")


def test_curable_reasons_exist():
    assert set(wire.ARM_CHECKS) >= CURABLE


# --- orders -------------------------------------------------------------------------------------------------------


def test_without_a_board_an_order_ends_at_once():
    assert HostProtocol(1).ask(wire.PARAM_LIST).result(0).result == NO_BOARD


def test_an_order_is_repeated_three_times():
    protocol = HostProtocol(1)
    FakeBoard(protocol).greet()
    future = protocol.ask(wire.PARAM_SAVE)
    times = [ms for ms in range(0, 1000, 10) if protocol.due(ms * MS)]
    assert times == [0, 100, 200, 300]
    assert future.result(0).result == NO_ANSWER
    assert protocol.is_answered()


def test_a_board_at_work_is_asked_twice_a_second():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    future = protocol.ask(wire.TARE, 0)
    times = []
    for ms in range(0, 3000, 10):
        if protocol.due(ms * MS):
            times.append(ms)
            board.say_at(ms * MS + 1, wire.ACK, 1, wire.TARE, wire.OK if ms >= 2000 else wire.RUNNING, board.boot_id)
    assert times == [0, 510, 1020, 1530, 2040]
    assert future.result(0).ok


def test_a_stop_overtakes_and_ends_the_others():
    protocol = HostProtocol(1)
    FakeBoard(protocol).greet()
    first, second = protocol.ask(wire.TARE, 0), protocol.ask(wire.PARAM_SAVE)
    protocol.due(0)
    protocol.stop(wire.ESTOP)
    assert first.result(0).result == second.result(0).result == OVERTAKEN
    assert protocol.due(1) and not protocol.is_answered()


def test_a_list_of_which_a_part_was_lost_is_asked_for_again():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    future = protocol.ask(wire.PARAM_LIST)
    for ms, lost in ((0, {2, 3}), (500, {0, 7})):
        assert not protocol.due((ms - 1) * MS) and protocol.due(ms * MS)
        for i in set(range(len(parameters.TABLE))) - lost:
            board.say(wire.PARAM_VALUE, 1, board.boot_id, i, parameters.TABLE[i][4], 0, parameters.TABLE[i][1])
    assert len(future.result(0).values) == len(parameters.TABLE)


def test_a_reboot_whose_answer_was_lost_has_happened():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    future = protocol.ask(wire.REBOOT, wire.REBOOT_MAGIC)
    protocol.due(0)
    board.say(wire.ACK, 1, wire.REBOOT, wire.STALE_BOOT, board.boot_id + 1)
    assert future.result(0).ok


def test_a_cancelled_order_disturbs_nobody():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    future = protocol.ask(wire.PARAM_SAVE)
    protocol.due(0)
    assert future.cancel()
    board.say(wire.ACK, 1, wire.PARAM_SAVE, wire.OK, board.boot_id)
    assert protocol.is_answered()
