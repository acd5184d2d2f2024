"""The hover loop on the plant that it was tuned on, in one process: recovery, steps, saturation."""

from __future__ import annotations

import importlib
import json
import math
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from hw.firmware import gains, law, law_pid, pressure, thrust, wire
from tests.hw.desk import MICROPYTHON
from tests.hw.firmware.bare_board import firmware_main
from tests.hw.firmware.float_law import FloatObserver, InFloats, recorded
from tests.hw.firmware.nominal_plant import ARM_X_M, ARM_Y_M, PA_PER_M, Plant

CYCLE_US = 10_000
FULL_UN, SLEW_UN = 10_000_000, 2_000_000


class Loop:
    """Plant and law, cycle by cycle; a history of (depth error m, roll deg, pitch deg)."""

    def __init__(self, plant: Plant, depth_m: float) -> None:
        self.plant, self.ref_m = plant, depth_m
        self.plane = pressure.Plane(PA_PER_M)
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
    assert push(under(law_pid.Pi(), Loop(Plant(0, 0.30), 0.30))).settled_after_s() > 5.0


def test_the_push_is_felt():
    loop = Loop(Plant(0, 0.30), 0.30)
    loop.law.step = lambda *_: None  # nobody steers
    assert push(loop).settled_after_s() > 5.0


@pytest.mark.parametrize(("lag_s", "inertia_factor"), [(0.13, 1.4), (0.08, 0.65), (0.10, 0.45)])
def test_recovers_although_the_robot_is_not_the_one_it_believes_in(lag_s, inertia_factor):
    loops = [push(Loop(Plant(seed, 0.30, lag_s, inertia_factor), 0.30)) for seed in range(3)]
    assert max(loop.settled_after_s() for loop in loops) < 1.2
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


# --- law alike ---
# The law under MicroPython: the pulses of CPython on a recorded dive of each law, and no more memory than is good.

FIRMWARE = Path(wire.__file__).parent
COST = Path(__file__).with_name("cycle_cost.py")
CHECK = Path(__file__).with_name("check_law.py")
LAWS = ("observer", "pid", "pi")


def test_pulses_are_the_same_on_both_interpreters(tmp_path):
    """To the last bit in whole numbers; the laws in floats may differ by a microsecond."""
    if MICROPYTHON is None:
        pytest.skip("the MicroPython Unix port is not installed")
    recording = tmp_path / "dives.jsonl"
    rows = [(None if i else law, *cycle[:-1]) for law in LAWS for i, cycle in enumerate(recorded(law))]
    recording.write_text("".join(json.dumps(row) + "\n" for row in rows))
    runs = [
        subprocess.Popen([interpreter, CHECK, FIRMWARE, recording], stdout=subprocess.PIPE, text=True)
        for interpreter in (sys.executable, MICROPYTHON)
    ]
    ours, theirs = (
        np.array([line.split() for line in run.communicate(timeout=60)[0].splitlines()], int) for run in runs
    )
    assert ours.shape == theirs.shape == (len(rows), 8)
    assert np.array_equal(ours[:1000], theirs[:1000])
    assert np.abs(ours - theirs).max() <= 1


def cost(law: str, what: str) -> float:
    if MICROPYTHON is None:
        pytest.skip("the MicroPython Unix port is not installed")
    command = [MICROPYTHON, "-X", "heapsize=4M", COST, FIRMWARE, law, "500", what]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    return float(ran.stdout)


def test_a_plain_cycle_takes_next_to_no_memory():
    """256 bytes here are at most 256 on the board, whose blocks are of 16 where these are of 32."""
    assert cost("observer", "plain") <= 256


@pytest.mark.parametrize("law", LAWS)
def test_no_cycle_keeps_memory(law):
    assert cost(law, "kept") == 0


# --- whole numbers ---
# The steady cycle in whole numbers: it is the law that it was in floats, and it keeps within the board's 31 bits.

AIR_mPa = 101_325_000
DEAD_BAND_US = 30  # from neutral: no propeller turns within
LIMITS = np.array([40_000_000, 2_000_000, 2_500_000])  # uN, uNm: about what the thrusters can
NEUTRAL_US = np.array([1500, 1500, 1507, 1500, 1500, 1500, 1500, 1500])


def modules() -> tuple[ModuleType, ModuleType]:
    return firmware_main().motor_control, importlib.import_module("parameters")


def armed(name: str, first: list[int], **flash: float) -> Any:
    """Control with the motors on, in front of these pressures."""
    motor_control, parameters = modules()
    control = motor_control.Control()
    control.configure(
        parameters.from_flash({"law": name, "net_weight_N": 0.5, "zero_3_us": 1507, "nudge_s": 0, **flash})
    )
    control.plane.tare_mPa = [AIR_mPa] * 4
    for _ in range(10):
        control.sense(first, 15, 15000, 0, CYCLE_US)
    control.arm()
    return control


def fly(name: str, number: type[int] = int, instead: Any = None, **flash: float) -> tuple[np.ndarray, np.ndarray, Any]:
    """Pulses of the recorded dive now and as recorded, (1000, 8) each, and the control after it.

    instead: a law in place of its own.
    """
    cycles = list(recorded(name))
    control = armed(name, [number(p) for p in cycles[0].pressure_mPa], **flash)
    if instead is not None:
        control.law = instead
        instead.reset(control._y)
    pulses = []
    for cycle in cycles:
        control.set_point.age_us, control.set_point.ttl_us = 0, 500_000
        control.set_point.depth_100nm = number(cycle.depth_100nm)
        control.set_point.tilt_100nrad[0] = number(cycle.roll_100nrad)
        control.sense([number(p) for p in cycle.pressure_mPa], cycle.answered, number(14600), 0, CYCLE_US)
        control.act(CYCLE_US)
        pulses.append(list(control.pulses_us))
    return np.array(pulses), np.array([cycle.pulses_us for cycle in cycles]), control


def observer() -> Any:
    return law.Observer(gains.observer())


@pytest.mark.parametrize("name", ["observer", "pid", "pi"])
def test_pulses_are_those_of_the_law_in_floats(name):
    """To a microsecond, where a propeller turns by both.

    Inside the dead band, which is crossed at 0.7 mN a microsecond, the observer may be 10 us off: a recording does not
    answer, so that what the thrusters give and what the water gives cannot be told apart, and the roundings of ten
    seconds add up in the difference, to 16 mN. In water they do not: test_law_on_plant.py.
    """
    now, floats, _ = fly(name)
    if name == "observer":  # its gains are newer than its recording
        floats, _, _ = fly(name, instead=InFloats())
    off = np.abs(now - floats)
    turns = np.minimum(np.abs(floats - NEUTRAL_US), np.abs(now - NEUTRAL_US)) > DEAD_BAND_US
    assert off[turns].max() <= 1
    assert off.max() <= (10 if name == "observer" else 1)
    assert (off > 1).mean() < 0.01
    central = floats[:, :4]  # and the dives are worth comparing
    assert central.min() == 1100 or central.max() == 1900, "the push saturates"
    assert np.ptp(central, axis=0).min() > 100 and np.unique(central, axis=0).shape[0] > 300


def test_the_observer_wants_what_its_equations_want():
    """Given the same measurements and the same wrench that came of it: within 3 mN, 0.1 mNm, 0.05 % of its terms."""
    rng = np.random.default_rng(1)
    whole, floats = observer(), FloatObserver()
    y, want, realised = np.array([3_000_000, 0, 0]), [0] * 3, [0] * 3
    whole.reset(y.tolist())
    floats.reset((y * 1e-7).tolist())
    speed = np.zeros(3)
    for i in range(2000):
        speed += rng.normal(0, 300, 3) - 0.01 * speed  # the plant: it wanders, and sometimes leaps
        y = y + np.rint(speed).astype(int) + rng.normal(0, 5000, 3).astype(int)
        ref = [4_000_000 if i % 600 > 300 else 3_000_000, 500_000 if i % 500 > 250 else 0, 0]
        whole.step(y.tolist(), ref, realised, want)
        expected = floats.step((y * 1e-7).tolist(), [r * 1e-7 for r in ref], [r * 1e-6 for r in realised])
        realised = np.clip(want, -LIMITS, LIMITS).tolist()
        for k, least in enumerate((3e-3, 1e-4, 1e-4)):
            wanted, off = (
                np.clip(expected[k] * 1e6, -LIMITS[k], LIMITS[k]),
                least + 5e-4 * floats.terms(k, ref[k] * 1e-7),
            )
            assert realised[k] == pytest.approx(wanted, abs=off * 1e6), (i, k)
    assert [whole.disturbance(k) * 1e-6 for k in range(3)] == pytest.approx(floats.state[:, 3], rel=1e-3, abs=2e-3)


def test_a_lost_tick_is_predicted_over():
    """What stood still meanwhile were the pulses: the law of a robot that falls knows where it is by now."""
    each, every_second = observer(), observer()
    for one in (each, every_second):
        one.reset([3_000_000, 0, 0])
    want, heavy = [0] * 3, [0] * 3
    for tick in range(1, 200):
        y = [3_000_000 + 20 * tick * tick, 0, 0]
        each.step(y, [3_000_000, 0, 0], [0] * 3, want)
        if tick % 2 == 0:
            every_second.step(y, [3_000_000, 0, 0], [0] * 3, heavy, 2)
            if tick > 100:
                assert heavy[0] == pytest.approx(want[0], rel=0.05)


class Narrow(int):
    """A whole number that does not leave the board's: beyond 31 bits it would be an object there."""


def _narrow(name: str) -> Any:
    def operate(self: int, *others: int) -> Any:
        value = getattr(int, name)(int(self), *map(int, others))
        if value is NotImplemented or isinstance(value, bool):
            return value
        assert -(2**30) <= value < 2**30, f"{name}{(int(self), *map(int, others))} = {value}"
        return Narrow(value)

    return operate


for _name in ("add", "sub", "mul", "floordiv", "mod", "lshift", "rshift", "and", "or", "xor"):
    setattr(Narrow, f"__{_name}__", _narrow(f"__{_name}__"))
    setattr(Narrow, f"__r{_name}__", _narrow(f"__r{_name}__"))
for _name in ("neg", "abs", "pos"):
    setattr(Narrow, f"__{_name}__", _narrow(f"__{_name}__"))


@pytest.mark.parametrize(
    "robot",
    [
        {},
        {"net_weight_N": -5.0, "water_kg_m3": 1040.0},
        {"thrust_max_N": 40.0, "heave_kg": 35.0, "tilt_kgm2": 1.2, "slew_N": 8.0, "lag_s": 0.2, "water_kg_m3": 990.0},
        {"thrust_max_N": 60.0, "heave_kg": 30.0, "tilt_kgm2": 0.8, "slew_N": 60.0, "curve_battery_mV": 11300},
        {"thrust_max_N": 5.0, "heave_kg": 4.0, "tilt_kgm2": 0.03, "lag_s": 0.05, "curve_battery_mV": 12000},
    ],
    ids=["default", "light", "heavy", "strong", "small"],
)
def test_no_number_of_the_cycle_is_an_object_on_the_board(robot):
    """Noise, steps, saturation, a dead sensor; a spike of 3 cm or a push of 60 N is within."""
    _, _, control = fly("observer", Narrow, **robot)
    assert isinstance(control.law._state[0][0], Narrow) and isinstance(control._forces_uN[0], Narrow), "it was watched"


def test_the_watch_bites():
    with pytest.raises(AssertionError, match="__mul__"):
        Narrow(40_000) * 40_000
