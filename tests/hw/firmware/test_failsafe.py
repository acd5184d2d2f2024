"""The ladder as a table, and the arming checks one by one."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from hw.firmware import failsafe, thrust, wire
from hw.firmware.failsafe import DISARM, HOLD, LATCHED, OK, SURFACE
from hw.module import surfacing_for_silence
from hw.stm32.protocol import HostProtocol
from hw.twin.dive import LOCK_STEP_S
from tests.hw.firmware.bare_board import FIRMWARE
from tests.hw.firmware.diving_robot import ASCENT_M_S, HOST, HOVER, REST_N, SURFACED_M, TILTED_DEG, diving_robot
from tests.studies import single_faults

MS = 1000
CYCLE_US = 10 * MS
AIR = [101_000_000, 101_200_000, 101_300_000, 101_100_000]


def plane(**state: Any) -> Any:
    fine = {"depth_m": 0.4, "roll_deg": 0.0, "pitch_deg": 0.0, "bad_count": 0, "disagree": False, "parity_m": 0.0}
    now = {**fine, "tare_mPa": AIR, "upside_down": False, "leans": False, "over": False, "still": False, **state}
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
        ({"seconds": 0.01, "bad_count": 4, "still": True}, DISARM, "sensors stand still"),
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
    ladder.latch(wire.REASONS.index("emergency stop"))
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
    "killed": False,
    "unchecked": False,
}
STOPPED = failsafe.Ladder()
STOPPED.latch(wire.REASONS.index("emergency stop"))


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
        ({"killed": True}, "kill switch open"),
        ({"unchecked": True}, "wiring not checked: `aucamp board check`"),
        ({"plane": plane(upside_down=True)}, "upside down"),
    ],
)
def test_each_arming_check_alone(change, check):
    assert failsafe.arm_faults(**GO) == 0
    assert failsafe.arm_faults(**GO | change) == 1 << wire.ARM_CHECKS.index(check)


def test_arming_checks_are_reported_together():
    bad = plane(bad_count=1, parity_m=1.0, tare_mPa=None, roll_deg=57.0, upside_down=True)
    assert (
        failsafe.arm_faults(False, bad, True, True, False, 1 << 29, 0, STOPPED, 9999, True, True, True)
        == 2 ** len(wire.ARM_CHECKS) - 1
    )


def test_reasons_are_numbered_alike_wherever_they_stand():
    named = dict(ORDER="order", PARAMETERS="parameters unreadable", FAULT="control fault", KILLED="kill switch")
    named |= dict(STOP="emergency stop", WATCHDOG="watchdog", OVERTURNED="overturned")
    seen = set()
    for path in FIRMWARE.glob("*.py"):
        for name, value in re.findall(r"^_([A-Z]+) = const\((\d+)\)", path.read_text(), re.MULTILINE):
            if name in named:
                seen.add(name)
                assert wire.REASONS[int(value)] == named[name], f"{path.name}: _{name}"
    assert seen == set(named)


# --- failsafe dive ---
# Every step of the failsafe ladder made to happen to a robot in the water, through its serial port.


@pytest.fixture
def robot(tmp_path):
    with diving_robot(tmp_path) as robot:
        yield robot


@pytest.fixture
def hovering(robot):
    robot.arm()
    return robot


def at_rest(robot) -> bool:
    """All pulses neutral or gone, and all thrusters stopped."""
    pulses_us = robot.dive._pulses_us[0]
    return bool(np.all((pulses_us == 0) | (pulses_us == 1500)) and np.all(robot.thrust_n < REST_N))


def test_host_silent_the_robot_holds_then_rises_then_stops_its_motors(hovering):
    robot = hovering
    robot.asks = msgspec.structs.replace(HOVER, force_n=(1.0, 0.0))
    robot.run(1.0)
    assert robot.thrust_n[4:].max() > 0.3
    robot.talks = False
    silent_s = robot.until(lambda: robot.ladder == failsafe.HOLD, 1.0)
    assert silent_s == pytest.approx(0.5, abs=0.1)
    robot.run(1.0)
    assert robot.thrust_n[4:].max() < REST_N  # no planar push without a host
    assert robot.thrust_n[:4].max() > 0 and abs(robot.depth_m - HOVER.depth_m) < 0.01
    silent_s += 1.0 + robot.until(lambda: robot.ladder == failsafe.SURFACE, 3.0)
    assert silent_s == pytest.approx(3.0, abs=0.1)
    robot.run(2.0)
    assert HOVER.depth_m - robot.depth_m == pytest.approx(2.0 * ASCENT_M_S, abs=0.05)
    assert robot.tilt_deg < 1.0
    robot.until(lambda: not robot.armed, 8.0)
    assert robot.depth_m < SURFACED_M
    robot.run(1.0)
    assert robot.heard("surfaced") and at_rest(robot)
    robot.talks = True
    robot.run(5.0)
    assert not robot.armed and at_rest(robot)  # the host's return arms nobody


def test_host_silent_the_lamp_goes_dark_and_comes_back_with_it(hovering):
    robot = hovering
    robot.asks = msgspec.structs.replace(HOVER, light=0.5)
    robot.run(1.0)
    lamp = robot.dive.lamps
    assert lamp.asked[0] == pytest.approx(0.5)
    robot.talks = False
    robot.run(0.4)
    assert lamp.asked[0] == pytest.approx(0.5)  # a few lost set-points are no silence
    robot.run(0.7)
    assert lamp.asked[0] == 0.0 and robot.ladder == failsafe.HOLD
    robot.talks = True
    robot.run(0.2)
    assert lamp.asked[0] == pytest.approx(0.5) and robot.ladder == failsafe.OK


def test_held_down_it_gives_up_after_half_a_minute(hovering):
    robot = hovering
    robot.dive.bodies["displaced_kg"] -= 6.0  # 59 N down; four thrusters lift 40 N
    robot.talks = False
    robot.run(10.0)
    assert robot.ladder == failsafe.SURFACE and robot.thrust_n[:4].min() > 5.0
    robot.run(22.5)
    assert robot.armed and not at_rest(robot)
    robot.until(lambda: not robot.armed, 1.5)
    robot.run(1.0)
    assert robot.heard("surfacing took too long")
    assert at_rest(robot)


def test_one_sensor_dead_it_stays_level_where_it_is(hovering):
    robot = hovering
    robot.dive.kill_sensor("r1", 2)
    robot.run(1.0)
    assert robot.telemetry[-1].flags & wire.FLAG_DEGRADED
    worst_deg = 0.0
    for _ in range(50):
        robot.run(0.1)
        worst_deg = max(worst_deg, robot.tilt_deg)
    assert robot.armed and robot.ladder == failsafe.OK
    assert worst_deg < 1.0 and abs(robot.depth_m - HOVER.depth_m) < 0.01
    robot.dive.mend_sensor("r1", 2)
    robot.run(1.5)
    assert not robot.telemetry[-1].flags & wire.FLAG_DEGRADED


def test_one_sensor_stuck_is_found_out_while_the_robot_moves(hovering):
    robot = hovering
    robot.dive.stick_sensor("r1", 3)
    robot.run(1.2)  # one second the same, and the others move
    assert robot.telemetry[-1].flags & wire.FLAG_DEGRADED
    robot.run(6.8)
    assert robot.armed and robot.tilt_deg < 1.0


def test_a_sensor_that_lies_is_not_named_and_the_robot_surfaces(hovering):
    robot = hovering
    robot.dive.shift_sensor("r1", 1, 0.05)
    robot.until(lambda: robot.ladder == failsafe.SURFACE, 2.0)
    robot.run(2.0)
    assert robot.heard("sensors disagree")
    assert HOVER.depth_m - robot.depth_m > 0.08


def test_two_sensors_dead_stop_the_motors_at_once(hovering):
    robot = hovering
    robot.dive.kill_sensor("r1", 1)
    robot.dive.kill_sensor("r1", 4)
    robot.run(1.2)
    assert not robot.armed and robot.heard("two sensors bad")
    assert at_rest(robot)
    robot.dive.mend_sensor("r1", 1)
    robot.dive.mend_sensor("r1", 4)
    robot.run(5.0)
    assert not robot.armed and at_rest(robot)


def test_a_leak_brings_it_up_whatever_the_host_asks_for(hovering):
    robot = hovering
    robot.dive.leak("r1")
    robot.until(lambda: robot.ladder == failsafe.SURFACE, 0.2)
    robot.run(2.0)
    assert robot.heard("leak") and HOVER.depth_m - robot.depth_m > 0.08
    robot.until(lambda: not robot.armed, 8.0)
    assert robot.depth_m < SURFACED_M
    robot.run(1.0)
    assert at_rest(robot)


def test_an_empty_battery_brings_it_up_a_sag_does_not(hovering):
    robot = hovering
    robot.dive.set_battery("r1", 11.5)
    robot.run(1.5)
    robot.dive.set_battery("r1", 14.9)
    robot.run(1.0)
    assert robot.ladder == failsafe.OK
    robot.dive.set_battery("r1", 11.5)
    assert robot.until(lambda: robot.ladder == failsafe.SURFACE, 5.0) == pytest.approx(3.3, abs=0.3)  # 2 s of the mean
    robot.run(2.0)
    assert robot.heard("battery low") and HOVER.depth_m - robot.depth_m > 0.08


def test_on_its_side_it_stops_its_motors(hovering):
    robot = hovering
    robot.dive.push("r1", (0.0, 0.0, -40.0), (0.0, 0.13, 0.0), 6.0)  # more than the thrusters can right
    robot.until(lambda: robot.tilt_deg > TILTED_DEG, 2.0)
    tilted_s = robot.until(lambda: not robot.armed, 4.0)
    assert tilted_s > 2.0 - 0.1
    robot.run(1.0)
    assert robot.heard("tilted") and at_rest(robot)


@pytest.mark.parametrize("to", ["open", "broken"])
def test_an_open_kill_switch_and_a_broken_wire_disarm_and_are_said(hovering, to):
    robot = hovering
    robot.dive.turn_kill_switch("r1", to)
    robot.run(0.1)
    assert not robot.armed and robot.telemetry[-1].flags & wire.FLAG_KILLED
    robot.run(0.9)
    assert robot.heard("kill switch") and at_rest(robot)
    robot.protocol.arm()
    robot.run(1.0)
    assert robot.heard("kill switch open") and not robot.protocol.wants_armed
    robot.dive.turn_kill_switch("r1", "closed")
    robot.run(5.0)
    assert not robot.armed and at_rest(robot), "a closed switch starts nobody"
    robot.protocol.arm()
    if to == "broken":
        robot.run(5.0)
        assert not robot.armed and at_rest(robot)
    else:
        robot.arm()
        assert robot.thrust_n.max() > 0, "and the ESCs heard neutral for as long as they need"


def test_a_spike_in_the_loop_is_a_kill_too_and_no_reboot_is_needed(hovering):
    robot = hovering
    robot.dive.turn_kill_switch("r1", "open")
    robot.run(0.01)
    robot.dive.turn_kill_switch("r1", "closed")
    robot.run(1.0)
    assert not robot.armed and at_rest(robot) and robot.heard("kill switch")
    robot.arm()


def test_escs_that_get_their_power_late_are_waited_for(robot):
    """A battery that is plugged in while the board hangs on USB: neutral that no ESC hears does not count."""
    robot.dive.set_battery("r1", 0.1)
    robot.run(10.0)
    robot.protocol.arm()
    robot.run(1.0)
    assert not robot.armed
    robot.dive.set_battery("r1", 14.9)
    robot.protocol.arm()
    assert robot.until(lambda: robot.armed, 7.0) >= 5.0, "they start up, then they hear neutral for 3 s"
    robot.arm()
    assert robot.thrust_n.max() > 0


def test_emergency_stop_lasts_until_the_power_was_off(hovering):
    robot = hovering
    boot_id = robot.protocol._boot_id
    robot.protocol.stop(wire.ESTOP)
    robot.run(1.2)
    assert at_rest(robot) and robot.ladder == failsafe.LATCHED
    robot.protocol = HostProtocol(8)  # another host, which stopped nobody
    robot.protocol.connected()
    robot.run(1.0)
    robot.protocol.arm()
    robot.run(5.0)
    assert not robot.armed and at_rest(robot)
    assert robot.heard("fault latched")
    assert robot.protocol._boot_id == boot_id and not robot.protocol.wants_armed
    robot.dive.cut_power("r1", 0.5)
    robot.run(1.0)
    assert robot.protocol._boot_id not in (None, boot_id) and robot.ladder == failsafe.OK
    assert not robot.armed and not robot.protocol.wants_armed  # nor was the wish to arm kept over the restart
    robot.arm()
    assert robot.armed and not at_rest(robot)


def test_an_agent_that_is_killed_leaves_a_robot_that_comes_up(robot):
    """The host is a process of its own; the water runs up to three times as fast as the clock that it lives by."""
    host = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(HOST), str(robot.board.port)], stdout=subprocess.PIPE
    )
    try:

        def water(seconds: float, until=lambda: False) -> None:
            for _ in range(round(seconds * 100)):
                if until():
                    return
                robot.dive.tick(LOCK_STEP_S)
                time.sleep(0.003)

        assert host.stdout is not None
        os.set_blocking(host.stdout.fileno(), False)
        water(60.0, until=lambda: b"armed" in (host.stdout.read() or b""))
        water(3.0)
        assert abs(robot.depth_m - HOVER.depth_m) < 0.01 and robot.thrust_n.max() > 0
        host.send_signal(signal.SIGKILL)
        host.wait()
        start_m = robot.depth_m
        water(2.5)
        assert abs(robot.depth_m - start_m) < 0.01
        water(2.5)
        assert start_m - robot.depth_m > 0.08
        depths_m = []
        while not at_rest(robot) and len(depths_m) < 1000:
            robot.dive.tick(LOCK_STEP_S)
            depths_m.append(robot.depth_m)
        assert at_rest(robot) and min(depths_m) < SURFACED_M
    finally:
        host.kill()
        host.wait()
        host.stdout.close()


def test_a_firmware_that_hangs_is_reset_and_stays_disarmed_until_somebody_has_looked(hovering):
    robot = hovering
    boot_id = robot.protocol._boot_id
    robot.dive.hang_firmware("r1")
    robot.run(0.45)
    assert not at_rest(robot)  # its last pulses still stand
    robot.run(1.2)
    assert at_rest(robot)
    robot.run(6.0)  # long enough for the ESCs, had anybody asked
    assert robot.protocol._boot_id not in (None, boot_id)
    assert not robot.armed and at_rest(robot)
    assert robot.heard("the board has restarted; arm again") and not robot.protocol.wants_armed
    assert robot.ladder == failsafe.LATCHED
    robot.protocol.arm()
    robot.run(1.0)
    assert robot.heard("fault latched") and not robot.armed
    boot_id = robot.protocol._boot_id
    robot.protocol.stop(wire.ESTOP)
    robot.run(0.5)
    robot.protocol.arm()  # a stop on top of it is no leave to reboot
    robot.run(6.0)
    assert not robot.armed and robot.protocol._boot_id == boot_id and robot.ladder == failsafe.LATCHED
    robot.dive.cut_power("r1", 0.2)  # somebody has looked at it
    robot.run(0.5)
    robot.arm()


# --- what does not do what it is told ---
# tests/studies/single_faults.py measures the same on many robots.


@pytest.mark.parametrize(
    "name",
    ["T1 dead", "T1 reversed", "T1, T2 crossed", "T1, T3 crossed", "left pair drifts, IMU", "overturned, no IMU"],
)
def test_a_single_fault_is_said_by_its_name_and_ends_at_the_surface_or_with_motors_off(name):
    outcome = single_faults.dive(single_faults.CASES[name], 3)
    assert outcome.named_s is not None and outcome.named_s <= single_faults.WITHIN_S, outcome
    assert outcome.level >= SURFACE


@pytest.mark.parametrize(
    ("roll", "pitch", "says"),
    [
        (3, -3, ""),
        (9, -2, ""),
        (9, -8, "T1 gives little or nothing"),
        (-9, -8, "T2 gives little or nothing"),
        (-9, 8, "T3 gives little or nothing"),
        (9, 8, "T4 gives little or nothing"),
        (2, -30, "T1 and T2 are crossed"),
        (-30, 2, "T2 and T3 are crossed"),
        (2, 30, "T3 and T4 are crossed"),
        (30, 2, "T4 and T1 are crossed"),
    ],
)
def test_what_a_nudge_shows(roll, pitch, says):
    reason = failsafe._moved(roll, pitch)
    assert (wire.REASONS[reason] if reason else "") == says


@pytest.mark.parametrize("thruster", [1, 2, 3, 4])
def test_a_push_that_does_not_end_is_the_thrusters_that_works_against_the_law(thruster):
    roll, pitch = thrust.ROLL[thruster - 1], thrust.PITCH[thruster - 1]
    for newton in (-8_000_000, 8_000_000):
        reason = failsafe.pushed_by(-newton, newton * roll * 60 // 1000, newton * pitch * 80 // 1000)
        assert wire.REASONS[reason] == f"T{thruster} pushes the wrong way"
    assert wire.REASONS[failsafe.pushed_by(0, 300_000, 20_000)].startswith("attitude contradicts")


def test_all_thrust_for_three_seconds_and_still_far_off_is_not_holding():
    ladder = failsafe.Ladder()
    for _ in range(299):
        ladder.watch(CYCLE_US, 600_000, 0, True, (0, 0, 0), False)
    ladder.watch(CYCLE_US, 600_000, 0, False, (0, 0, 0), False)
    for _ in range(300):
        assert climb(0.01, ladder=ladder).level == OK
        ladder.watch(CYCLE_US, 600_000, 0, True, (0, 0, 0), False)
    assert climb(0.01, ladder=ladder).level == SURFACE and wire.REASONS[ladder.reason].startswith("not holding")
    assert ladder.found(), "and no host that comes back calls it down again"


def test_another_moment_that_holds_a_robot_at_rest_contradicts_its_attitude():
    """A pair of sensors that drift leans it. A trim that stands is none, nor is what comes with a push or an order."""

    def ends(*moments_uNm: int, still: bool = True) -> int:
        ladder = failsafe.Ladder()
        for moment_uNm in moments_uNm:
            for _ in range(100):  # 4 s
                ladder.watch(4 * CYCLE_US, 0, 0, False, (0, 0, moment_uNm), still)
        return int(ladder.level)

    assert ends(100_000, 100_000) == OK == ends(0, 60_000, still=False) == ends(0, 30_000)
    assert ends(0, 60_000) == SURFACE == ends(100_000, 40_000)


@pytest.mark.parametrize(
    ("shows", "still", "nudges", "named"),
    [(5, True, 4, False), (9, True, 1, False), (9, True, 2, True), (9, False, 3, False), (9, False, 4, True)],
)
def test_a_thruster_is_weak_where_nudges_together_show_enough(shows, still, nudges, named):
    """Two of them; four of a robot under way, whose pushes change as nudges do."""
    probe, said = failsafe.Probe(100), set()
    for cycle in range(100 * nudges):
        sign = -1 if 23 <= (cycle + 1) % 100 - 6 < 69 else 1
        said.add(probe.step(sign * shows * 520, -sign * shows * 690, 10_000, True, True, still))
    assert (wire.REASONS.index("T1 gives little or nothing") in said) is named


def test_a_robot_that_leant_is_given_time_to_settle():
    """Of a thruster that is weak, it is not said earlier than after two more nudges."""
    weak = wire.REASONS.index("T1 gives little or nothing")

    def named_in(leant: int) -> int:
        """Cycles."""
        probe = failsafe.Probe(100)
        for cycle in range(1000):
            sign = -1 if 23 <= (cycle + 1) % 100 - 6 < 69 else 1
            if probe.step(sign * 9 * 520, -sign * 9 * 690, 10_000, cycle != leant, cycle != leant, True) == weak:
                return cycle
        raise AssertionError("never")

    assert named_in(leant=10) == named_in(leant=-1) + 300


def test_sensors_that_bend_where_the_robot_is_rocked_are_crossed():
    probe = failsafe.Probe(100)
    assert probe.rocking and {probe.rocked(mm * 10_000) for mm in (3, 7, -4, 10)} == {0}
    assert wire.REASONS[probe.rocked(-60_000)] == "neighbouring sensors are crossed"
    rocked = [(probe.rocking and probe.rock(), probe.step(0, 0, 10_000, True, True, True))[0] for _ in range(300)]
    assert rocked.count(1) == rocked.count(-1) == 46 and not any(rocked[100:]), "once after arming"
    probe.begin()
    assert probe.rocking


def test_a_robot_that_surfaces_for_what_it_found_is_not_called_back_as_one_whose_host_was_silent(hovering):
    robot = hovering
    robot.dive.scale_thruster("r1", 2, 0.0)
    robot.until(lambda: robot.ladder == SURFACE, 4.0)
    robot.run(0.3)
    assert robot.heard("T2 gives little or nothing") and robot.telemetry[-1].flags & wire.FLAG_FOUND
    assert not surfacing_for_silence(robot.telemetry[-1])
    robot.until(lambda: not robot.armed, 10.0)
    robot.run(1.0)
    assert at_rest(robot)
