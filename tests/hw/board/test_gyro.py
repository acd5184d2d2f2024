"""The gyro: what it says in units of the wire, and one that is not there, comes late or loses its power."""

import pytest

from hw.firmware import wire
from hw.firmware.gyro import Gyro
from tests.hw.board.fake_gyro import FakeGyro


@pytest.fixture
def fitted():
    """(gyro, what the firmware knows of it), settled."""
    chip = FakeGyro()
    gyro = Gyro(chip, chip.select)
    assert settled(gyro)
    return chip, gyro


def settled(gyro):
    """Whether it says nothing for a while, and then something."""
    silent = 0
    while gyro.rate_cdeg_s() == wire.NO_RATE:
        silent += 1
        assert silent < 10
    return silent >= 3


@pytest.mark.parametrize(("raw", "cdeg_s"), [(0, 0), (131, 100), (-13100, -10000), (32767, 25012), (-32767, -25013)])
def test_a_reading_in_hundredths_of_a_degree_a_second(fitted, raw, cdeg_s):
    chip, gyro = fitted
    chip.raw = raw
    assert gyro.rate_cdeg_s() == cdeg_s
    assert not chip.listens


def test_one_that_is_not_there_says_nothing_until_it_is(fitted):
    chip, gyro = fitted
    chip.raw, chip.there = 131, False
    assert {gyro.rate_cdeg_s() for _ in range(5)} == {wire.NO_RATE}
    chip.there = True
    chip.power_on()
    assert settled(gyro) and gyro.rate_cdeg_s() == 100


def test_one_that_lost_its_power_between_two_readings_is_told_anew(fitted):
    chip, gyro = fitted
    chip.raw = 131
    chip.power_on()
    assert settled(gyro) and gyro.rate_cdeg_s() == 100


def test_trouble_in_the_middle_of_a_reading_begins_anew(fitted):
    chip, gyro = fitted
    chip.raw, chip.write_readinto = 131, broken
    assert gyro.rate_cdeg_s() == wire.NO_RATE
    del chip.write_readinto
    chip.power_on()
    assert settled(gyro) and gyro.rate_cdeg_s() == 100


def broken(*_):
    raise OSError(5)
