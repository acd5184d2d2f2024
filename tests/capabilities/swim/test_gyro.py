"""The gyro in the kernel: believed while it works, told and left out when it does not; without one nothing changes."""

import math

import numpy as np
import pytest
from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.swim.localizer import LATE_NS, SILENT_NS, Gyro, Rate
from agent.capabilities.swim.pose_filter import BIAS
from agent.core.config import Navigation
from tests.capabilities.swim.swimming_agent import InTank, fleet
from tests.sample_messages import telemetry

PERIOD_NS = 20_000_000
NOISE = np.random.default_rng(4).normal(0.1, 0.001, 400)


def after(*spans):
    """(what was believed, fault at the end) of readings at 50 Hz; spans: seconds, and the rate of a number."""
    gyro, t_ns, believed, n = Gyro(), 0, [], 0
    for seconds, rate in spans:
        for _ in range(round(seconds / 0.02)):
            t_ns, n = t_ns + PERIOD_NS, n + 1
            believed.append(gyro.read(telemetry(t_ns, rate_rad_s=rate(n))))
    return believed, gyro.fault(t_ns)


def works(n):
    return float(NOISE[n % 400])


def test_one_that_works_is_believed_at_the_time_of_its_reading() -> None:
    believed, fault = after((4.0, works))
    assert fault is None and None not in believed
    assert believed[9] == Rate(10 * PERIOD_NS - LATE_NS, works(10))


@pytest.mark.parametrize(
    ("rate", "says"),
    [
        (lambda n: UNSET, "no reading"),
        (lambda n: math.radians(250.13), "end of its scale"),
        (lambda n: -math.radians(250.13), "end of its scale"),
        (lambda n: 0.0, "stuck at 0.00 deg/s"),
        (lambda n: 0.2, "stuck at 11.46 deg/s"),
    ],
)
def test_one_that_does_not_work_is_left_out_told_and_taken_back(rate, says) -> None:
    believed, fault = after((2.0, works), (2.5, rate))
    assert says in fault and fault.startswith("gyro: ")
    assert not any(believed[-60:])
    believed, fault = after((2.0, works), (2.5, rate), (0.1, works))
    assert fault is None and all(believed[-5:])


@pytest.mark.parametrize("rate", [math.nan, math.inf])
def test_what_is_no_number_is_no_telemetry(rate) -> None:
    with pytest.raises(ValueError, match="rate_rad_s is not finite"):
        telemetry(0, rate_rad_s=rate)


def test_a_frame_or_two_without_a_reading_are_no_fault() -> None:
    believed, fault = after((2.0, works), (0.5, lambda n: UNSET))
    assert fault is None and not any(believed[-25:])
    assert after((0.5, lambda n: UNSET))[1] is None and SILENT_NS == 1_000_000_000


# --- in an agent ------------------------------------------------------------------------------------------------


def with_gyro(gyro=True, **about):
    return replace(fleet(**about), navigation=Navigation(gyro=gyro))


def rates_of(robot, says):
    robot.rate_rad_s = says
    return robot


def test_its_bias_is_learnt_and_a_blind_turn_is_followed() -> None:
    rng, bias = np.random.default_rng(2), 0.008
    robot = rates_of(InTank(with_gyro(), seed=3), lambda body: float(body.speed[2] + bias + rng.normal(0.0, 0.001)))
    robot.run(8.0)
    belief = robot.agent.swimmer.localizer.at(robot.now_ns)
    assert belief.x[BIAS] == pytest.approx(bias, abs=4 * math.sqrt(belief.P[BIAS][BIAS]))
    assert belief.P[BIAS][BIAS] < 0.004**2
    robot.sees_tags = False
    robot.body.speed[2] += 0.5  # something hits it
    robot.run(1.0)
    turned = robot.agent.swimmer.localizer.at(robot.now_ns)
    assert math.degrees(abs(turned.x[2] - robot.body.at[2])) < 1.5
    assert not [fault for fault in robot.state.faults if "gyro" in fault]


def test_one_that_the_file_promises_and_nobody_fitted_is_told_and_the_robot_swims_without() -> None:
    robot, same = InTank(with_gyro(), seed=3), InTank(fleet(), seed=3)
    robot.run(2.0)
    same.run(2.0)
    assert any(fault.startswith("gyro: no reading") for fault in robot.state.faults)
    np.testing.assert_allclose(robot.body.at, same.body.at, atol=1e-12)


def test_without_it_in_the_file_what_it_says_changes_nothing() -> None:
    silent, told = InTank(fleet(), seed=3), rates_of(InTank(fleet(), seed=3), lambda body: 0.7)
    for _ in range(40):
        assert silent.step() == told.step()
