# Depth, roll and pitch held by three independent controllers: what wrench the central thrusters shall give.
#
# Yaw and the horizontal position cannot be had from pressure; those the host drives, open loop.
# A law has reset(y), step(y, ref, realised, want) and disturbance(axis), for the axes depth, roll, pitch, in this
# order. y and ref: m down, rad, rad. want and realised: force up N, roll moment Nm, pitch moment Nm.
import math

H_S = 0.01  # control cycle; the observer's gains hold for this one alone


class Axis:
    """Fixed-gain observer of position, speed, actuator and disturbance, and the feedback of its state.

    The disturbance takes the place of an integrator: it learns net weight and tether, and as it is driven by the
    wrench that was realised, it cannot wind up.
    """

    # Observer gains per cycle, from tuning on the plant that the tests carry. L3 forgets a disturbance that is gone in
    # 0.4 s; at 4 it takes 2 s, and a robot that was pressed to the floor comes off it late.
    L1, L2, L3 = 0.49, 8.1, 20.0
    K_LEAD = 0.85  # makes up for the thrusters' lag
    LAG_S = 0.10  # first-order lag of thruster and ESC

    def __init__(self, sign, inertia, linear, quadratic, k1, k2, error_cap):
        """sign: what a positive wrench does to the position; inertia kg or kg m2, with added mass; drag linear and
        quadratic; k1 1/s2 and k2 1/s feedback; error_cap bounds the error in a big step and so the speed."""
        self._sign = sign
        self._inertia = inertia
        self._linear = linear / inertia
        self._quadratic = quadratic / inertia
        self._k1 = k1
        self._k2 = k2
        self._error_cap = error_cap
        self._decay = 1.0 - math.exp(-H_S / self.LAG_S)
        self.reset(0.0)

    def reset(self, y):
        """At rest at y, actuator idle, nothing learnt."""
        self._p = y
        self._v = self._a = self.d = 0.0

    def step(self, y, ref, realised):
        """The wrench to ask for, given the measured position and the wrench realised in the last cycle."""
        sign, inertia, v = self._sign, self._inertia, self._v
        drag = self._linear * v + self._quadratic * v * abs(v)
        p = self._p + H_S * v
        v += H_S * ((sign * self._a + self.d) / inertia - drag)
        self._a += (realised - self._a) * self._decay
        r = y - p
        self._p = p = p + self.L1 * r
        self._v = v = v + self.L2 * r
        self.d += self.L3 * inertia * r
        e = max(-self._error_cap, min(self._error_cap, p - ref))
        drag = self._linear * v + self._quadratic * v * abs(v)
        want = sign * (inertia * (drag - self._k1 * e - self._k2 * v) - self.d)
        return want + self.K_LEAD * (want - self._a)


class Observer:
    """The default law. Inertia and drag are those of a 4 kg robot of 30 cm, added mass included."""

    def __init__(self):
        self._axes = (
            Axis(-1, 8.0, 3.0, 40.0, 35.0, 10.8, 0.20),
            Axis(1, 0.075, 0.03, 0.12, 30.0, 10.0, 0.23),
            Axis(1, 0.075, 0.03, 0.12, 30.0, 10.0, 0.23),
        )

    def reset(self, y):
        for i in range(3):
            self._axes[i].reset(y[i])

    def step(self, y, ref, realised, want):
        """Fill `want`, all four lists of three as at the top of this file."""
        for i in range(3):
            want[i] = self._axes[i].step(y[i], ref[i], realised[i])

    def disturbance(self, i):
        """What is pushing along axis i, N down or Nm."""
        return self._axes[i].d


LAWS = {"observer": Observer}


def choose(name):
    """The law of this name; ValueError names those that there are."""
    if name not in LAWS:
        raise ValueError("law '%s' is not known, write one of: %s" % (name, " ".join(LAWS)))
    return LAWS[name]()
