"""The board's hardware layer on a chip of calls: time, tether, watchdog, resets, and what each must never do."""

from __future__ import annotations

import sys

import pytest

from hw.firmware import wire, wiring
from tests.hw.board.chip import Reset
from tests.hw.board.wires import PASCAL


@pytest.fixture
def hal(hal_stm32):
    made = hal_stm32.Hal()
    made.begin_pulses(5000)
    return made


def run(hal, cycles: int) -> None:
    for _ in range(cycles):
        hal.wait_tick()
        hal.end_cycle()


def test_the_tick_is_a_timer_that_nobody_else_uses(hal, chip):
    """Timer 5 is the port's servo driver's, and its interrupt stands above the UART's."""
    assert chip.timers.keys() == {1, 8, 3, 4, 7} and chip.timers[7].frame == 10_000


def test_a_cycle_reads_its_sensors(hal, chip):
    chip.levels["PC4"] = 0
    run(hal, 60)
    assert hal.answered == 0b1111 and hal.pressure_mPa == pytest.approx([PASCAL * 1000] * 4, abs=1000)
    assert hal.temperature_cC == 2000
    assert hal.battery_mv == pytest.approx(1.4 * 11000, abs=10)
    assert hal.current_10ma == pytest.approx((0.5 - 0.33) * 3787.88, abs=4)
    assert hal.leak == 1
    chip.levels["PC4"], chip.volts["PC2"] = 1, 0.0
    run(hal, 2)
    assert hal.leak == 0 and hal.current_10ma == 0


def test_volts_and_amperes_in_whole_numbers(hal, chip):
    for reading in range(0, 4096, 15):
        chip.volts["PC1"] = chip.volts["PC2"] = volts = reading * 3.3 / 4095
        run(hal, 2)
        assert abs(hal.battery_mv - volts * 11000) <= 1
        assert abs(hal.current_10ma - max(0.0, (volts - 0.33) * 3787.88)) <= 1.1
    assert 4095 * 36300 < 2**30


def test_time_goes_by_ticks(hal):
    hal.wait_tick()
    first_us = hal.now_us()
    for i in range(1, 4):
        hal.wait_tick()
        assert (hal.dt_us, hal.ticks, hal.late) == (10_000, 1, 0)
        assert hal.now_us() - first_us == i * 10_000


def test_lost_ticks_are_counted(hal, chip):
    hal.wait_tick()
    before_us = hal.now_us()
    chip.pass_us(23_000)  # a cycle of 23 ms and more: two ticks come in it
    hal.wait_tick()
    assert (hal.dt_us, hal.ticks, hal.late) == (20_000, 2, 1)
    assert hal.now_us() - before_us == 20_000
    hal.wait_tick()
    assert (hal.dt_us, hal.ticks, hal.late) == (10_000, 1, 1)
    hal.late = 65535
    chip.pass_us(33_000)
    hal.wait_tick()
    assert (hal.ticks, hal.late) == (3, 1), "it is sent with 16 bits"


def test_a_cycle_s_length_counts_from_its_tick_with_the_bus_and_what_was_waited(hal, chip):
    run(hal, 60)
    hal.wait_tick()
    bus_us = hal.cycle_us()
    assert 1000 < bus_us < 1300
    chip.pass_us(5000)
    assert hal.cycle_us() == bus_us + 5000
    chip.pass_us(10_000 - hal.cycle_us() + 2500)  # over the next tick, by 2.5 ms
    assert hal.cycle_us() == 12_500
    hal.wait_tick()
    assert 2500 + 1000 < hal.cycle_us() < 2500 + 1300, "the cycle that began late is longer by that"


def test_the_clock_has_no_seam(hal, chip):
    """After 2**32 us, after 2**30 us of the port's clock (which the chip here passes first), after 2**30 ticks."""
    for fired, high in ((429_496, 0xFFFF), (2**30 - 3, 7)):
        hal.wait_tick()
        hal._fired = hal._taken = fired
        hal.us_high, hal.us_low = high, 60_000
        hal.wait_tick()
        last_us = hal.now_us()
        for _ in range(5):
            hal.wait_tick()
            now_us = hal.now_us()
            assert (now_us - last_us) & 0xFFFFFFFF == 10_000 and 0 <= now_us < 2**32 and 0 < hal.cycle_us() < 2000
            assert 0 <= hal.us_low < 2**16 and 0 <= hal.us_high < 2**16, "no number of telemetry takes memory"
            last_us = now_us
    assert hal.late == 0 and 0 <= hal._fired < 2**30


def test_the_interrupt_takes_no_memory(hal, chip):
    """All that it stores are numbers of 31 bits in places that are there."""
    places = set(vars(hal))
    chip.us = 2**31
    hal._fired = 2**30 - 1
    hal._on_tick(None)
    assert set(vars(hal)) == places and hal._fired == 0 and 0 <= hal._fired_at < 2**30


def test_reading_never_asks_for_more_than_is_there(hal, chip):
    """The fake UART fails where the driver would wait."""
    buf = bytearray(64)
    assert hal.read_into(buf) == 0
    chip.received[:] = b"12345"
    assert hal.read_into(buf) == 5 and buf[:5] == b"12345"
    chip.received[:] = bytes(100)
    assert hal.read_into(buf) == 64 and hal.read_into(buf) == 36 and hal.read_into(buf) == 0


def test_the_watchdog_begins_after_two_seconds_and_wants_sensors_where_motors_run(hal, chip):
    run(hal, 200)
    assert not [entry for entry in chip.log if entry[0] == "watchdog"]
    run(hal, 1)
    assert chip.log[-1] == ("watchdog", 500)
    run(hal, 10)
    assert chip.log.count(("fed",)) == 10
    chip.wires.dead = {0, 1, 2, 3}
    run(hal, 10)
    assert chip.log.count(("fed",)) == 20
    hal.armed = 1
    run(hal, 10)
    assert chip.log.count(("fed",)) == 20
    chip.wires.dead = {1, 2, 3}
    run(hal, 10)
    assert chip.log.count(("fed",)) == 29, "from the cycle on that brings what was begun before"


def test_saving_stretches_the_watchdog(hal, chip):
    hal.save_flash({"law": "pid"})
    assert not [entry for entry in chip.log if entry[0] == "watchdog"] and chip.files_synced == 1
    run(hal, 201)
    hal.save_flash({"law": "pi"})
    assert [entry for entry in chip.log if entry[0] == "watchdog"][1:] == [("watchdog", 8000), ("watchdog", 500)]
    assert hal.load_flash() == {"law": "pi"}


@pytest.mark.parametrize("cause", [0, 1, 3, 4])
def test_reset_causes_are_the_port_s(hal, chip, cause):
    chip.cause = cause
    assert hal.boot_info() == (bytes(12), 0xFFFFFFFC, cause)


def test_a_reset_by_order_is_told_from_one_by_the_pin(hal, chip):
    chip.cause = 2
    assert hal.boot_info()[2] == 2
    with pytest.raises(Reset):
        hal.reboot()
    assert hal.boot_info()[2] == wire.BY_ORDER
    assert hal.boot_info()[2] == 2, "the mark is for one boot"


def test_a_timeout_of_the_bus_is_two_of_the_driver_s_milliseconds(hal, chip):
    """It waits for its clock to have moved so often: with one, a tick in the midst of a sound transfer would end it."""
    assert [entry for entry in chip.log if entry[0] == "i2c"] == [("i2c", 2, 400_000, 2000)]


def test_a_stuck_bus_is_freed_by_nine_clocks_a_stop_and_the_multiplexer_s_reset(hal, chip):
    run(hal, 60)
    chip.wires.clinging = {2}
    run(hal, 1)
    assert hal.cycle_us() < 4000
    chip.wires.clinging = set()
    chip.log.clear()
    run(hal, 1)
    assert hal.cycle_us() < 2000
    done = [entry for entry in chip.log if entry[0] != "fed"]
    assert done[:3] == [("pin", pin, 17, None, None, value) for pin, value in (("PB10", 1), ("PB11", 1), ("PB12", 0))]
    assert done[-1] == ("i2c", 2, 400_000, 2000)
    levels = {"PB10": 1, "PB11": 1, "PB12": 0}
    clocks, stops = 0, 0
    for _, pin, level in done[3:-1]:
        before = dict(levels)
        levels[pin] = level
        clocks += pin == "PB10" and level and levels["PB11"]
        stops += pin == "PB11" and level > before["PB11"] and levels["PB10"]
    assert clocks == 9 and stops == 1 and levels == {"PB10": 1, "PB11": 1, "PB12": 1}
    run(hal, 3)
    assert hal.answered == 0b1111


# --- pins ---
# Outputs, kill switch and pulse frame: in which order the chip is told, and what a kill leaves.

IN, ALT, PULL_UP, PULL_DOWN = 0, 2, 1, 2
OUTPUTS = [*wiring.THRUSTERS, *wiring.SERVOS, wiring.LAMP]


def started(hal_stm32, frame_us=5000):
    hal = hal_stm32.Hal()
    hal.begin_pulses(frame_us)
    return hal


@pytest.mark.parametrize(("source_hz", "scale"), [(168_000_000, 167), (84_000_000, 83), (1_000_000, 0)])
def test_timers_count_microseconds(source_hz, scale):
    assert wiring.prescaler(source_hz) == scale
    assert source_hz / (scale + 1) == 1e6 and scale < 65536


@pytest.mark.parametrize("source_hz", [0, 1_500_000, 65_537_000_000])
def test_a_clock_that_makes_no_microseconds_is_told(source_hz):
    with pytest.raises(ValueError, match="timer clock"):
        wiring.prescaler(source_hz)


def test_twelve_outputs_and_a_lamp_share_no_pin_and_no_channel():
    pins = [pin for *_, names in [*OUTPUTS, *wiring.KILL] for pin in names.split()]
    channels = [(timer, first + i) for timer, first, names in OUTPUTS for i in range(len(names.split()))]
    assert len(set(pins)) == len(pins) == 15
    assert len(set(channels)) == len(channels) == 13


def test_the_kill_inputs_have_their_function_and_a_pull_up_before_break_is_armed(hal_stm32, chip):
    """Else an open loop reads as anything."""
    started(hal_stm32)
    for timer, name in wiring.KILL:
        input_at = chip.log.index(("pin", name, ALT, PULL_UP, wiring.FUNCTION[timer], None))
        (armed_at,) = (i for i, entry in enumerate(chip.log) if entry[:2] == ("timer", timer))
        assert input_at < armed_at and chip.log[armed_at][3] == 2  # high: an open loop
        assert chip.timers[timer].on


def test_outputs_are_pulled_down_before_their_timers_start_and_stay_so(hal_stm32, chip):
    started(hal_stm32)
    for timer, _, names in OUTPUTS:
        for name in names.split():
            assert [entry for entry in chip.log if entry[:2] == ("pin", name)] == [
                ("pin", name, ALT, PULL_DOWN, wiring.FUNCTION[timer], None)
            ]
            pulled_at = chip.log.index(("pin", name, ALT, PULL_DOWN, wiring.FUNCTION[timer], None))
            assert pulled_at < min(i for i, entry in enumerate(chip.log) if entry[:2] == ("timer", timer))


@pytest.mark.parametrize("frame_us", [2500, 5000, 20000])
def test_thrusters_get_the_frame_that_is_asked_for_and_servos_keep_theirs(hal_stm32, chip, frame_us):
    hal = hal_stm32.Hal()
    assert not chip.timers.keys() & {1, 8}, "no pulse before the frame is known"
    hal.begin_pulses(frame_us)
    assert [chip.timers[n].frame for n in (1, 8, 3, 4)] == [frame_us, frame_us, 20000, 20000]
    assert chip.timers[1].pulses == chip.timers[8].pulses == chip.timers[4].pulses == dict.fromkeys(range(1, 5), 1500)
    assert chip.timers[3].pulses == {3: 1100}


def test_what_is_needed_at_boot_alone_gives_its_memory_back(hal_stm32):
    hal = started(hal_stm32)
    hal.load_flash()
    assert not sys.modules.keys() & {"wiring", "slots"}


def test_pulses_that_are_asked_for_before_the_frame_is_known_are_shown_with_it(hal_stm32, chip):
    hal = hal_stm32.Hal()
    hal.pulses_us = [1600] * 8
    hal.write_pins()
    hal.begin_pulses(5000)
    assert set(chip.timers[1].pulses.values()) == {1500}
    hal.write_pins()
    assert set(chip.timers[1].pulses.values()) == {1600}


def test_another_frame_does_not_bring_back_what_was_killed(hal_stm32, chip):
    hal = started(hal_stm32)
    chip.timers[8].on = False  # by its break input
    chip.log.clear()
    hal.begin_pulses(2500)
    assert chip.log == [("period", 1, 2499), ("period", 8, 2499)]


def test_an_open_loop_a_broken_wire_and_a_spike_are_seen_and_last_until_the_thrusters_are_revived(hal_stm32, chip):
    hal = started(hal_stm32)
    assert not hal.killed()
    for pin, timer in (("PE15", 1), ("PA6", 8)):
        chip.levels[pin] = 1
        assert hal.killed() and not chip.timers[timer].on
        hal.revive()
        assert hal.killed() and not chip.timers[timer].on, "its loop is still open"
        chip.levels[pin] = 0
        assert hal.killed() and not chip.timers[timer].on, "nobody turns them on by closing a switch"
        hal.pulses_us = [1507] * 8
        hal.revive()
        hal.write_pins()
        assert not hal.killed() and set(chip.timers[timer].pulses.values()) == {1507}
        chip.log.clear()
        hal.revive()
        assert not chip.log, "what runs is left alone"
    chip.timers[1].on = False  # a spike that nobody saw
    assert hal.killed()


def test_a_board_that_boots_with_an_open_loop_gives_no_pulses(hal_stm32, chip):
    chip.levels["PA6"] = 1
    hal = started(hal_stm32)
    assert hal.killed() and not chip.timers[8].on and chip.timers[1].on


def test_only_what_changed_is_written(hal_stm32, chip):
    hal = started(hal_stm32)
    chip.log.clear()
    assert hal.write_pins() and not chip.log
    hal.pulses_us = [1500 + j for j in range(8)]
    hal.servos_us[2] = 1600
    hal.light_permille = 500
    hal.write_pins()
    assert chip.timers[3].pulses == {3: 1500}
    hal.light_permille = 1000
    hal.write_pins()
    assert chip.timers[1].pulses == {1: 1500, 2: 1501, 3: 1502, 4: 1503}
    assert chip.timers[8].pulses == {1: 1504, 2: 1505, 3: 1506, 4: 1507}
    assert chip.timers[4].pulses == {1: 1500, 2: 1500, 3: 1600, 4: 1500} and chip.timers[3].pulses == {3: 1900}
    chip.log.clear()
    hal.pulses_us[4] = 1400  # the list that it shows is another one than the one that it was given
    hal.write_pins()
    assert chip.timers[8].pulses[1] == 1400 and {entry[1] for entry in chip.log} <= {1, 8}
