"""The hover loop on the plant that it was tuned on, in one process: recovery, steps, saturation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hw.firmware import gains, law, law_pi, law_pid, pressure, thrust
from tests.hw.firmware.nominal_plant import ARM_X_M, ARM_Y_M, PA_PER_M, Plant

CYCLE_US = 10_000
FULL_UN, SLEW_UN = 10_000_000, 2_000_000


class Loop:
    """Plant and law, cycle by cycle; a history of (depth error m, roll deg, pitch deg)."""

    def __init__(self, plant: Plant, depth_m: float) -> None:
        self.plant, self.ref_m = plant, depth_m
        self.plane = pressure.Plane(PA_PER_M, 130, 130)
        self.plane.tare_mPa = [round(1000 * p) for p in plant.tare_pa]
        self.law = law.Observer(gains.observer())
        self.realised, self.want, self.forces, self.pulses_us = [0] * 3, [0] * 3, [0] * 8, [0] * 8
        self.answered = 15
        self.history: list[tuple[float, float, float]] = []
        self.sense()
        self.law.reset(self.y())

    def sense(self) -> None:
        self.plane.step(self.plant.pressure_mPa(), self.answered, CYCLE_US)

    def y(self) -> list[int]:
        return [self.plane.depth_100nm, self.plane.roll_100nrad, self.plane.pitch_100nrad]

    def run(self, seconds: float) -> Loop:
        for _ in range(round(seconds * 100)):
            self.sense()
            self.law.step(self.y(), [round(self.ref_m * 1e7), 0, 0], self.realised, self.want)
            thrust.central(self.want, FULL_UN, SLEW_UN, self.forces, self.realised)
            thrust.pulses(self.forces, [1500] * 8, FULL_UN, self.pulses_us)
            self.plant.step(self.pulses_us)
            depth, roll, pitch = self.plant.position
            self.history.append((depth - self.ref_m, math.degrees(roll), math.degrees(pitch)))
        return self

    def settled_after_s(self) -> float:
        """When depth came within 1 cm, roll and pitch within 2 degrees for good."""
        off = np.abs(self.history) > (0.01, 2.0, 2.0)
        late = np.flatnonzero(off.any(axis=1))
        return 0.0 if late.size == 0 else (late[-1] + 1) / 100.0


def push(loop: Loop) -> Loop:
    """8 N down on the front left corner for 0.3 s; time counts from its end."""
    loop.run(2.0)
    loop.plant.push[:] = (8.0, -8.0 * 0.13, 8.0 * 0.13)
    loop.run(0.3)
    loop.plant.push[:] = 0.0
    loop.history.clear()
    return loop.run(5.2)


def test_hovers():
    history = np.array(Loop(Plant(1, 0.30), 0.30).run(10.0).history[300:])
    depth, roll, pitch = np.sqrt(np.mean(history**2, axis=0))
    assert depth < 0.002 and roll < 0.3 and pitch < 0.3


@pytest.mark.parametrize("seed", range(5))
def test_recovers_from_a_push(seed):
    assert push(Loop(Plant(seed, 0.30), 0.30)).settled_after_s() < 1.5


def under(other, loop: Loop) -> Loop:
    """The same loop, another law."""
    loop.law = other
    loop.law.reset(loop.y())
    return loop


def test_pid_recovers_on_the_plant_that_it_was_tuned_on():
    assert push(under(law_pid.Pid(), Loop(Plant(0, 0.30), 0.30))).settled_after_s() < 2.0


def test_the_papers_pi_does_not_come_to_rest_for_nothing_damps_it():
    assert push(under(law_pi.Pi(), Loop(Plant(0, 0.30), 0.30))).settled_after_s() > 5.0


def test_the_push_is_felt():
    loop = Loop(Plant(0, 0.30), 0.30)
    loop.law.step = lambda *_: None  # nobody steers
    assert push(loop).settled_after_s() > 5.0


@pytest.mark.parametrize(("lag_s", "inertia_factor"), [(0.13, 1.4), (0.08, 0.65)])
def test_recovers_although_the_robot_is_not_the_one_it_believes_in(lag_s, inertia_factor):
    loops = [push(Loop(Plant(seed, 0.30, lag_s, inertia_factor), 0.30)) for seed in range(3)]
    assert max(loop.settled_after_s() for loop in loops) < 2.1
    assert max(loop.plant.position[0] for loop in loops) < 0.45


@pytest.mark.parametrize("seed", range(3))
def test_depth_step(seed):
    loop = Loop(Plant(seed, 0.22), 0.22).run(2.0)
    loop.ref_m = 0.41
    loop.history.clear()
    loop.run(4.0)
    assert loop.settled_after_s() < 1.5
    assert max(error for error, _, _ in loop.history) < 0.010
    assert np.abs(np.array(loop.history)[-100:, 1:]).max() < 2.0


def test_learns_net_weight():
    loop = Loop(Plant(1, 0.30), 0.30)
    loop.plant.push[0] = 2.0  # heavy by 2 N
    loop.run(5.0)
    assert loop.law.disturbance(0) * 1e-6 == pytest.approx(2.0, abs=0.4)
    assert abs(np.mean([error for error, _, _ in loop.history[-100:]])) < 0.003


def test_one_dead_sensor_and_it_stays_level():
    loop = Loop(Plant(2, 0.30), 0.30)
    loop.run(1.0)
    loop.answered = 0b1101
    push(loop)
    assert loop.plane.bad == 0b0010
    assert loop.settled_after_s() < 2.0


def test_no_windup_against_the_floor():
    loop = Loop(Plant(4, 0.30), 0.60)
    for _ in range(1000):
        loop.run(0.01)
        if loop.plant.position[0] > 0.45:
            loop.plant.position[0] = 0.45
            loop.plant.speed[0] = 0.0
    loop.ref_m = 0.30
    loop.history.clear()
    loop.run(5.0)
    assert loop.settled_after_s() < 2.0


# --- allocation and pulses ----------------------------------------------------------------------------------------


REACTION = (1, -1, 1, -1)  # a propeller's torque: neighbours turn opposite ways
ARMS_M = np.array([1.0, ARM_Y_M, ARM_X_M])


def central(wrench: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    """Forces of T1-T4 in N, realised wrench in N and Nm, and whether something was cut."""
    forces, realised = [0] * 8, [0] * 3
    cut = thrust.central([round(w * 1e6) for w in wrench], FULL_UN, 99_000_000, forces, realised)
    return np.array(forces[:4]) * 1e-6, np.array(realised) * 1e-6, cut


def test_allocation_matrix_is_orthogonal():
    H = np.array([(1, 1, 1, 1), thrust.ROLL, thrust.PITCH, REACTION])
    assert np.array_equal(H @ H.T, 4 * np.eye(4))


def test_within_limits_the_wrench_is_realised_exactly():
    rng = np.random.default_rng(0)
    for _ in range(200):
        want = rng.uniform(-1, 1, 3) * (8.0, 0.4, 0.5)
        _, realised, cut = central(want)
        assert not cut
        assert realised == pytest.approx(want, abs=2e-5)


def test_attitude_before_depth():
    rng = np.random.default_rng(1)
    cuts = 0
    for _ in range(1000):
        want = rng.uniform(-1, 1, 3) * (60.0, 3.0, 4.0)
        f, realised, cut = central(want)
        cuts += cut
        assert f.min() >= -8.001 and f.max() <= 10.001
        share = np.abs(realised[1:]).sum() / np.abs(want[1:]).sum()
        assert realised[1:] == pytest.approx(share * want[1:], abs=1e-3), "the direction of the torque is kept"
        assert 0 < share <= 1.001
        if share < 0.998:  # attitude has all of its share
            worst = abs(realised[1]) / ARM_Y_M / 4 + abs(realised[2]) / ARM_X_M / 4
            assert worst == pytest.approx(0.9 * 8.0, rel=1e-3)
        if abs(realised[0] - want[0]) > 1e-3:  # depth was cut: then a thruster is at its limit
            assert min(10.0 - f.max(), f.min() + 8.0) < 2e-3
        assert np.dot(REACTION, f) == pytest.approx(0.0, abs=1e-4), "and nothing turns the robot"
    assert cuts > 500


def test_flat_thrusters_push_and_turn():
    forces = [0] * 8
    assert not thrust.flat(3_000_000, -2_000_000, 500_000, FULL_UN, forces)
    angle = np.radians([45, 135, 225, 315])
    f = np.array(forces[4:]) * 1e-6
    wrench = (-np.sin(angle) @ f, np.cos(angle) @ f, 0.17 * f.sum())
    assert wrench == pytest.approx((3.0, -2.0, 0.5), abs=1e-3)
    assert thrust.flat(30_000_000, 0, 0, FULL_UN, forces)
    assert 9_970_000 < max(forces) <= 10_000_000 or min(forces) == pytest.approx(-8_000_000, rel=3e-3)
    assert min(forces) >= -8_001_000


def test_flat_thrusters_never_idle_while_a_push_is_asked_for():
    """Near zero force a thruster does nothing: the dead band of its ESC, and a zero that is off."""
    forces = [0] * 8
    for push in ((20_000, 0, 0), (0, -20_000, 0), (0, 0, 3_000), (300_000, 200_000, -30_000)):
        thrust.flat(*push, FULL_UN, forces)
        assert min(map(abs, forces[4:])) > 0.01 * FULL_UN
        assert sum(force > 0 for force in forces[4:]) == 2
    thrust.flat(0, 0, 0, FULL_UN, forces)
    assert forces[4:] == [0] * 4


def test_pulses_rise_with_thrust_and_leap_the_dead_band():
    def pulse_us(force_n: float, neutral_us: int = 1500) -> int:
        thrust.pulses([round(force_n * 1e6)] * 8, [neutral_us] * 8, FULL_UN, pulses_us)
        return pulses_us[0]

    pulses_us = [0] * 8
    pulses = [pulse_us(f) for f in np.linspace(-9.0, 11.0, 2001)]
    assert pulses == sorted(pulses)
    assert pulses[0] == 1100 and pulses[-1] == 1900
    assert pulse_us(0.0, 1507) == 1507
    assert pulse_us(0.021) >= 1530 and pulse_us(-0.021) <= 1470
    assert pulse_us(10.0) == 1900 and pulse_us(-8.0) == 1100
