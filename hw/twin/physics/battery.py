"""The pack of each robot: its voltage falls with the current that the thrusters draw, and their thrust with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

OPEN_V = 14.92  # four cells half way down, without load
OHM = 0.08  # pack, leads and plugs together; assumed
IDLE_A = 1.5  # electronics, camera and servos; assumed
A_PER_N = 0.45  # Blue Robotics T200 at 12 V: 17 A at 36.4 N (manufacturer's workbook of September 2019, from memory)

NOMINAL_V = OPEN_V - OHM * IDLE_A  # 14.8: at this supply thruster.THRUST_N holds
THRUST_EXPONENT = 1.2  # the T200's full thrust of 36.4 N at 12 V and 51.4 N at 16 V


def current_a(thrust_n: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) amperes for the thrust (n, 8) of all thrusters, either way alike."""
    return np.asarray(IDLE_A + A_PER_N * np.abs(thrust_n).sum(axis=1))


def supply_v(open_v: NDArray[np.float64], drawn_a: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) volts at the board for the open-circuit voltage (n,) and the current (n,)."""
    return np.asarray(np.maximum(open_v - OHM * drawn_a, 0.0))


def thrust_loss(volts: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) share of the thrust at NOMINAL_V that is missing; negative for a fuller pack."""
    return np.asarray(1.0 - (volts / NOMINAL_V) ** THRUST_EXPONENT)
