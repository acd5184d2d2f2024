# Four pressures -> depth, roll, pitch of the plane through the sensors, and which sensor cannot be believed.
#
# Sensors and central thrusters share their numbering: 1 (+x,+y), 2 (-x,+y), 3 (-x,-y), 4 (+x,-y), with x forward,
# y left, z up. Depth is positive down, a positive roll lifts the left side, a positive pitch lowers the nose:
#   zeta_k = depth + x_k sin(pitch) - y_k sin(roll) cos(pitch)      (Aucamp, arXiv 2506.09876, the rows of Theta)
import math

LOWEST_PA, HIGHEST_PA = 30000.0, 120000.0  # what an MS5837-02BA can say, 300 to 1200 mbar (data sheet)
ABOVE_WATER_M = 0.10  # higher than this above the surface is no place of a submerged robot (ArduPilot issue 9837)
BAD_AFTER = 5  # faulty readings in a row (50 ms); below that the last good one stands in
GOOD_AFTER = 100  # good readings in a row (1 s)
SPIKE_M = 0.05  # a sensor that leaves the plane of the others by more within a cycle is doubted, for BAD_AFTER cycles
STUCK_AFTER_US = 5000000  # the same reading for so long is a fault only while the others move (ArduPilot issue 30854)
MOVING_US = 1000000
PARITY_LIMIT_M = 0.020
PARITY_FOR_US = 500000


class Plane:
    """The plane through the four sensors, followed from cycle to cycle."""

    def __init__(self, pa_per_m, half_x_m, half_y_m):
        self.pa_per_m = pa_per_m  # pressure of a metre of this water
        self.tare_mPa = None  # absolute pressure of each sensor in air, before the dive
        self.zeta_100nm = [0] * 4
        self.depth_100nm = self.roll_100nrad = self.pitch_100nrad = 0
        self.zeta_m = [0.0] * 4  # depth of each sensor below its tare
        self.depth_m = self.roll_rad = self.pitch_rad = 0.0
        self.parity_m = 0.0  # zeta1 - zeta2 + zeta3 - zeta4, 0 for a plane; smoothed over 0.2 s
        self.bad = 0  # bit mask of sensors not believed
        self.bad_count = 0
        self.disagree = False  # one of them is wrong and nobody knows which
        self._half_x_m = half_x_m
        self._half_y_m = half_y_m
        self._last_pa = [0.0] * 4
        self._same_us = [0] * 4
        self._faults = [BAD_AFTER] * 4  # a sensor is bad until it has spoken
        self._goods = [GOOD_AFTER - 1] * 4
        self._new_m = [0.0] * 4
        self._spikes = 0  # cycles in a row
        self._parity_us = 0

    @property
    def tare_pa(self):
        return None if self.tare_mPa is None else [mPa / 1000 for mPa in self.tare_mPa]

    @tare_pa.setter
    def tare_pa(self, tare_pa):
        self.tare_mPa = None if tare_pa is None else [int(round(1000.0 * pa)) for pa in tare_pa]

    def step(self, raw_pa, answered, dt_us):
        """Take absolute pressures in Pa; `answered` is the bit mask of sensors that were there."""
        for k in range(4):
            tare = 101325.0 if self.tare_mPa is None else self.tare_mPa[k] / 1000
            self._new_m[k] = (raw_pa[k] - tare) / self.pa_per_m
        spike = self._spike()
        for k in range(4):
            self._follow(k, raw_pa[k], answered >> k & 1 and k != spike, dt_us)
        self.bad = self.bad_count = 0
        for k in range(4):
            if self._faults[k] >= BAD_AFTER:
                self.bad |= 1 << k
                self.bad_count += 1
        z = self.zeta_m
        if self.bad_count == 1:
            for k in range(4):
                if self.bad >> k & 1:  # neighbours minus the opposite corner
                    z[k] = z[(k + 1) & 3] + z[(k + 3) & 3] - z[(k + 2) & 3]
        self.parity_m += 0.05 * (z[0] - z[1] + z[2] - z[3] - self.parity_m)
        self._parity_us = self._parity_us + dt_us if abs(self.parity_m) > PARITY_LIMIT_M else 0
        self.disagree = self._parity_us >= PARITY_FOR_US
        self.depth_m = 0.25 * (z[0] + z[1] + z[2] + z[3])
        self.pitch_rad = -_asin(0.25 * (-z[0] + z[1] + z[2] - z[3]) / self._half_x_m)
        self.roll_rad = -_asin(0.25 * (z[0] + z[1] - z[2] - z[3]) / (self._half_y_m * math.cos(self.pitch_rad)))
        self.zeta_100nm = [int(round(zeta * 1e7)) for zeta in z]
        self.depth_100nm = int(round(self.depth_m * 1e7))
        self.roll_100nrad = int(round(self.roll_rad * 1e7))
        self.pitch_100nrad = int(round(self.pitch_rad * 1e7))

    def _spike(self):
        """The sensor that has leapt out of the plane just now, or -1. One that stays out is for parity to judge."""
        z, new = self.zeta_m, self._new_m
        leap = new[0] - z[0] - new[1] + z[1] + new[2] - z[2] - new[3] + z[3]
        if self.bad_count or not abs(leap) > SPIKE_M:
            self._spikes = 0
            return -1
        self._spikes += 1
        if self._spikes >= BAD_AFTER:
            return -1
        worst = 0
        for k in range(1, 4):
            if abs(new[k] - z[k]) > abs(new[worst] - z[worst]):
                worst = k
        return worst

    def _follow(self, k, pa, answered, dt_us):
        zeta = self._new_m[k]
        if pa == self._last_pa[k]:
            self._same_us[k] = min(self._same_us[k] + dt_us, STUCK_AFTER_US)
        else:
            self._same_us[k] = 0
        self._last_pa[k] = pa
        if answered and LOWEST_PA < pa < HIGHEST_PA and zeta > -ABOVE_WATER_M and not self._stuck(k):
            self._goods[k] += 1
            if self._faults[k] < BAD_AFTER or self._goods[k] >= GOOD_AFTER:
                self._faults[k] = 0
            self.zeta_m[k] = zeta
        else:
            self._goods[k] = 0
            self._faults[k] = min(self._faults[k] + 1, BAD_AFTER)

    def _stuck(self, k):
        if self._same_us[k] < STUCK_AFTER_US:
            return False
        for other in range(4):
            if other != k and self._same_us[other] > MOVING_US:
                return False
        return True


def _asin(x):
    return math.asin(max(-1.0, min(1.0, x)))
