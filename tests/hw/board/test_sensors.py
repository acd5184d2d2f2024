"""The pressure sensors: their arithmetic against the data sheet's, their schedule on a bus that can be broken."""

from __future__ import annotations

import json
import operator
import random
import subprocess
from array import array
from collections.abc import Callable
from fractions import Fraction
from math import floor
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hw.firmware import ms5837, wire
from hw.firmware.gyro import Gyro
from tests.hw.board.fake_gyro import FakeGyro
from tests.hw.board.wires import CELSIUS, D1, D2, PASCAL, TIMEOUT_US, WORDS, Wires, prom_of
from tests.hw.desk import MICROPYTHON

FIRMWARE = Path(ms5837.__file__).parent
CHECK = Path(__file__).with_name("check_sensors.py")
COST = Path(__file__).with_name("sensor_cost.py")

# Sensors as they come: the example's calibration and a third more or less of each number.
prom_words = st.tuples(st.just(0), *[st.integers(c * 2 // 3, min(65535, c * 4 // 3)) for c in WORDS[1:]])
LOWEST_MPA, HIGHEST_MPA = 30_000_000, 120_000_000  # what an MS5837-02BA can say


def in_water(words: tuple[int, ...], celsius: float) -> int:
    """The raw temperature that says so."""
    return round(words[5] * 256 + (celsius - 20) * 100 * 2**23 / words[6])


def by_the_data_sheet(words: tuple[int, ...], d1: int, d2: int) -> tuple[Fraction, Fraction]:
    """(hundredths of a degree, pressure in mPa) by the recipe of the data sheet, without any rounding but the one of
    the temperature to hundredths of a degree, from which the corrections below 20 C are taken."""
    _, c1, c2, c3, c4, c5, c6 = map(Fraction, words)
    dt = d2 - c5 * 256
    temp = Fraction(floor(2000 + dt * c6 / 2**23))
    off, sens = c2 * 2**17 + c4 * dt / 2**6, c1 * 2**16 + c3 * dt / 2**7
    cold = min(temp - 2000, 0)
    off -= 31 * cold**2 / 8
    sens -= 63 * cold**2 / 32
    if cold:
        temp -= 11 * dt**2 / 2**35
    return temp, (d1 * sens / 2**21 - off) / 2**15 * 1000


def by_the_board(words: tuple[int, ...], d1: int, d2: int) -> tuple[int, int]:
    scale, out = array("i", [0] * 12), [0] * 4
    celsius = ms5837.temperature(words, d2, scale, 6)
    assert ms5837.pressures(b"\xff" * 6 + d1.to_bytes(3, "big") + bytes(3), scale, 0b0100, out) == 0b0100
    return celsius, out[2]


def test_data_sheet_example():
    celsius, pressure_mPa = by_the_board(WORDS, D1, D2)
    assert celsius == CELSIUS * 100
    assert pressure_mPa == pytest.approx(PASCAL * 1000, abs=1000)


@given(prom_words, st.floats(-2, 45), st.integers(LOWEST_MPA, HIGHEST_MPA))
def test_whole_numbers_are_the_data_sheets_recipe(words, celsius, pressure_mPa):
    """2 mPa are 0.2 um of water; the sensor's own step is 1000."""
    d2 = in_water(words, celsius)
    step_mPa = by_the_data_sheet(words, 1, d2)[1] - by_the_data_sheet(words, 0, d2)[1]
    d1 = round((pressure_mPa - by_the_data_sheet(words, 0, d2)[1]) / step_mPa)
    if 0 < d1 < 2**24:
        exact = by_the_data_sheet(words, d1, d2)
        whole = by_the_board(words, d1, d2)
        assert abs(whole[1] - exact[1]) <= 2
        assert abs(whole[0] - exact[0]) <= 2


def checked(operation: Callable[[int, int], int]) -> Callable[[int, int], Word]:
    return lambda self, other: Word(operation(int(self), int(other)))


class Word(int):
    """A number of 31 bits with its sign, as the board holds one without taking memory for it."""

    def __new__(cls, value: int) -> Word:
        assert -(2**30) <= value < 2**30
        return super().__new__(cls, value)

    __add__ = __radd__ = checked(operator.add)
    __sub__, __rsub__ = checked(operator.sub), checked(lambda self, other: other - self)
    __mul__ = __rmul__ = checked(operator.mul)
    __lshift__, __rshift__ = checked(operator.lshift), checked(operator.rshift)
    __and__ = checked(operator.and_)


@given(prom_words, st.floats(-2, 45), st.integers(0, 2**24 - 1))
def test_no_number_on_the_way_takes_memory_on_the_board(words, celsius, d1):
    scale, out = [Word(0)] * 12, [0] * 4
    ms5837.temperature([Word(word) for word in words], Word(in_water(words, celsius)), scale, 0)
    raw = [Word(byte) for byte in d1.to_bytes(3, "big") + bytes(9)]
    ms5837.pressures(raw, scale, 1, out)
    assert min(scale) >= 0, "negative numbers would not come through a pointer"


def test_crc_of_the_application_note():
    """AN520 of the maker: these eight words, with the sum's place cleared, give 0xB."""
    note = bytes.fromhex("3132 3334 3536 3738 3940 4142 4344 4500")
    assert ms5837.check_sum(note[0], note) == 0xB


def test_any_flipped_bit_of_a_calibration_is_found():
    prom = prom_of(WORDS)
    assert ms5837.is_sound(prom)
    for i in range(14):
        for bit in range(8):
            assert not ms5837.is_sound(bytes(byte ^ (1 << bit if k == i else 0) for k, byte in enumerate(prom)))


class Board:
    """Four sensors, cycle by cycle."""

    def __init__(self, wires: Wires | None = None) -> None:
        self.wires = wires or Wires()
        self.sensors = ms5837.Sensors(self.wires, self.wires.free)
        self.mPa = [0] * 4
        self.longest_us = 0.0

    def step(self) -> int:
        before = self.wires.us
        answered = self.sensors.step(self.mPa)
        self.longest_us = max(self.longest_us, self.wires.us - before)
        return answered

    def steps(self, cycles: int) -> list[int]:
        return [self.step() for _ in range(cycles)]


def test_four_sensors_behind_a_multiplexer():
    board = Board()
    answers = board.steps(60)
    assert answers[-1] == 0b1111
    assert board.mPa == pytest.approx([PASCAL * 1000] * 4, abs=1000)
    assert board.sensors.temperature_cC == CELSIUS * 100
    board.wires.sensors[2].orders.clear()
    assert board.steps(100) == [0b1111] * 100, "no gap where a temperature is fetched"
    conversions = [order for order in board.wires.sensors[2].orders if order in (0x48, 0x58)]
    assert len(conversions) == 100 and conversions.count(0x58) == 5
    board.wires.sensors[2].d1 += 100
    board.steps(3)
    assert board.mPa[2] - board.mPa[1] == pytest.approx(4422, abs=2) and board.mPa[0] == board.mPa[1]


def test_booting_takes_half_a_second_and_no_cycle_waits():
    board = Board()
    answers = board.steps(50)
    assert 0b1111 in answers
    assert board.longest_us < 2000


def test_sensors_that_are_dead_damaged_or_unplugged_do_not_answer():
    wires = Wires()
    wires.dead = {1}
    wires.sensors[3].prom[4] ^= 1
    board = Board(wires)
    assert board.steps(60)[-1] == 0b0101
    wires.dead.add(0)
    assert board.step() == 0b0100
    wires.dead = {1}
    board.step()
    assert board.step() == 0b0101, "back as soon as it answers"
    wires.sensors[0].converted = 0
    assert board.step() == 0b0100, "a conversion that is not complete reads 0"


@pytest.mark.parametrize("repaired", ["plugged in", "PROM"])
def test_one_whose_calibration_could_not_be_read_is_asked_again(repaired):
    """One sensor a second, each cycle a transfer or two more than without."""
    wires = Wires()
    if repaired == "PROM":
        wires.sensors[2].prom[4] ^= 1
    else:
        wires.dead = {2}
    board = Board(wires)
    board.steps(300)
    asked = [i for i, order in enumerate(wires.sensors[2].orders) if order == 0x1E]
    wires.sensors[2].orders.clear()
    wires.transfers.clear()
    board.steps(1000)
    asked = wires.sensors[2].orders.count(0x1E)
    assert (8 <= asked <= 11) if repaired == "PROM" else not asked
    wires.dead.clear()
    wires.sensors[2].prom[:] = prom_of(WORDS)
    answers = board.steps(140)
    assert answers[-1] == 0b1111 and answers[0] == 0b1011
    assert board.longest_us < 2000


def test_a_bus_that_is_stuck_costs_a_timeout_in_a_cycle_and_is_freed_once_a_second():
    board = Board()
    board.steps(60)
    board.wires.shorted = True
    board.longest_us = 0.0
    assert board.steps(10) == [0] * 10
    assert board.longest_us <= TIMEOUT_US and board.wires.freed == 6, "each sensor may be it, and the one asked"
    board.wires.us, board.wires.freed = 0.0, 0
    assert board.steps(1000) == [0] * 1000
    assert board.wires.us <= 10 * TIMEOUT_US and 9 <= board.wires.freed <= 10
    board.wires.shorted = False
    assert 0b1111 in board.steps(150)


def test_a_moment_s_trouble_forgets_no_sensor():
    board = Board()
    board.steps(60)
    board.wires.shorted = True
    assert board.step() == 0
    board.wires.shorted = False
    assert board.steps(3) == [0, 0b1111, 0b1111]


def test_a_sensor_that_holds_the_line_costs_the_others_three_cycles_once():
    """Five in a row would make bad sensors of them. It is asked again each second, and the others do not notice."""
    board = Board()
    board.steps(60)
    board.wires.clinging = {1}
    board.longest_us = 0.0
    answers = board.steps(1000)
    assert answers[:3] == [0b0001] * 3 and answers[3:] == [0b1101] * 997
    assert board.longest_us <= 3000
    board.wires.clinging = set()
    assert 0b1111 in board.steps(150)


@pytest.mark.parametrize("cycle", range(20))
def test_what_one_missed_is_not_taken_for_something_else(cycle):
    """A pressure that is fetched where a temperature was ordered would be believed."""
    board = Board()
    board.steps(60 + cycle)
    board.wires.dead = {0}
    board.step()
    board.wires.dead = set()
    for _ in range(25):
        board.step()
        assert board.sensors.temperature_cC == CELSIUS * 100
        assert board.mPa == pytest.approx([PASCAL * 1000] * 4, abs=1000)


@pytest.mark.skipif(MICROPYTHON is None, reason="the MicroPython Unix port is not installed")
def test_machine_code_says_what_python_says():
    """Its own machine words there, whole numbers without bounds here."""
    rng = random.Random(7)
    rows = []
    for _ in range(500):
        words = (0, *[rng.randint(c * 2 // 3, min(65535, c * 4 // 3)) for c in WORDS[1:]])
        rows.append((words, in_water(words, rng.uniform(-2, 45)), rng.choice((0, 1, 2**24 - 1, rng.randrange(2**24)))))
    text = "".join(json.dumps(row) + "\n" for row in rows)
    ran = subprocess.run([MICROPYTHON, CHECK, FIRMWARE], input=text, capture_output=True, text=True, timeout=60)
    theirs = [tuple(map(int, line.split())) for line in ran.stdout.splitlines()]
    mPa, ours = 0, []
    for words, d2, d1 in rows:
        check = prom_of(words)[0] >> 4
        if d1:
            celsius, mPa = by_the_board(words, d1, d2)
        else:
            celsius = ms5837.temperature(words, d2, array("i", [0] * 12), 0)
        ours.append((check, celsius, mPa, 2 if d1 else 0))
    assert theirs == ours, ran.stderr


@pytest.mark.skipif(MICROPYTHON is None, reason="the MicroPython Unix port is not installed")
def test_a_cycle_takes_no_memory():
    ran = subprocess.run([MICROPYTHON, COST, FIRMWARE], capture_output=True, text=True, timeout=60)
    assert ran.stdout == "0\n", ran.stderr


# --- gyro ---
# The gyro: what it says in units of the wire, and one that is not there, comes late or loses its power.


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


@pytest.mark.parametrize(
    ("pull_g", "gravity_mg"), [((0, 0, 1), (1000, 0)), ((0.3, -0.4, -0.8), (-800, 500)), ((3.9, 0, 0), (0, 3900))]
)
def test_where_up_is(fitted, pull_g, gravity_mg):
    chip, gyro = fitted
    chip.pull_g = pull_g
    assert gyro.gravity_mg() == pytest.approx(gravity_mg, abs=2)
    chip.there = False
    assert gyro.gravity_mg() is None and gyro.rate_cdeg_s() == wire.NO_RATE


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
