"""One thruster: pulse -> static curve with dead band -> first-order lag -> force."""

from __future__ import annotations

import math

import numpy as np

from hw.compiled import compiled

F_MAX_N = 10.0  # forward, at 1900 us: small thrusters; a T200 would be oversized for 4 kg

# Shape of the Blue Robotics T200 at 12 V (manufacturer's workbook of September 2019): dead band +-36 us, reverse
# 79 % of forward. The firmware inverts a curve of its own; they differ as a data sheet differs from a thruster.
DELTA_US = np.array([-400.0, -300.0, -200.0, -100.0, -36.0, 36.0, 100.0, 200.0, 300.0, 400.0])
THRUST_N = np.array([-28.6, -19.0, -10.0, -3.2, 0.0, 0.0, 4.0, 12.4, 24.0, 36.4]) * (F_MAX_N / 36.4)

STICTION_N = 0.05  # the rotor does not turn below this
NEUTRAL_US = 1500.0
THRUSTER_LAG_S = 0.10  # a value of one simulator, not a measurement; body.py spreads it


@compiled()
def static_thrust_n(pulse_us: float, neutral_us: float, gain: float) -> float:
    """Steady force in newtons; a pulse of 0 us is an ESC without signal, which stops."""
    if pulse_us <= 0.0:
        return 0.0
    delta = min(max(pulse_us - NEUTRAL_US - neutral_us, DELTA_US[0]), DELTA_US[-1])
    k = 1
    while delta > DELTA_US[k]:
        k += 1
    share = (delta - DELTA_US[k - 1]) / (DELTA_US[k] - DELTA_US[k - 1])
    force = gain * (THRUST_N[k - 1] + share * (THRUST_N[k] - THRUST_N[k - 1]))
    return float(force) if abs(force) >= STICTION_N else 0.0


@compiled()
def lagged_thrust_n(force_n: float, target_n: float, lag_s: float, dt_s: float) -> float:
    """Force after dt_s on the way to target_n, exact for a constant target."""
    return target_n + (force_n - target_n) * math.exp(-dt_s / lag_s)
