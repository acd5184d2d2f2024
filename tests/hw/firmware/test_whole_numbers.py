"""The steady cycle in whole numbers: it is the law that it was in floats, and it keeps within the board's 31 bits."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from hw.firmware import gains, law
from tests.hw.firmware.bare_board import firmware_main
from tests.hw.firmware.float_law import FloatObserver, recorded

AIR_mPa = 101_325_000
CYCLE_US = 10_000
DEAD_BAND_US = 30  # from neutral: no propeller turns within
LIMITS = np.array([40_000_000, 2_000_000, 2_500_000])  # uN, uNm: about what the thrusters can
NEUTRAL_US = np.array([1500, 1500, 1507, 1500, 1500, 1500, 1500, 1500])


def modules() -> tuple[ModuleType, ModuleType]:
    return firmware_main().motor_control, importlib.import_module("parameters")


def armed(name: str, first: list[int], **flash: float) -> Any:
    """Control with the motors on, in front of these pressures."""
    motor_control, parameters = modules()
    control = motor_control.Control()
    control.configure(parameters.from_flash({"law": name, "net_weight_N": 0.5, "zero_3_us": 1507, **flash}))
    control.plane.tare_mPa = [AIR_mPa] * 4
    for _ in range(10):
        control.sense(first, 15, 15000, 0, CYCLE_US)
    control.arm()
    return control


def fly(name: str, number: type[int] = int, **flash: float) -> tuple[np.ndarray, np.ndarray, Any]:
    """Pulses of the recorded dive now and in floats, (1000, 8) each, and the control after it."""
    cycles = list(recorded(name))
    control = armed(name, [number(p) for p in cycles[0].pressure_mPa], **flash)
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
    """To a microsecond, where a propeller turns.

    Inside the dead band, which is crossed at 0.7 mN a microsecond, the observer may be 10 us off: a recording does not
    answer, so that what the thrusters give and what the water gives cannot be told apart, and the roundings of ten
    seconds add up in the difference, to 16 mN. In water they do not: test_law_on_plant.py.
    """
    now, floats, _ = fly(name)
    off = np.abs(now - floats)
    turns = np.abs(floats - NEUTRAL_US) > DEAD_BAND_US
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
