"""The twin's gyros: what they say of a turn, how much of it is noise, and which robots have one."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import Navigation
from hw.firmware.wire import NO_RATE
from hw.twin.dive import Dive
from hw.twin.physics.tank import FULL_SCALE_CDEG_S, NOISE_DEG_S, WALK_DEG_S, ZERO_DEG_S, Gyros
from tests.hw.twin.stand_ins import RecordingBoard, fleet

ROBOTS = [f"r{i}" for i in range(400)]


def readings(gyros, rates, n):
    return np.array([gyros.read(np.asarray(rates, float)) for _ in range(n)]) / 100.0


def test_a_turn_is_told_with_the_errors_of_the_data_sheet() -> None:
    rates = np.zeros((len(ROBOTS), 3))
    still = readings(Gyros(3, ROBOTS, True), rates, 100)[20:]
    assert still.mean(axis=0).std() == pytest.approx(ZERO_DEG_S, rel=0.15)
    assert np.diff(still, axis=0).std() == pytest.approx(NOISE_DEG_S * math.sqrt(2), rel=0.05)
    rates[:, 2] = math.radians(90.0)
    turning = readings(Gyros(3, ROBOTS, True), rates, 100)[20:]
    errors = turning.mean(axis=0) - still.mean(axis=0) - 90.0
    assert errors.std() == pytest.approx(0.45, rel=0.15)  # 0.5 % of it


def test_its_zero_wanders_as_a_random_walk() -> None:
    told = readings(Gyros(3, ROBOTS, True), np.zeros((len(ROBOTS), 3)), 1000)
    moved = told[-100:].mean(axis=0) - told[:100].mean(axis=0)
    assert moved.std() == pytest.approx(math.hypot(WALK_DEG_S * math.sqrt(9.0), NOISE_DEG_S * math.sqrt(0.02)), rel=0.2)


def test_it_says_no_more_than_it_can_and_breaks_as_it_is_told() -> None:
    gyros = Gyros(3, ["r1", "r2"], True)
    assert readings(gyros, [[0, 0, 20.0], [0, 0, -20.0]], 30)[-1] == pytest.approx([250.13, -250.13])
    assert FULL_SCALE_CDEG_S == 25_013
    gyros.fail("r1", stuck=True)
    gyros.fail("r2", stuck=False)
    assert readings(gyros, np.zeros((2, 3)), 5)[-1] == pytest.approx([250.13, NO_RATE / 100])


@pytest.mark.parametrize("fitted", [False, True])
def test_the_boards_of_a_fleet_with_gyros_have_one_and_nothing_else_changes(fitted) -> None:
    asked = replace(fleet(), navigation=Navigation(gyro=fitted))
    one, other = (Dive(each, ["r1", "r2"], 0) for each in (asked, fleet()))
    for dive in (one, other):
        dive.boards = [RecordingBoard(), RecordingBoard()]
        dive.states["held"] = 0
        for _ in range(20):
            dive.tick(0.0)
    rates = [tick[-1] for tick in one.boards[0].ticks]
    assert (len(set(rates)) > 5) if fitted else set(rates) == {NO_RATE}
    assert [tick[:-1] for tick in one.boards[0].ticks] == [tick[:-1] for tick in other.boards[0].ticks]
