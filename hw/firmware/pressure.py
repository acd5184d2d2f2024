# Four pressures -> depth, roll, pitch of the plane through the sensors, and which sensor cannot be believed.
#
# Sensors and central thrusters share their numbering: 1 (+x,+y), 2 (-x,+y), 3 (-x,-y), 4 (+x,-y), with x forward,
# y left, z up. Depth is positive down, a positive roll lifts the left side, a positive pitch lowers the nose:
#   zeta_k = depth + x_k sin(pitch) - y_k sin(roll) cos(pitch)      (Aucamp, arXiv 2506.09876, the rows of Theta)
#
# Whole numbers: pressures in mPa, depths in 100 nm (1 mPa is 102 nm of fresh water), angles in 100 nrad.
import math
from micropython import const

_SENSOR_HALF_MM = const(130)  # sensors sit at (+-130, +-130) mm
_LOWEST_mPa = const(30000000)  # what an MS5837-02BA can say, 300 to 1200 mbar (data sheet)
_HIGHEST_mPa = const(120000000)
_ABOVE_WATER_100nm = const(1000000)  # higher is no place of a submerged robot (ArduPilot issue 9837)
_BAD_AFTER = const(5)  # faulty readings in a row (50 ms); below that the last good one stands in
_GOOD_AFTER = const(100)  # good readings in a row (1 s)
_SPIKE_100nm = const(500000)  # who leaves the others' plane by more in a cycle is doubted, for _BAD_AFTER cycles
# A sensor that measures is never still: its noise is some 50 of the converter's steps, which are 0.044 Pa. One that is
# while another moves has frozen; where all are, they have together, and nothing that moves is needed to tell. Fifteen
# readings are enough, and on its way to another depth a robot that goes by frozen ones for a second turns over.
_STEP_mPa = const(50)
_STUCK_AFTER_US = const(300000)
_ALL_STUCK_AFTER_US = const(600000)
_PARITY_LIMIT_100nm = const(200000)
_PARITY_FOR_US = const(500000)
# Zeros drift as sensors warm up, by millimetres in ten minutes. Parity that grows so slowly is followed and is no
# fault; one that leaps stays, for it is not within _DRIFTS_100nm of what was followed.
_DRIFTS_100nm = const(50000)
_DRIFT_CYCLES = const(2048)  # time constant, 20 s: at 3 mm a minute it is a millimetre behind
_MOST_DRIFT = const(614400000)  # 30 mm, times _DRIFT_CYCLES
_STANDARD_AIR_mPa = const(101325000)
# Gravity, where there is an accelerometer: what it says of the robot's axis, and how far it and the sensors may differ.
_UPSIDE_DOWN_MG = const(-300)
_UPSIDE_DOWN_LOOKS = const(3)  # of 0.1 s
_LEAN_MG = const(130)  # 7.5 degrees
_LEAN_LOOKS = const(15)
# 58 degrees from upright, whichever way: the square of its sine, in 2**-9 of 1e-7. What goes over passes here, for the
# sensors show 122 as 58 and 180 as 0.
_OVER = const(274300000)
_STEEP = const(5990000)  # below it in both, it is not over
_SERIES = const(4200000)  # up to 25 degrees asin and 1/cos are the first terms of their series


class Plane:
    """The plane through the four sensors, followed from cycle to cycle."""

    def __init__(self, pa_per_m):
        self.set_water(pa_per_m)
        self.tare_mPa = None  # absolute pressure of each sensor in air, before the dive
        self.zeta_100nm = [0] * 4  # depth of each sensor below its tare
        self.depth_100nm = self.roll_100nrad = self.pitch_100nrad = 0
        self.parity_100nm = 0  # zeta1 - zeta2 + zeta3 - zeta4 beyond drift, 0 for a plane; smoothed over 0.2 s
        self._drift = 0  # of it, in 100 nm / _DRIFT_CYCLES
        self.bad = 0  # bit mask of sensors not believed
        self.bad_count = 0
        self.over = False  # it lies on its side, or worse
        self.disagree = False  # one of them is wrong and nobody knows which
        self.upside_down = self.leans = False  # by gravity, where there is an accelerometer
        self._upside, self._leaning = 0, 0  # looks in a row
        self.still = False  # all that are believed stand still
        self._stands_mPa = [0] * 4  # where a sensor stands still
        self._still_us = [0] * 4  # for how long
        self._faults = [_BAD_AFTER] * 4  # a sensor is bad until it has spoken
        self._goods = [_GOOD_AFTER - 1] * 4
        self._new_100nm = [0] * 4
        self._spikes = 0  # cycles in a row
        self._parity_us = 0

    def set_water(self, pa_per_m):
        """Pressure of a metre of this water."""
        self.pa_per_m = pa_per_m
        self._over = int((1e4 / pa_per_m - 1.0) * 65536.0 + 0.5)  # 100 nm that a mPa is more than one, in 1/65536

    def set_tare(self, tare_mPa):
        """New zeros, from which nothing has drifted yet."""
        self.tare_mPa = tare_mPa
        self._drift = 0

    def step(self, raw_mPa, answered, dt_us):
        """Take absolute pressures; `answered` is the bit mask of sensors that were there."""
        self._measure(raw_mPa)
        spike = self._spike()
        answered &= ~self._stuck(raw_mPa, dt_us)
        self.bad = self.bad_count = 0
        for k in range(4):
            self._follow(k, raw_mPa[k], answered >> k & 1 and k != spike)
            if self._faults[k] >= _BAD_AFTER:
                self.bad |= 1 << k
                self.bad_count += 1
        z = self.zeta_100nm
        if self.bad_count == 1:
            for k in range(4):
                if self.bad >> k & 1:  # neighbours minus the opposite corner, with what they have drifted
                    drift = self._drift // _DRIFT_CYCLES
                    z[k] = z[(k + 1) & 3] + z[(k + 3) & 3] - z[(k + 2) & 3] + (-drift if k & 1 else drift)
        self._tilt(dt_us)

    def feel(self, up_mg, level_mg):
        """Compare with gravity, ten times a second: thousandths of it along the robot's own axis, and across."""
        self._upside = self._upside + 1 if up_mg < _UPSIDE_DOWN_MG else 0
        self.upside_down = self._upside >= _UPSIDE_DOWN_LOOKS
        roll, pitch = self.roll_100nrad // 10000, self.pitch_100nrad // 10000
        off = level_mg - int(math.sqrt(roll * roll + pitch * pitch))
        self._leaning = 0 if -_LEAN_MG < off < _LEAN_MG else self._leaning + 1
        self.leans = self._leaning >= _LEAN_LOOKS

    def _measure(self, raw_mPa):
        """The depths that the sensors say."""
        tare, new, over = self.tare_mPa, self._new_100nm, self._over
        for k in range(4):
            water_mPa = raw_mPa[k] - (tare[k] if tare else _STANDARD_AIR_mPa)
            new[k] = water_mPa + ((water_mPa >> 6) * over >> 10)

    def _tilt(self, dt_us):
        """How the plane through the four depths lies."""
        z1, z2, z3, z4 = self.zeta_100nm
        parity = self.parity_100nm
        parity += (z1 - z2 + z3 - z4 - self._drift // _DRIFT_CYCLES - parity) // 20
        self.parity_100nm = parity
        if -_DRIFTS_100nm < parity < _DRIFTS_100nm:
            self._drift = max(-_MOST_DRIFT, min(_MOST_DRIFT, self._drift + parity))
        if -_PARITY_LIMIT_100nm <= parity <= _PARITY_LIMIT_100nm:
            self._parity_us = 0
            self.disagree = False
        else:
            self._parity_us += dt_us
            self.disagree = self._parity_us >= _PARITY_FOR_US
        self.depth_100nm = (z1 + z2 + z3 + z4 + 2) >> 2
        nose = (z1 - z2 - z3 + z4) * 250 // _SENSOR_HALF_MM  # sin(pitch), in 1e-7
        left = (z3 + z4 - z1 - z2) * 250 // _SENSOR_HALF_MM  # sin(roll) cos(pitch)
        self.over = False
        if not (-_STEEP < nose < _STEEP and -_STEEP < left < _STEEP):
            self.over = (nose >> 9) * (nose >> 9) + (left >> 9) * (left >> 9) > _OVER
        if -_SERIES < nose < _SERIES:
            s = nose >> 9
            square = (s * s >> 13) * 45 >> 6  # of the sine, in 1/32768
            more = 12288 + (square * (10240 + (square * 8960 >> 15)) >> 15)
            left += (left >> 5) * (square * (16384 + (square * more >> 15)) >> 15) >> 10
        else:
            left = int(left / math.cos(_asin(nose) * 1e-7))
        self.pitch_100nrad = _asin(nose)
        self.roll_100nrad = _asin(left)

    def _spike(self):
        """The sensor that has leapt out of the plane just now, or -1. One that stays out is for parity to judge."""
        z, new = self.zeta_100nm, self._new_100nm
        leap = new[0] - z[0] - new[1] + z[1] + new[2] - z[2] - new[3] + z[3]
        if self.bad_count or -_SPIKE_100nm <= leap <= _SPIKE_100nm:
            self._spikes = 0
            return -1
        self._spikes += 1
        if self._spikes >= _BAD_AFTER:
            return -1
        worst = 0
        for k in range(1, 4):
            if abs(new[k] - z[k]) > abs(new[worst] - z[worst]):
                worst = k
        return worst

    def _stuck(self, raw_mPa, dt_us):
        """Bit mask of the sensors that have frozen. One of them is not believed again before it moves."""
        stands, still_us, bad = self._stands_mPa, self._still_us, self.bad
        stuck = 0
        gone = bad  # and those that are still for so long that it is enough, if all are
        for k in range(4):
            if -_STEP_mPa <= raw_mPa[k] - stands[k] <= _STEP_mPa:
                us = still_us[k] + dt_us
                if us >= _STUCK_AFTER_US:
                    stuck |= 1 << k
                if us >= _ALL_STUCK_AFTER_US:
                    gone |= 1 << k
                    us = _ALL_STUCK_AFTER_US
                still_us[k] = us
            else:
                stands[k] = raw_mPa[k]
                still_us[k] = 0
        self.still = gone == 15
        return stuck if self.still or stuck | bad != 15 else stuck & bad

    def _follow(self, k, mPa, believed):
        zeta = self._new_100nm[k]
        if believed and _LOWEST_mPa < mPa < _HIGHEST_mPa and zeta > -_ABOVE_WATER_100nm:
            if self._faults[k]:
                self._goods[k] += 1
                if self._faults[k] < _BAD_AFTER or self._goods[k] >= _GOOD_AFTER:
                    self._faults[k] = 0
            self.zeta_100nm[k] = zeta
        else:
            self._goods[k] = 0
            if self._faults[k] < _BAD_AFTER:
                self._faults[k] += 1


def _asin(x):
    """asin of x in 1e-7, in 100 nrad."""
    if -_SERIES < x < _SERIES:
        s = x >> 9
        square = (s * s >> 13) * 45 >> 6
        more = 2458 + (square * (1463 + (square * (996 + (square * 733 >> 15)) >> 15)) >> 15)
        return x + ((x >> 5) * (square * (5461 + (square * more >> 15)) >> 15) >> 10)
    return int(math.asin(max(-1.0, min(1.0, x * 1e-7))) * 1e7)
