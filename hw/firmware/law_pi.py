# The law `pi`, Aucamp's own (arXiv 2506.09876, section 5): U = Kp e + Ki int e, e = Theta zeta - [4 z*, 0, 0], as it
# stands. See law.py for what a law offers.
#
# Theta zeta = [4 depth, -4 s sin(roll) cos(pitch), -4 s sin(pitch)] with sensors at (+-s, +-s); the forces are a
# quarter of Theta's transpose times U. Thrust is signed, and nothing damps: with the lag of real thrusters it swings.
# In floats: it is there to be compared with.
import math

H_S = 0.01  # a tick
SIGN = (-1, 1, 1)

# N/m, N/(m s). The paper prints none; these are 4 and 1 for each kilogram that heaves. Of a grid from 2 to 32 and
# from 0.2 to 8 none is at rest 5 s after a push on the tests' plant.
KP, KI = 8.0, 2.0
SENSOR_HALF_M = 0.13
ARMS_M = (1.0, 0.06, 0.08)  # from U to force up, roll moment (the paper's b), pitch moment (its a)


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
