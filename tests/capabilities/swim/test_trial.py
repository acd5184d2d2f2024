"""The trial that mass and drag are read from: all legs, two speeds each way, coasts, and never far from its line."""

import math
from itertools import groupby

import pytest
from msgspec.structs import replace

from agent.capabilities.swim.behaviour import COAST_NS, LEGS, Spin, Stage, trial
from agent.core.config import Navigation, Trial
from agent.core.linear_algebra import wrap
from agent.robot.fleet_reader import broken_swim_rules
from tests.capabilities.swim.swimming_agent import CALIBRATION, InTank, fleet
from tests.known_body import LIGHT

WHAT, STEP_NS = Trial(x_m=1.5, y_m=1.0, yaw_deg=30.0), 50_000_000
S = STEP_NS * 1e-9


def swum(what):
    """(stage, reference, pose) of each step of a body that does at once what it is asked for, and coasts for 0.2 m."""
    stage, pose, speed, now_ns, told = Stage(), (1.2, 0.9, 2.0), (0.0, 0.0, 0.0), 10**9, []
    while stage.leg < len(LEGS):
        to, stage = trial(what, stage, pose, now_ns)
        told.append((stage, to, pose))
        if to.coast:
            speed = tuple(0.94 * v for v in speed)
        elif to.rate_rad_s:
            speed = 0.0, 0.0, to.rate_rad_s
        elif any(to.velocity_m_s):
            speed = *to.velocity_m_s, 0.0
        else:
            turn, east, north = wrap(to.yaw - pose[2]), to.place_m[0] - pose[0], to.place_m[1] - pose[1]
            way = math.hypot(east, north)
            share = min(1.0, 0.25 / way) if way > 0.01 else 0.0
            speed = share * east, share * north, max(-1.0, min(1.0, turn))
        pose = pose[0] + S * speed[0], pose[1] + S * speed[1], wrap(pose[2] + S * speed[2])
        now_ns += STEP_NS
        assert len(told) < 4000, f"leg {stage.leg} never ends"
    return told, trial(what, stage, pose, now_ns)[0]


def test_every_leg_runs_at_its_speed_and_coasts() -> None:
    told, end = swum(WHAT)
    assert end.done and not end.coast
    seen = []
    for leg, steps in groupby(told, key=lambda row: row[0].leg):
        rows = list(steps)
        coasting = [row for row in rows if row[1].coast]
        if leg < len(LEGS):
            assert len(coasting) * STEP_NS == pytest.approx(COAST_NS, abs=2 * STEP_NS)
            running = [to for stage, to, _ in rows if stage.runs]
            seen.append((math.hypot(*running[0].velocity_m_s), running[0].rate_rad_s))
            assert running[0].velocity_m_s[0] * getattr(LEGS[leg], "way", 1.0) >= 0.0
    assert [round(v, 3) for v, _ in seen] == [0.25, 0.1, 0.1, 0.25] * 2 + [0.0] * 4
    assert [rate for _, rate in seen[8:]] == [leg.rate_rad_s for leg in LEGS if isinstance(leg, Spin)]


def test_it_stays_near_its_line() -> None:
    told, _ = swum(WHAT)
    c, s = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
    for stage, _, (x, y, _) in told[100:]:
        along, across = c * (x - 1.5) + s * (y - 1.0), c * (y - 1.0) - s * (x - 1.5)
        assert abs(along) < WHAT.half_m + 0.02 and abs(across) < 0.05, stage


def test_while_it_coasts_nothing_thrusts() -> None:
    robot = InTank(fleet(behaviour=Trial(x_m=1.5, y_m=1.0)), (1.0, 1.0, 0.0), seed=4)
    assert robot.until(lambda: robot.agent.swimmer.task.progress is not None, 5.0)
    assert robot.until(lambda: robot.agent.swimmer.task.progress.stage.coasts, 15.0)
    robot.step()
    assert robot.wrench == (0.0, 0.0, 0.0) and robot.body.speed[0] > 0.1


def test_a_trial_has_room_and_no_hurry() -> None:
    def wrong(**about):
        return [why for _, why in broken_swim_rules(fleet(behaviour=Trial(**about)))]

    assert not wrong(x_m=1.5, y_m=1.0)
    assert "less than 0.2 m from a wall" in wrong(x_m=0.6, y_m=1.0)[0]
    assert "(0.60, 0.10) is less" in wrong(x_m=0.6, y_m=0.6, yaw_deg=90.0)[0]
    assert "0.4 m/s is faster than navigation.limits.speed_m_s" in wrong(x_m=1.5, y_m=1.0, speed_m_s=0.4)[0]


def test_a_robot_that_was_calibrated_believes_its_own_mass() -> None:
    of = replace(fleet(), navigation=Navigation())
    own = InTank(of)
    assert own.agent.swimmer.localizer.hull.mass_kg == 6.0
    own.agent.__init__(of, "r1", replace(CALIBRATION, body=LIGHT), 7)
    assert own.agent.swimmer.localizer.hull[:6] == (4.0, 3.0, 30.0, 0.07, 0.04, 0.15)
