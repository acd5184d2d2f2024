# Depth, roll and pitch held by three independent controllers: what wrench the central thrusters shall give.
#
# Yaw and the horizontal position cannot be had from pressure; those the host drives, open loop.
# A law has reset(y), step(y, ref, realised, want, ticks) and disturbance(axis), for the axes depth, roll, pitch, in
# this order. y and ref: down in 100 nm, 100 nrad. want and realised: force up uN, roll and pitch moment uNm. ticks: of
# 10 ms, since the step before; where some were lost the pulses stood, and so did the wrench. A step raises ValueError
# where what the law believes is not of this world.
#
# This is the default law; law_pid.py and law_pi.py hold the two that it is compared with.
import math
import micropython
from micropython import const

_ABSURD = const(1 << 28)  # 84 m/s, 84 rad/s
H_S = 0.01  # a tick; all gains hold for this one alone
SIGN = (-1, 1, 1)  # what a positive wrench does to depth, roll, pitch


class Observer:
    """A fixed-gain observer of position, speed, actuator and disturbance, and feedback of its state.

    The disturbance takes the place of an integrator: it learns net weight and tether, and as it is driven by the
    wrench that was realised, it cannot wind up. Drag is that of a robot of 30 cm.

    Whole numbers, for on the board a float is an object. Positions are in 100 nm (nrad), speeds per tick and
    accelerations per tick and tick in 1/32 of that: so time and inertia are in the gains, and a tick is an addition.
    """

    def __init__(self, heave_kg=8.0, tilt_kgm2=0.075, lag_s=0.10):
        """Inertias with added mass; lag_s: first-order lag of thruster and ESC."""
        self._state = [[0] * 4 for _ in range(3)]  # position, speed, what the thrusters give by now, disturbance
        self._gains = [_whole_gains(i, (heave_kg, tilt_kgm2, tilt_kgm2)[i], lag_s) for i in range(3)]

    def reset(self, y):
        """Begin at rest at y, thrusters idle, nothing learnt."""
        for i in range(3):
            self._state[i][:] = (y[i], 0, 0, 0)

    def step(self, y, ref, realised, want, ticks=1):
        """Fill `want`, given measurement, reference and the wrench realised since the step before."""
        for i in range(3):
            want[i] = _step(self._state[i], self._gains[i], y[i], ref[i], realised[i], ticks)

    def disturbance(self, i):
        """What is pushing along axis i, uN down or uNm."""
        gains = self._gains[i]
        return self._state[i][3] * gains[2] >> gains[1]


def _whole_gains(i, inertia, lag_s):
    """The numbers of an axis as _step takes them.

    Gains and feedback are from a search on the twin's robots: mass +-20 % at lags of 0.10 and 0.15 s, then softened
    until robots of 0.58 of the mass with two samples of delay came to rest. The third gain of the observer forgets
    a disturbance that is gone in 0.3 s; at 4 it takes 2 s, and a robot that was pressed to the floor comes off it
    late.
    """
    linear, quadratic = ((3.0, 40.0), (0.03, 0.12))[i > 0]  # drag, N s/m and N s2/m2, in roll and pitch with Nm
    k1, k2 = ((38.0, 11.5), (30.0, 15.0))[i > 0]  # feedback of position and speed, 1/s2 and 1/s
    cap = (0.20, 0.23)[i > 0]  # m, rad: bounds the error in a big step, and so the speed
    l1, l2, l3 = 0.58, 9.0, 28.0  # of the innovation into position, speed and disturbance, a tick
    lead = 1.4  # makes up for the thrusters' lag
    unit_un = inertia * 1e-7 / 32.0 / (H_S * H_S) * 1e6  # the wrench of one unit of acceleration
    shift = 0
    while unit_un * (1 << shift) < 512.0:  # ten bits are exact enough, more would not fit beside the wrench
        shift += 1
    gains = (
        unit_un * (1 << shift),
        (1.0 - math.exp(-H_S / lag_s)) * 16384.0,
        linear * H_S / inertia * 65536.0,
        quadratic * 1e-7 / 32.0 / inertia * 65536.0 * 1024.0 * 256.0,
        k1 * H_S * H_S * 32.0 * 4096.0,
        k2 * H_S * 4096.0,
        cap * 1e7,
        l1 * 1024.0,
        l2 * H_S * 32.0 * 1024.0,
        l3 * H_S * H_S * 32.0 * 4096.0,
        lead * 1024.0,
        9.6e8 / (unit_un * (1 << shift)),  # beyond any thruster, and just what fits 31 bits
    )
    return (SIGN[i], shift) + tuple([int(gain + 0.5) for gain in gains])


@micropython.native
def _step(state, gains, y, ref, realised, ticks):
    """Predict and correct one axis; the wrench that it wants."""
    sign, shift, unit, decay, linear, quadratic, k1, k2, cap, l1, l2, l3, lead, most = gains
    p, v, a, d = state
    realised = ((realised << shift) + (unit >> 1)) // unit
    for _ in range(ticks):
        p += (v + 16) >> 5
        v += sign * a + d - ((v >> 4) * (linear + ((v if v >= 0 else -v) >> 10) * quadratic // 256) + 2048 >> 12)
        a += (realised - a + 2 >> 2) * decay + 2048 >> 12
    r = y - p
    p += r * l1 + 512 >> 10
    v += (r + 2 >> 2) * l2 + 128 >> 8
    d += r * l3 + 2048 >> 12
    state[0] = p
    state[1] = v
    state[2] = a
    state[3] = d
    if not -_ABSURD < v < _ABSURD:
        raise ValueError("law diverged")
    e = p - ref
    if e > cap:
        e = cap
    elif e < -cap:
        e = -cap
    drag = (v >> 4) * (linear + ((v if v >= 0 else -v) >> 10) * quadratic // 256) + 2048 >> 12
    want = sign * (drag - (k1 * e + 2048 >> 12) - ((v >> 2) * k2 + 512 >> 10) - d)
    want += (want - a + 2 >> 2) * lead + 128 >> 8
    if want > most:
        want = most
    elif want < -most:
        want = -most
    return want * unit + (1 << shift >> 1) >> shift
