# Depth, roll and pitch held by three independent controllers: what wrench the central thrusters shall give.
#
# Yaw and the horizontal position cannot be had from pressure; those the host drives, open loop.
# A law has reset(y), step(y, ref, realised, want) and disturbance(axis), for the axes depth, roll, pitch, in this
# order. y and ref: m down, rad, rad. want and realised: force up N, roll moment Nm, pitch moment Nm.
import math

H_S = 0.01  # control cycle; all gains hold for this one alone
SIGN = (-1, 1, 1)  # what a positive wrench does to depth, roll, pitch


class Observer:
    """The default law: a fixed-gain observer of position, speed, actuator and disturbance, and feedback of its state.

    The disturbance takes the place of an integrator: it learns net weight and tether, and as it is driven by the
    wrench that was realised, it cannot wind up. Drag is that of a robot of 30 cm.
    """

    # Gains per cycle and feedback are from a search on the twin's robots: mass +-20 % at lags of 0.10 and 0.15 s, then
    # softened until robots of 0.58 of the mass with two samples of delay came to rest. L3 forgets a disturbance that
    # is gone in 0.3 s; at 4 it takes 2 s, and a robot that was pressed to the floor comes off it late.
    L1, L2, L3 = 0.58, 9.0, 28.0
    K_LEAD = 1.4  # makes up for the thrusters' lag

    LINEAR = (3.0, 0.03, 0.03)  # drag, N s/m, N m s
    QUADRATIC = (40.0, 0.12, 0.12)  # N s2/m2, N m s2
    K1 = (38.0, 30.0, 30.0)  # feedback of position, 1/s2
    K2 = (11.5, 15.0, 15.0)  # of speed, 1/s
    ERROR_CAP = (0.20, 0.23, 0.23)  # bounds the error in a big step, and so the speed

    def __init__(self, heave_kg=8.0, tilt_kgm2=0.075, lag_s=0.10):
        """Inertias with added mass; lag_s: first-order lag of thruster and ESC."""
        self._inertia = (heave_kg, tilt_kgm2, tilt_kgm2)
        self._decay = 1.0 - math.exp(-H_S / lag_s)
        self._p = [0.0] * 3  # believed position
        self._v = [0.0] * 3  # speed
        self._a = [0.0] * 3  # wrench that the thrusters give by now
        self._d = [0.0] * 3  # disturbance, N down or Nm

    def reset(self, y):
        """Begin at rest at y, thrusters idle, nothing learnt."""
        for i in range(3):
            self._p[i] = y[i]
            self._v[i] = self._a[i] = self._d[i] = 0.0

    def step(self, y, ref, realised, want):
        """Fill `want`, given measurement, reference and the wrench realised in the last cycle."""
        for i in range(3):
            want[i] = self._axis(i, y[i], ref[i], realised[i])

    def _axis(self, i, y, ref, realised):
        sign, m, v, a, d = SIGN[i], self._inertia[i], self._v[i], self._a[i], self._d[i]
        linear, quadratic, cap = self.LINEAR[i], self.QUADRATIC[i], self.ERROR_CAP[i]
        p = self._p[i] + H_S * v
        v += H_S * (sign * a + d - (linear + quadratic * abs(v)) * v) / m
        a += (realised - a) * self._decay
        r = y - p
        p += self.L1 * r
        v += self.L2 * r
        d += self.L3 * m * r
        self._p[i], self._v[i], self._a[i], self._d[i] = p, v, a, d
        e = max(-cap, min(cap, p - ref))
        want = sign * ((linear + quadratic * abs(v)) * v - m * (self.K1[i] * e + self.K2[i] * v) - d)
        return want + self.K_LEAD * (want - a)

    def disturbance(self, i):
        """What is pushing along axis i, uN down or uNm."""
        return int(round(1e6 * self._d[i]))


class Pid:
    """Per axis: integrator without windup, and a filtered derivative of the measurement."""

    # kp, ki, kd, Tf s, back-calculation 1/s; for depth in N and m, for roll and pitch in Nm and rad. The best of 700
    # random sets on the tests' plant; they are not robust against another mass or lag.
    GAINS = (
        ((135.0, 4.1, 46.0, 0.043, 1.85), (0.614, 0.011, 0.321, 0.012, 1.13)),  # 10 N, lag 0.10 s
        ((164.0, 9.5, 66.0, 0.019, 0.53), (0.552, 0.024, 0.452, 0.030, 1.46)),  # 5 N, lag 0.15 s
    )

    def __init__(self, gain_set=0):
        depth, tilt = self.GAINS[gain_set]
        self._gains = (depth, tilt, tilt)
        self._slow = [0.0] * 3  # filtered measurement
        self._integral = [0.0] * 3  # N up, Nm
        self._asked = [0.0] * 3  # in the last cycle

    def reset(self, y):
        for i in range(3):
            self._slow[i] = y[i]
            self._integral[i] = self._asked[i] = 0.0

    def step(self, y, ref, realised, want):
        for i in range(3):
            kp, ki, kd, filter_s, unwind = self._gains[i]
            rate = (y[i] - self._slow[i]) / (H_S + filter_s)
            self._slow[i] += H_S * rate
            e = -SIGN[i] * (y[i] - ref[i])
            self._integral[i] += H_S * (ki * e + unwind * (realised[i] - self._asked[i]))
            self._asked[i] = want[i] = kp * e + self._integral[i] - SIGN[i] * kd * rate

    def disturbance(self, i):
        """What the integrator holds against, uN down or uNm."""
        return int(round(-1e6 * SIGN[i] * self._integral[i]))


class Pi:
    """Aucamp's own law (arXiv 2506.09876, section 5): U = Kp e + Ki int e, e = Theta zeta - [4 z*, 0, 0], as it stands.

    Theta zeta = [4 depth, -4 s sin(roll) cos(pitch), -4 s sin(pitch)] with sensors at (+-s, +-s); the forces are a
    quarter of Theta's transpose times U. Thrust is signed, and nothing damps: with the lag of real thrusters it swings.
    """

    # N/m, N/(m s). The paper prints none; these are 4 and 1 for each kilogram that heaves. Of a grid from 2 to 32 and
    # from 0.2 to 8 none is at rest 5 s after a push on the tests' plant.
    KP, KI = 8.0, 2.0
    SENSOR_HALF_M = 0.13
    ARMS_M = (1.0, 0.06, 0.08)  # from U to force up, roll moment (the paper's b), pitch moment (its a)

    def __init__(self):
        self._integral = [0.0] * 3

    def reset(self, y):
        for i in range(3):
            self._integral[i] = 0.0

    def step(self, y, ref, realised, want):
        s = -4.0 * self.SENSOR_HALF_M
        self._row(0, 4.0 * (y[0] - ref[0]), want)
        self._row(1, s * (math.sin(y[1]) * math.cos(y[2]) - math.sin(ref[1]) * math.cos(ref[2])), want)
        self._row(2, s * (math.sin(y[2]) - math.sin(ref[2])), want)

    def _row(self, i, e, want):
        self._integral[i] += H_S * e
        want[i] = self.ARMS_M[i] * (self.KP * e + self.KI * self._integral[i])

    def disturbance(self, i):
        """What the integrator holds against, uN down or uNm."""
        return int(round(-1e6 * SIGN[i] * self.ARMS_M[i] * self.KI * self._integral[i]))
