"""Depth, roll and pitch from four pressures, and which of them are believed."""

from __future__ import annotations

import importlib
import math
from typing import Any

import pytest

from hw.firmware import pressure, thrust, wire
from tests.hw.firmware.bare_board import firmware_main

firmware_main()
flash: Any = importlib.import_module("flash")
CYCLE_US = 10_000
AIR = [101_000_000, 101_200_000, 101_300_000, 101_100_000]  # mPa
MPA_PER_M = round(1000 * wire.PA_PER_M)


def degrees(angle_100nrad: int) -> float:
    return math.degrees(angle_100nrad * 1e-7)


def sensors(depth_m: float, roll_deg: float, pitch_deg: float) -> list[int]:
    """Absolute pressures at the four corners of a rigid plane, from a rotation matrix and not from the sine formula."""
    phi, theta = math.radians(roll_deg), math.radians(pitch_deg)
    up = (-math.sin(theta), math.cos(theta) * math.sin(phi), math.cos(theta) * math.cos(phi))
    corners = ((0.13, 0.13), (-0.13, 0.13), (-0.13, -0.13), (0.13, -0.13))
    depths = [depth_m - (x * up[0] + y * up[1]) for x, y in corners]
    return [air + round(MPA_PER_M * depth) for air, depth in zip(AIR, depths, strict=True)]


def watch(readings: list[int], seconds: float = 1.0, answered: int = 15, seen: Any = None) -> Any:
    if seen is None:
        seen = pressure.Plane(wire.PA_PER_M)
        seen.tare_mPa = AIR
    for i in range(round(seconds * 100)):
        seen.step([mPa + 3000 * (i & 1) for mPa in readings], answered, CYCLE_US)
    return seen


@pytest.mark.parametrize("roll", [-35, 0, 2, 20])
@pytest.mark.parametrize("pitch", [-30, 0, 3, 25])
def test_depth_roll_and_pitch(roll, pitch):
    seen = watch(sensors(0.4, roll, pitch))
    assert seen.bad == 0
    assert seen.depth_100nm == pytest.approx(4_000_000, abs=5000)
    assert degrees(seen.roll_100nrad) == pytest.approx(roll, abs=0.005)
    assert degrees(seen.pitch_100nrad) == pytest.approx(pitch, abs=0.005)
    assert abs(seen.parity_100nm) <= 20


@pytest.mark.parametrize("dead", range(4))
@pytest.mark.parametrize("reading", [0, 5_000_000, 200_000_000, 95_000_000])
def test_an_impossible_reading_is_replaced_from_the_other_three(dead, reading):
    seen = watch(sensors(0.4, 5, -3))
    readings = sensors(0.4, 5, -3)
    readings[dead] = reading
    watch(readings, seen=seen)
    assert seen.bad == 1 << dead
    assert degrees(seen.roll_100nrad) == pytest.approx(5, abs=0.01)
    assert degrees(seen.pitch_100nrad) == pytest.approx(-3, abs=0.01)
    watch(sensors(0.4, 5, -3), 0.9, seen=seen)
    assert seen.bad == 1 << dead, "not believed again at once"
    watch(sensors(0.4, 5, -3), 0.2, seen=seen)
    assert seen.bad == 0


def test_one_missed_answer_is_no_fault():
    seen = watch(sensors(0.4, 5, -3))
    watch(sensors(0.4, 5, -3), 0.04, answered=0b0111, seen=seen)
    assert seen.bad == 0
    watch(sensors(0.4, 5, -3), 0.02, answered=0b0111, seen=seen)
    assert seen.bad == 0b1000


def frozen(which: int, seconds: float, seen: Any, by_mPa: int = 0) -> int:
    """Let the sensors in this mask repeat themselves, or creep by so much in all. Those that are bad then."""
    for i in range(round(seconds * 100)):
        readings = sensors(0.4, 0, 0)
        for k in range(4):
            readings[k] += by_mPa * i // 100 if which >> k & 1 else 1000 * (i % 7)
        seen.step(readings, 15, CYCLE_US)
    return int(seen.bad)


@pytest.mark.parametrize("which", [0b0001, 0b0110, 0b0101, 0b1110])
@pytest.mark.parametrize("by_mPa", [0, 40])
def test_sensors_that_stand_still_while_another_moves_have_frozen(which, by_mPa):
    """By less than a step of the converter is still."""
    seen = watch(sensors(0.4, 0, 0))
    assert frozen(which, 0.3, seen, by_mPa) == 0
    assert frozen(which, 0.1, seen) == which and not seen.still
    assert frozen(0, 0.9, seen) == which, "not believed again at once"
    assert frozen(0, 0.3, seen) == 0


def test_where_all_stand_still_nobody_is_believed_soon():
    seen = watch(sensors(0.4, 0, 0))
    assert frozen(15, 0.5, seen) == 0 and not seen.still
    assert frozen(15, 0.2, seen) == 15 and seen.still
    assert frozen(15, 9.0, seen) == 15, "nor later"
    assert frozen(0b0011, 1.5, seen) == 0b0011, "but those that move again"


def test_one_that_has_frozen_stays_bad_when_the_others_freeze_too():
    seen = watch(sensors(0.4, 0, 0))
    assert frozen(0b0001, 2.0, seen) == 0b0001
    assert frozen(15, 0.5, seen) == 0b0001
    assert frozen(15, 0.2, seen) == 15 and seen.still


def test_a_dead_sensor_moves_nothing():
    """Its place holds what it said last, or noise of the bus."""
    seen, readings = watch(sensors(0.4, 0, 0)), sensors(0.4, 0, 0)
    for i in range(250):
        readings[3] += 1000 * (i & 1)
        seen.step(readings, 0b0111, CYCLE_US)
    assert seen.still


def test_a_shifted_sensor_is_noticed_but_not_named():
    readings = sensors(0.4, 0, 0)
    readings[2] += round(0.03 * MPA_PER_M)
    seen = watch(readings, 3.0)
    assert seen.disagree and seen.bad == 0


def test_sensors_that_drift_stay_a_plane_and_one_that_leaps_does_not():
    """One of four by 3 mm a minute: the rest of the error is in depth and tilt, where nothing shows it."""
    seen, readings = watch(sensors(0.4, 0, 0)), sensors(0.4, 0, 0)
    for second in range(240):
        readings[1] += round(MPA_PER_M * 0.003 / 60)
        watch(readings, seen=seen)
        assert abs(seen.parity_100nm) < 15_000, second
    depth_100nm, roll_100nrad = seen.depth_100nm, seen.roll_100nrad
    lost = list(readings)
    lost[1] = 0
    watch(lost, 2.0, seen=seen)  # the other three stand in for it, with what they have drifted
    assert seen.bad == 0b0010
    assert abs(seen.depth_100nm - depth_100nm) < 5_000 and abs(seen.roll_100nrad - roll_100nrad) < 40_000
    watch(readings, 3.0, seen=seen)
    readings[3] += round(MPA_PER_M * 0.008)
    watch(readings, 60.0, seen=seen)
    assert abs(seen.parity_100nm) > 75_000


def test_new_zeros_have_not_drifted():
    seen, readings = watch(sensors(0.4, 0, 0)), sensors(0.4, 0, 0)
    for _ in range(120):
        readings[1] += round(MPA_PER_M * 0.003 / 60)
        watch(readings, seen=seen)
    seen.set_tare([air + mPa - still for air, mPa, still in zip(AIR, readings, sensors(0.4, 0, 0), strict=True)])
    watch(readings, seen=seen)
    assert abs(seen.parity_100nm) < 1000


def test_one_spike_moves_nothing_a_shift_is_for_parity():
    seen = watch(sensors(0.4, 0, 0))
    for k in range(4):
        spiked = sensors(0.4, 0, 0)
        spiked[k] -= round(0.2 * MPA_PER_M)
        seen.step(spiked, 15, CYCLE_US)
        assert seen.depth_100nm == pytest.approx(4e6, abs=1e4) and seen.roll_100nrad == pytest.approx(0, abs=1e4)
        watch(sensors(0.4, 0, 0), 0.1, seen=seen)
    watch(spiked, 3.0, seen=seen)
    assert seen.disagree and seen.bad == 0


def test_water_that_comes_all_at_once_is_no_spike():
    seen = watch(sensors(0.4, 0, 0))
    seen.step(sensors(0.1, 0, 0), 15, CYCLE_US)
    assert seen.depth_100nm == pytest.approx(1e6, abs=1e4)


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "over"), [(50, 0, False), (45, 30, False), (50, 40, True), (0, -80, True)]
)
def test_what_lies_on_its_side_is_over_whichever_way_it_leans(roll_deg, pitch_deg, over):
    assert watch(sensors(0.6, roll_deg, pitch_deg)).over is over


def test_tare_refuses_waves_and_water():
    def zero(*rows: list[int]) -> Any:
        collector = flash.Tare()
        while not collector.step(rows[len(collector._rows[0]) % len(rows)]):
            pass
        return collector.result()

    assert zero(AIR) == AIR
    assert zero(AIR, [mPa + 250_000 for mPa in AIR]) is None
    assert zero([AIR[0] + 600_000, *AIR[1:]]) is None


def test_a_tare_is_four_pressures_that_there_are_in_air():
    assert flash.whole([101325.0, 101000, 101000.0004, 99999.9999]) == [
        101_325_000,
        101_000_000,
        101_000_000,
        100_000_000,
    ]
    for wrong in (None, 7, "air", [101325.0] * 3, [101325.0] * 3 + ["x"], [101325.0] * 3 + [float("nan")], [0.0] * 4):
        assert flash.whole(wrong) is None


def test_the_series_are_good_for_a_hundredth_of_a_degree():
    worst = max(abs(pressure._asin(x) * 1e-7 - math.asin(x * 1e-7)) for x in range(-9_990_000, 10_000_000, 9973))
    assert math.degrees(worst) < 0.005
    assert pressure._asin(12_000_000) == -pressure._asin(-12_000_000) == pytest.approx(math.pi / 2 * 1e7, abs=2)


def test_numbering_of_thrusters_is_that_of_sensors():
    """A corner that is too deep gets more lift: the paper's sign."""
    seen = watch(sensors(0.4, 5, 4))
    corner = [-(thrust.ROLL[j] * seen.roll_100nrad + thrust.PITCH[j] * seen.pitch_100nrad) for j in range(4)]
    deep = [seen.zeta_100nm[j] - seen.depth_100nm for j in range(4)]
    assert sorted(range(4), key=corner.__getitem__) == sorted(range(4), key=deep.__getitem__)
