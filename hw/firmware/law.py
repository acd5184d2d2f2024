# Depth, roll and pitch held by three independent controllers: what wrench the central thrusters shall give.
#
# Yaw and the horizontal position cannot be had from pressure; those the host drives, open loop.
# A law has reset(y), step(y, ref, realised, want, ticks) and disturbance(axis), for the axes depth, roll, pitch, in
# this order. y and ref: down in 100 nm, 100 nrad. want and realised: force up uN, roll and pitch moment uNm. ticks: of
# 10 ms, since the step before; where some were lost the pulses stood, and so did the wrench. A step raises ValueError
# where what the law believes is not of this world.
#
# This is the default law; law_pid.py holds the two that it is compared with.
from micropython import const

_ABSURD = const(1 << 28)  # 84 m/s, 84 rad/s


class Observer:
    """A fixed-gain observer of position, speed, actuator and disturbance, and feedback of its state.

    The disturbance takes the place of an integrator: it learns net weight and tether, and as it is driven by the
    wrench that was realised, it cannot wind up. Drag is that of a robot of 30 cm.

    Whole numbers, for on the board a float is an object. Positions are in 100 nm (nrad), speeds per tick and
    accelerations per tick and tick in 1/32 of that: so time and inertia are in the gains, and a tick is an addition.
    """

    def __init__(self, gains):
        """gains: of gains.observer()."""
        # position, speed, what the thrusters give by now, disturbance; of position what is no whole number, in 1/32
        self._state = [[0] * 5 for _ in range(3)]
        self._gains = gains

    def reset(self, y):
        """Begin at rest at y, thrusters idle, nothing learnt."""
        for i in range(3):
            self._state[i][:] = (y[i], 0, 0, 0, 0)

    def step(self, y, ref, realised, want, ticks=1):
        """Fill `want`, given measurement, reference and the wrench realised since the step before."""
        for i in range(3):
            want[i] = _step(self._state[i], self._gains[i], y[i], ref[i], realised[i], ticks)

    def disturbance(self, i):
        """What is pushing along axis i, uN down or uNm."""
        gains = self._gains[i]
        return self._state[i][3] * gains[2] >> gains[1]


def _step(state, gains, y, ref, realised, ticks):
    """Predict and correct one axis; the wrench that it wants.

    In SI units, with a tick H and the gains of gains.py (shifts round, and keep products within 31 bits):

        p += H v;  v += H (sign a + d - drag(v)) / m;  a += (realised - a) (1 - exp(-H / lag))
        r = y - p;  p += L1 r;  v += L2 r;  d += L3 m r
        want = sign (drag(v) - m (K1 clip(p - ref) + K2 v) - d);  want += LEAD (want - a)
    """
    sign, shift, unit, decay, linear, quadratic, k1, k2, cap, l1, l2, l3, lead, most = gains
    p, v, a, d, rest = state
    realised = ((realised << shift) + (unit >> 1)) // unit
    for _ in range(ticks):
        rest += v
        p += rest >> 5
        rest &= 31
        v += sign * a + d - ((v >> 6) * (linear + ((v if v >= 0 else -v) >> 10) * quadratic // 256) + 512 >> 10)
        a += (realised - a + 2 >> 2) * decay + 2048 >> 12
    r = y - p
    rest += r * l1 + 64 >> 7
    p += rest >> 5
    v += r * l2 + 128 >> 8
    d += r * l3 + 2048 >> 12
    state[0] = p
    state[1] = v
    state[2] = a
    state[3] = d
    state[4] = rest & 31
    if not -_ABSURD < v < _ABSURD:
        raise ValueError("law diverged")
    e = p - ref
    if e > cap:
        e = cap
    elif e < -cap:
        e = -cap
    drag = (v >> 6) * (linear + ((v if v >= 0 else -v) >> 10) * quadratic // 256) + 512 >> 10
    want = sign * (drag - ((e + 2 >> 2) * k1 + 1024 >> 11) - ((v >> 2) * k2 + 512 >> 10) - d)
    want += (want - a + 2 >> 2) * lead + 128 >> 8
    if want > most:
        want = most
    elif want < -most:
        want = -most
    return want * unit + (1 << shift >> 1) >> shift
