"""Outputs, kill switch and pulse frame: in which order the chip is told, and what a kill leaves."""

from __future__ import annotations

import sys

import pytest

from hw.firmware import pwm

IN, ALT, PULL_UP, PULL_DOWN = 0, 2, 1, 2
OUTPUTS = [*pwm.THRUSTERS, *pwm.SERVOS, pwm.LAMP]


def started(hal_stm32, frame_us=5000):
    hal = hal_stm32.Hal()
    hal.begin_pulses(frame_us)
    return hal


@pytest.mark.parametrize(("source_hz", "scale"), [(168_000_000, 167), (84_000_000, 83), (1_000_000, 0)])
def test_timers_count_microseconds(source_hz, scale):
    assert pwm.prescaler(source_hz) == scale
    assert source_hz / (scale + 1) == 1e6 and scale < 65536


@pytest.mark.parametrize("source_hz", [0, 1_500_000, 65_537_000_000])
def test_a_clock_that_makes_no_microseconds_is_told(source_hz):
    with pytest.raises(ValueError, match="timer clock"):
        pwm.prescaler(source_hz)


def test_twelve_outputs_and_a_lamp_share_no_pin_and_no_channel():
    pins = [pin for *_, names in [*OUTPUTS, *pwm.KILL] for pin in names.split()]
    channels = [(timer, first + i) for timer, first, names in OUTPUTS for i in range(len(names.split()))]
    assert len(set(pins)) == len(pins) == 15
    assert len(set(channels)) == len(channels) == 13


def test_the_kill_inputs_have_their_function_and_a_pull_up_before_break_is_armed(hal_stm32, chip):
    """Else they read low, the outputs are off, and nobody turns them on again."""
    started(hal_stm32)
    for timer, name in pwm.KILL:
        input_at = chip.log.index(("pin", name, ALT, PULL_UP, pwm.FUNCTION[timer], None))
        (armed_at,) = (i for i, entry in enumerate(chip.log) if entry[:2] == ("timer", timer))
        assert input_at < armed_at and chip.log[armed_at][3] == 1
        assert chip.timers[timer].on


def test_outputs_are_pulled_down_before_their_timers_start_and_stay_so(hal_stm32, chip):
    started(hal_stm32)
    for timer, _, names in OUTPUTS:
        for name in names.split():
            assert [entry for entry in chip.log if entry[:2] == ("pin", name)] == [
                ("pin", name, ALT, PULL_DOWN, pwm.FUNCTION[timer], None)
            ]
            pulled_at = chip.log.index(("pin", name, ALT, PULL_DOWN, pwm.FUNCTION[timer], None))
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
    assert not sys.modules.keys() & {"pwm", "wiring", "slots"}


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
