# Wrench -> forces of eight thrusters -> pulses. T1-T4 push upwards, T5-T8 lie flat at the corners, tangentially.
# Whole numbers: forces in uN, moments in uNm, up to 60 N a thruster without an object on the board.
import micropython
from micropython import const

_ARM_X_MM = const(80)  # half-distances of the central thrusters, the paper's a and b
_ARM_Y_MM = const(60)
_FLAT_ARM_MM = const(170)  # from the middle to T5-T8, which sit at 45, 135, 225 and 315 degrees

_REVERSE_FIFTHS = const(4)  # of the thrust forward at full pulse: a propeller is weaker in reverse
_ATTITUDE_TENTHS = const(9)  # of the weaker direction: level but shallow can be mended, tilted cannot

NEUTRAL_US = 1500  # Blue Robotics Basic ESC
_LOWEST_US = const(1100)
_HIGHEST_US = const(1900)

# Signs of T1-T4 in roll and pitch. With a row of ones and the row of their reaction torques, (1, -1, 1, -1), they are
# the paper's Theta made square: H H' = 4 I, so the inverse is a quarter of the transpose. No reaction is asked for.
ROLL = (1, 1, -1, -1)
PITCH = (-1, 1, 1, -1)

# Share of the full thrust, in 1/65536 -> pulse from neutral in us, forward: ((d - 30)/370)^1.27, a fit to the
# manufacturer's points for the T200 at 14 V. The dead band is crossed within 0.2 % of thrust instead of in a jump,
# which would turn the noise of a pressure sensor into hammering. Reverse has the same shape.
CURVE = (0, 131, 1606, 5164, 10879, 19071, 30015, 43909, 65536)
CURVE_US = (0, 30, 50, 80, 120, 170, 230, 300, 400)

# Of the voltage that the curve holds at, in 1/16384: 0.7 to 1.3. A probe that reads beyond it is not believed.
_LOWEST_BATTERY = const(11469)
_HIGHEST_BATTERY = const(21299)

# Of the full thrust, that T5-T8 give at least while a push is asked for, two against two so that it comes to nothing:
# an ESC's zero is off by some us and the curve is somebody else's, so that near zero force a thruster does nothing.
_PRELOAD_SHIFT = const(5)

FLAT_X = (-1, -1, 1, 1)  # sign of T5-T8 along x, where each has sqrt(1/2): -sin of their angle
FLAT_Y = (1, -1, -1, 1)  # along y: cos of their angle


def full_uN(thrust_max_mN, battery_ratio):
    """Thrust at full pulse, uN, when the battery has `battery_ratio`/16384 of the voltage that thrust_max_mN is for.

    It goes with battery^1.1, here by its series: between the T200's tables for 12 and 20 V, within 4 %.
    """
    x = min(max(battery_ratio, _LOWEST_BATTERY), _HIGHEST_BATTERY) - 16384
    more = (x * 11 + (x >> 2) * x * 11 // 81920) // 10
    return thrust_max_mN * 1000 + ((thrust_max_mN * more >> 7) * 125 >> 4)


def central(want, full, slew, forces, realised):
    """Forces of T1-T4 for the wrench [up, roll, pitch]; True where the limits of thrust cut anything.

    Attitude goes first, depth gets the room that it leaves. full: thrust at full pulse; slew: largest change from
    `forces` as it was. `realised` becomes the wrench of these forces, for the law.
    """
    reverse = full * _REVERSE_FIFTHS // 5
    roll = want[1] * 25 // _ARM_Y_MM * 10
    pitch = want[2] * 25 // _ARM_X_MM * 10
    worst = (roll if roll > 0 else -roll) + (pitch if pitch > 0 else -pitch)  # some corner has both signs alike
    limit = reverse * _ATTITUDE_TENTHS // 10
    cut = worst > limit
    if cut:
        share = (limit << 4) // (worst >> 10)  # in 1/16384
        roll = (roll >> 14) * share + ((roll & 16383) * share >> 14)
        pitch = (pitch >> 14) * share + ((pitch & 16383) * share >> 14)
        worst = limit
    up = want[0] + 2 >> 2
    if up > full - worst:
        up = full - worst
        cut = True
    elif up < worst - reverse:
        up = worst - reverse
        cut = True
    lift = roll_uNm = pitch_uNm = 0
    for j in range(4):
        f = ROLL[j] * roll + PITCH[j] * pitch + up
        before = forces[j]
        if f > before + slew:
            f = before + slew
        elif f < before - slew:
            f = before - slew
        forces[j] = f
        lift += f
        roll_uNm += ROLL[j] * f
        pitch_uNm += PITCH[j] * f
    realised[0] = lift
    realised[1] = roll_uNm // 25 * _ARM_Y_MM // 40
    realised[2] = pitch_uNm // 25 * _ARM_X_MM // 40
    return cut


def flat(fx, fy, mz, full, forces):
    """Forces of T5-T8 for a planar push and a yaw moment, all scaled down together at the limit `full`.

    Preload (biased thrust allocation, as ships do that hold a place) runs along the one direction that neither pushes
    nor turns: by turns forward and in reverse. Nothing asked for is nothing given.
    """
    turn = mz * 25 // _FLAT_ARM_MM * 10
    preload = full >> _PRELOAD_SHIFT if fx or fy or mz else 0
    share = 4096
    for j in range(4):
        # half of sqrt(1/2) is 5793/16384
        forces[4 + j] = f = ((FLAT_X[j] * fx + FLAT_Y[j] * fy >> 9) * 5793 >> 5) + turn + preload
        preload = -preload
        limit = full
        if f < 0:
            f = -f
            limit = full * _REVERSE_FIFTHS // 5
        if f > limit:
            fits = limit // (f >> 12)
            if fits < share:
                share = fits
    if share == 4096:
        return False
    for j in range(4, 8):
        forces[j] = (forces[j] >> 12) * share
    return True


@micropython.native
def pulses(forces, neutral_us, full, pulses_us):
    """The pulses that give these forces on thrusters that rest at `neutral_us` and give `full` at full pulse."""
    down = 0
    while full >> down > 131072:
        down += 1
    inverse = (1 << 29) // (full >> down)
    for j in range(8):
        f = forces[j]
        us = neutral_us[j]
        if f:
            size = f if f > 0 else -f * 5 // _REVERSE_FIFTHS
            share = 65536
            if size < full:
                share = (size >> down) * inverse >> 13
            i = 1
            while share > CURVE[i]:
                i += 1
            width = CURVE[i] - CURVE[i - 1]
            rise_us = (share - CURVE[i - 1]) * (CURVE_US[i] - CURVE_US[i - 1])
            offset_us = CURVE_US[i - 1] + (rise_us + (width >> 1)) // width
            us = us + offset_us if f > 0 else us - offset_us
            if us > _HIGHEST_US:
                us = _HIGHEST_US
            elif us < _LOWEST_US:
                us = _LOWEST_US
        pulses_us[j] = us
