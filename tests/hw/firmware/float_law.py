"""The default law in floats and SI units, as its equations stand: what the board's whole numbers are compared with.

And ten seconds under each law that were recorded when the firmware still worked in floats: float_law.npz.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

H_S = 0.01
SIGN = (-1, 1, 1)
RECORDED = Path(__file__).with_name("float_law.npz")


class FloatObserver:
    """Observer and feedback of law.Observer, for m, rad, N and Nm."""

    LINEAR, QUADRATIC = (3.0, 0.03, 0.03), (40.0, 0.12, 0.12)
    K1, K2, CAP = (33.0, 50.0, 50.0), (11.23, 20.8, 20.8), (0.20, 0.23, 0.23)
    L1, L2, L3 = (0.1001, 0.1719, 0.1719), (14.795, 12.598, 12.598), (26.55, 44.7, 44.7)
    LEAD = (0.875, 1.3, 1.3)
    LIGHTER = 0.64  # in tilt

    def __init__(self, heave_kg: float = 8.0, tilt_kgm2: float = 0.075, lag_s: float = 0.10) -> None:
        self.inertia = (heave_kg, self.LIGHTER * tilt_kgm2, self.LIGHTER * tilt_kgm2)
        self.decay = 1.0 - math.exp(-H_S / lag_s)
        self.state = np.zeros((3, 4))  # position, speed, wrench that the thrusters give, disturbance

    def reset(self, y: list[float]) -> None:
        self.state[:] = 0.0
        self.state[:, 0] = y

    def step(self, y: list[float], ref: list[float], realised: list[float]) -> list[float]:
        return [self._axis(i, y[i], ref[i], realised[i]) for i in range(3)]

    def _axis(self, i: int, y: float, ref: float, realised: float) -> float:
        m, (p, v, a, d) = self.inertia[i], self.state[i]

        def drag(speed: float) -> float:
            return (self.LINEAR[i] + self.QUADRATIC[i] * abs(speed)) * speed

        p, v = p + H_S * v, v + H_S * (SIGN[i] * a + d - drag(v)) / m
        a += (realised - a) * self.decay
        r = y - p
        p, v, d = p + self.L1[i] * r, v + self.L2[i] * r, d + self.L3[i] * m * r
        self.state[i] = p, v, a, d
        e = max(-self.CAP[i], min(self.CAP[i], p - ref))
        want = SIGN[i] * (drag(v) - m * (self.K1[i] * e + self.K2[i] * v) - d)
        return float(want + self.LEAD[i] * (want - a))

    def terms(self, i: int, ref: float) -> float:
        """Sum of the sizes of what the wrench is the sum of."""
        m, (_, v, a, d) = self.inertia[i], np.abs(self.state[i])
        e = min(self.CAP[i], abs(self.state[i, 0] - ref))
        drag = (self.LINEAR[i] + self.QUADRATIC[i] * v) * v
        return float((1.0 + self.LEAD[i]) * (drag + m * (self.K1[i] * e + self.K2[i] * v) + d) + self.LEAD[i] * a)


class InFloats(FloatObserver):
    """The same in the units of law.Observer, whose place it takes in a control."""

    def reset(self, y: list[int]) -> None:
        super().reset([1e-7 * one for one in y])

    def step(self, y: list[int], ref: list[int], realised: list[int], want: list[int], ticks: int = 1) -> None:
        assert ticks == 1
        metres, newtons = ([1e-7 * one for one in row] for row in (y, ref)), [1e-6 * one for one in realised]
        want[:] = [round(1e6 * one) for one in super().step(*metres, newtons)]

    def disturbance(self, i: int) -> int:
        return round(1e6 * float(self.state[i, 3]))


class Cycle(NamedTuple):
    """One of the recorded 1000 of a law: what control was given, and the pulses that it gave in floats."""

    pressure_mPa: list[int]
    answered: int
    depth_100nm: int
    roll_100nrad: int
    pulses_us: list[int]


def recorded(law: str) -> Iterator[Cycle]:
    """Noise, a step of depth and one of roll, a push beyond what the thrusters can, a spike, a dead sensor.

    The robot has net_weight_N 0.5, zero_3_us 1507, air of 101325 Pa and 14.6 V (15.0 V before the first cycle).
    """
    with np.load(RECORDED) as data:
        columns = [
            data[name].tolist()
            for name in (f"pressure_mPa_{law}", "answered", "depth_100nm", "roll_100nrad", f"pulses_us_{law}")
        ]
    return (Cycle(*row) for row in zip(*columns, strict=True))
