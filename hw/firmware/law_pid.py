# The laws that the observer is compared with, in floats, and so 1 ms slower on the board. See law.py for what a law is.
#
# `pid`: per axis an integrator without windup, and a filtered derivative of the measurement.
#
# `pi`, Aucamp's own (arXiv 2506.09876, section 5): U = Kp e + Ki int e, e = Theta zeta - [4 z*, 0, 0], as it stands.
# Theta zeta = [4 depth, -4 s sin(roll) cos(pitch), -4 s sin(pitch)] with sensors at (+-s, +-s); the forces are a
# quarter of Theta's transpose times U. Thrust is signed, and nothing damps: with the lag of real thrusters it swings.
import math

H_S = 0.01  # a tick
SIGN = (-1, 1, 1)

# kp, ki, kd, Tf s, back-calculation 1/s; for depth in N and m, for roll and pitch in Nm and rad. The best of 700
# random sets on the tests' plant; they are not robust against another mass or lag.
GAINS = (
    ((135.0, 4.1, 46.0, 0.043, 1.85), (0.614, 0.011, 0.321, 0.012, 1.13)),  # 10 N, lag 0.10 s
    ((164.0, 9.5, 66.0, 0.019, 0.53), (0.552, 0.024, 0.452, 0.030, 1.46)),  # 5 N, lag 0.15 s
)

# N/m, N/(m s). The paper prints none; these are 4 and 1 for each kilogram that heaves. Of a grid from 2 to 32 and
# from 0.2 to 8 none is at rest 5 s after a push on the tests' plant.
KP, KI = 8.0, 2.0
SENSOR_HALF_M = 0.13
ARMS_M = (1.0, 0.06, 0.08)  # from U to force up, roll moment (the paper's b), pitch moment (its a)


class Pid:
    def __init__(self, gain_set=0):
        depth, tilt = GAINS[gain_set]
        self._gains = (depth, tilt, tilt)
        self._slow = [0.0] * 3  # filtered measurement, m or rad
        self._integral = [0.0] * 3  # N up, Nm
        self._asked = [0.0] * 3  # in the last cycle

    def reset(self, y):
        for i in range(3):
            self._slow[i] = y[i] * 1e-7
            self._integral[i] = self._asked[i] = 0.0

    def step(self, y, ref, realised, want, ticks=1):
        h_s = H_S * ticks
        for i in range(3):
            kp, ki, kd, filter_s, unwind = self._gains[i]
            rate = (y[i] * 1e-7 - self._slow[i]) / (h_s + filter_s)
            self._slow[i] += h_s * rate
            e = -SIGN[i] * (y[i] - ref[i]) * 1e-7
            self._integral[i] += h_s * (ki * e + unwind * (realised[i] * 1e-6 - self._asked[i]))
            self._asked[i] = kp * e + self._integral[i] - SIGN[i] * kd * rate
            if not -1000.0 < self._asked[i] < 1000.0:  # no number is neither
                raise ValueError("law diverged")
            want[i] = int(self._asked[i] * 1e6)

    def disturbance(self, i):
        """What the integrator holds against, uN down or uNm."""
        return int(-SIGN[i] * self._integral[i] * 1e6)


class Pi:
    def __init__(self):
        self._integral = [0.0] * 3

    def reset(self, y):
        for i in range(3):
            self._integral[i] = 0.0

    def step(self, y, ref, realised, want, ticks=1):
        s = -4.0 * SENSOR_HALF_M
        roll, pitch, ref_roll, ref_pitch = y[1] * 1e-7, y[2] * 1e-7, ref[1] * 1e-7, ref[2] * 1e-7
        e = (
            4.0 * (y[0] - ref[0]) * 1e-7,
            s * (math.sin(roll) * math.cos(pitch) - math.sin(ref_roll) * math.cos(ref_pitch)),
            s * (math.sin(pitch) - math.sin(ref_pitch)),
        )
        for i in range(3):
            self._integral[i] += H_S * ticks * e[i]
            asked = ARMS_M[i] * (KP * e[i] + KI * self._integral[i])
            if not -1000.0 < asked < 1000.0:  # no number is neither
                raise ValueError("law diverged")
            want[i] = int(asked * 1e6)

    def disturbance(self, i):
        """What the integrator holds against, uN down or uNm."""
        return int(-SIGN[i] * ARMS_M[i] * KI * self._integral[i] * 1e6)
