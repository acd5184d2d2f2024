"""The ladder as a table, and the arming checks one by one."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from hw.firmware import failsafe, wire
from hw.firmware.failsafe import DISARM, HOLD, LATCHED, OK, SURFACE

MS = 1000
CYCLE_US = 10 * MS
AIR = [101_000_000, 101_200_000, 101_300_000, 101_100_000]


def plane(**state: Any) -> Any:
    fine = {"depth_m": 0.4, "roll_deg": 0.0, "pitch_deg": 0.0, "bad_count": 0, "disagree": False, "parity_m": 0.0}
    now = {**fine, "tare_mPa": AIR, **state}
    for name, unit, scale in (
        ("depth_m", "depth_100nm", 1e7),
        ("parity_m", "parity_100nm", 1e7),
        ("roll_deg", "roll_100nrad", math.radians(1e7)),
        ("pitch_deg", "pitch_100nrad", math.radians(1e7)),
    ):
        now[unit] = round(now.pop(name) * scale)
    return SimpleNamespace(**now)


def climb(seconds: float, age_s: float = 0.0, leak: bool = False, low: bool = False, ladder: Any = None, **state: Any):
    """The ladder after so long in one situation; age_s is that of the set-point at the end."""
    ladder = ladder or failsafe.Ladder()
    cycles = round(seconds * 100)
    for i in range(cycles):
        age_us = max(0, round((age_s - (cycles - 1 - i) * 0.01) * 1e6))
        ladder.step(CYCLE_US, age_us, 500 * MS, plane(**state), leak, low)
    return ladder


@pytest.mark.parametrize(
    ("situation", "level", "reason"),
    [
        ({"seconds": 9.0}, OK, "none"),
        ({"seconds": 1.0, "age_s": 0.50}, OK, "none"),
        ({"seconds": 1.0, "age_s": 0.51}, HOLD, "host silent"),
        ({"seconds": 4.0, "age_s": 3.00}, HOLD, "host silent"),
        ({"seconds": 4.0, "age_s": 3.01}, SURFACE, "host silent"),
        ({"seconds": 40.0, "age_s": 33.0}, SURFACE, "host silent"),
        ({"seconds": 40.0, "age_s": 33.1}, DISARM, "surfacing took too long"),
        ({"seconds": 6.0, "age_s": 4.9, "depth_m": 0.09}, SURFACE, "host silent"),
        ({"seconds": 6.0, "age_s": 5.1, "depth_m": 0.09}, DISARM, "surfaced"),
        ({"seconds": 5.0, "depth_m": 0.09}, OK, "none"),
        ({"seconds": 0.01, "leak": True}, SURFACE, "leak"),
        ({"seconds": 1.9, "low": True}, OK, "none"),
        ({"seconds": 2.1, "low": True}, SURFACE, "battery low"),
        ({"seconds": 0.01, "disagree": True}, SURFACE, "sensors disagree"),
        ({"seconds": 1.9, "roll_deg": 50}, OK, "none"),
        ({"seconds": 2.1, "roll_deg": 50}, DISARM, "tilted"),
        ({"seconds": 2.1, "pitch_deg": -50}, DISARM, "tilted"),
        ({"seconds": 9.0, "pitch_deg": 40}, OK, "none"),
        ({"seconds": 9.0, "bad_count": 1}, OK, "none"),
        ({"seconds": 0.01, "bad_count": 2}, DISARM, "two sensors bad"),
    ],
)
def test_ladder(situation, level, reason):
    ladder = climb(**situation)
    assert (ladder.level, wire.REASONS[ladder.reason]) == (level, reason)


def test_hold_is_left_by_a_fresh_set_point_surface_is_not():
    ladder = climb(1.0, age_s=1.0)
    assert climb(0.01, ladder=ladder).level == OK
    ladder = climb(4.0, age_s=4.0)
    assert climb(1.0, ladder=ladder).level == SURFACE
    assert ladder.resume() and climb(0.01, ladder=ladder).level == OK


def test_a_shorter_life_of_the_set_point_counts():
    ladder = failsafe.Ladder()
    assert ladder.step(CYCLE_US, 210 * MS, 200 * MS, plane(), False, False) == HOLD


def test_latched_is_for_ever():
    ladder = failsafe.Ladder()
    ladder.latch(failsafe.STOP)
    assert not ladder.resume()
    assert climb(5.0, ladder=ladder).level == LATCHED


GO = {
    "hello": True,
    "plane": plane(),
    "battery_low": False,
    "leak": False,
    "neutral": True,
    "age_us": 100 * MS,
    "esc_us": 3_000_000,
    "ladder": failsafe.Ladder(),
    "loop_max_us": 4000,
    "tare_old": False,
}
STOPPED = failsafe.Ladder()
STOPPED.latch(failsafe.STOP)


@pytest.mark.parametrize(
    ("change", "check"),
    [
        ({"hello": False}, "no handshake"),
        ({"plane": plane(bad_count=1)}, "sensors not all good"),
        ({"plane": plane(parity_m=-0.006)}, "sensors disagree"),
        ({"plane": plane(tare_mPa=None)}, "no tare in air"),
        ({"plane": plane(roll_deg=20.6)}, "tilted"),
        ({"battery_low": True}, "battery low"),
        ({"leak": True}, "leak"),
        ({"neutral": False}, "set-point not neutral"),
        ({"age_us": 501 * MS}, "set-point old"),
        ({"esc_us": 2_990_000}, "ESC neutral for less than 3 s"),
        ({"ladder": STOPPED}, "fault latched"),
        ({"loop_max_us": 9000}, "control cycle too slow"),
        ({"tare_old": True}, "tare older than 12 h"),
    ],
)
def test_each_arming_check_alone(change, check):
    assert failsafe.arm_faults(**GO) == 0
    assert failsafe.arm_faults(**GO | change) == 1 << wire.ARM_CHECKS.index(check)


def test_arming_checks_are_reported_together():
    bad = plane(bad_count=1, parity_m=1.0, tare_mPa=None, roll_deg=57.0)
    assert (
        failsafe.arm_faults(False, bad, True, True, False, 1 << 29, 0, STOPPED, 9999, True)
        == 2 ** len(wire.ARM_CHECKS) - 1
    )


def test_reasons_are_numbered_alike_on_both_sides():
    assert wire.REASONS[failsafe.STOP] == "emergency stop" and len(wire.REASONS) == failsafe.FAULT + 1
