"""Depth, roll and pitch from four pressures, and which of them are believed."""

from __future__ import annotations

import math
from typing import Any

import pytest

from hw.firmware import pressure, thrust, wire

CYCLE_US = 10_000
AIR = [101000.0, 101200.0, 101300.0, 101100.0]


def sensors(depth_m: float, roll_deg: float, pitch_deg: float) -> list[float]:
    """Absolute pressures at the four corners of a rigid plane, from a rotation matrix and not from the sine formula."""
    phi, theta = math.radians(roll_deg), math.radians(pitch_deg)
    up = (-math.sin(theta), math.cos(theta) * math.sin(phi), math.cos(theta) * math.cos(phi))
    corners = ((0.13, 0.13), (-0.13, 0.13), (-0.13, -0.13), (0.13, -0.13))
    depths = [depth_m - (x * up[0] + y * up[1]) for x, y in corners]
    return [air + wire.PA_PER_M * depth for air, depth in zip(AIR, depths, strict=True)]


def watch(readings: list[float], seconds: float = 1.0, answered: int = 15, seen: Any = None) -> Any:
    if seen is None:
        seen = pressure.Plane(wire.PA_PER_M, 0.13, 0.13)
        seen.tare_pa = AIR
    for i in range(round(seconds * 100)):
        seen.step([pa + 3.0 * (i & 1) for pa in readings], answered, CYCLE_US)
    return seen


@pytest.mark.parametrize("roll", [-35, 0, 2, 20])
@pytest.mark.parametrize("pitch", [-30, 0, 3, 25])
def test_depth_roll_and_pitch(roll, pitch):
    seen = watch(sensors(0.4, roll, pitch))
    assert seen.bad == 0
    assert seen.depth_m == pytest.approx(0.4, abs=0.0005)
    assert math.degrees(seen.roll_rad) == pytest.approx(roll, abs=1e-6)
    assert math.degrees(seen.pitch_rad) == pytest.approx(pitch, abs=1e-6)
    assert seen.parity_m == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("dead", range(4))
@pytest.mark.parametrize("reading", [float("nan"), 5000.0, 200000.0, 95000.0])
def test_an_impossible_reading_is_replaced_from_the_other_three(dead, reading):
    seen = watch(sensors(0.4, 5, -3))
    readings = sensors(0.4, 5, -3)
    readings[dead] = reading
    watch(readings, seen=seen)
    assert seen.bad == 1 << dead
    assert math.degrees(seen.roll_rad) == pytest.approx(5, abs=0.01)
    assert math.degrees(seen.pitch_rad) == pytest.approx(-3, abs=0.01)
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


def test_stuck_only_while_the_others_move():
    seen = pressure.Plane(wire.PA_PER_M, 0.13, 0.13)
    seen.tare_pa = AIR
    still = sensors(0.4, 0, 0)
    for _ in range(600):
        seen.step(still, 15, CYCLE_US)
    assert seen.bad == 0, "a quiet tank is no fault"
    for i in range(600):
        seen.step([still[0], *(pa + i % 7 for pa in still[1:])], 15, CYCLE_US)
    assert seen.bad == 0b0001


def test_a_shifted_sensor_is_noticed_but_not_named():
    readings = sensors(0.4, 0, 0)
    readings[2] += 0.03 * wire.PA_PER_M
    seen = watch(readings, 3.0)
    assert seen.disagree and seen.bad == 0


def test_one_spike_moves_nothing_a_shift_is_for_parity():
    seen = watch(sensors(0.4, 0, 0))
    for k in range(4):
        spiked = sensors(0.4, 0, 0)
        spiked[k] -= 0.2 * wire.PA_PER_M
        seen.step(spiked, 15, CYCLE_US)
        assert seen.depth_m == pytest.approx(0.4, abs=0.001) and seen.roll_rad == pytest.approx(0.0, abs=0.001)
        watch(sensors(0.4, 0, 0), 0.1, seen=seen)
    watch(spiked, 3.0, seen=seen)
    assert seen.disagree and seen.bad == 0


def test_water_that_comes_all_at_once_is_no_spike():
    seen = watch(sensors(0.4, 0, 0))
    seen.step(sensors(0.1, 0, 0), 15, CYCLE_US)
    assert seen.depth_m == pytest.approx(0.1, abs=0.001)


def test_tare_refuses_waves_and_water():
    def tare(*rows: list[float]) -> Any:
        collector = pressure.Tare()
        while not collector.step(rows[len(collector._pa[0]) % len(rows)]):
            pass
        return collector.result()

    assert tare(AIR) == AIR
    assert tare(AIR, [pa + 250.0 for pa in AIR]) is None
    assert tare([AIR[0] + 600.0, *AIR[1:]]) is None


def test_numbering_of_thrusters_is_that_of_sensors():
    """A corner that is too deep gets more lift: the paper's sign."""
    seen = watch(sensors(0.4, 5, 4))
    corner = [-(thrust.ROLL[j] * seen.roll_rad + thrust.PITCH[j] * seen.pitch_rad) for j in range(4)]
    deep = [seen.zeta_m[j] - seen.depth_m for j in range(4)]
    assert sorted(range(4), key=corner.__getitem__) == sorted(range(4), key=deep.__getitem__)
