# Wrench -> forces of eight thrusters -> pulses. T1-T4 push upwards, T5-T8 lie flat at the corners, tangentially.
import math

ARM_X_M, ARM_Y_M = 0.08, 0.06  # half-distances of the central thrusters, the paper's a and b
KQ_M = 0.012  # reaction torque per thrust of a propeller; neighbours turn opposite ways
FLAT_ARM_M = 0.17  # from the middle to T5-T8, which sit at 45, 135, 225 and 315 degrees

REVERSE_SHARE = 0.8  # thrust backwards at full pulse; a propeller is weaker in reverse
ATTITUDE_SHARE = 0.9  # of the weaker direction: level but shallow can be mended, tilted cannot

NEUTRAL_US, LOWEST_US, HIGHEST_US = 1500, 1100, 1900  # Blue Robotics Basic ESC

# Signs of T1-T4 in roll, pitch and reaction. With the row of ones they are the paper's Theta made square: H H' = 4 I,
# so the inverse is a quarter of the transpose.
ROLL = (1, 1, -1, -1)
PITCH = (-1, 1, 1, -1)
REACTION = (1, -1, 1, -1)

# Share of the full thrust -> pulse from neutral in us, forward: ((d - 30)/370)^1.27, a fit to the manufacturer's
# points for the T200 at 14 V. The dead band is crossed within 0.2 % of thrust instead of in a jump, which would turn
# the noise of a pressure sensor into hammering. Reverse has the same shape.
CURVE = (0.0, 0.002, 0.0245, 0.0788, 0.166, 0.291, 0.458, 0.670, 1.0)
CURVE_US = (0, 30, 50, 80, 120, 170, 230, 300, 400)

# Thrust at a pulse goes with battery^1.1: between the T200's tables for 12 and 20 V, within 4 %.
BATTERY_POWER = 1.1
BATTERY_RANGE = (0.7, 1.3)  # of the voltage that the curve holds at; a probe that reads beyond it is not believed

_S = math.sqrt(0.5)
FLAT_X = (-_S, -_S, _S, _S)  # share of T5-T8 along x: -sin of their angle
FLAT_Y = (_S, -_S, -_S, _S)  # along y: cos of their angle


def full_n(thrust_max_n, battery_ratio):
    """Thrust at full pulse, when the battery has `battery_ratio` of the voltage that thrust_max_n was found at."""
    lowest, highest = BATTERY_RANGE
    return thrust_max_n * max(lowest, min(highest, battery_ratio)) ** BATTERY_POWER


def central(want, reaction_nm, full, slew_n, forces, realised):
    """Forces of T1-T4 (N) for the wrench [up N, roll Nm, pitch Nm] and a yaw reaction in Nm.

    Attitude goes first, depth gets the room that it leaves, reaction what is left then. full: thrust at full pulse, N;
    slew_n: largest change from `forces` as it was. `realised` becomes the wrench of these forces, for the law.
    Returns whether the limits of thrust cut anything.
    """
    reverse = REVERSE_SHARE * full
    roll = 0.25 * want[1] / ARM_Y_M
    pitch = 0.25 * want[2] / ARM_X_M
    worst = abs(roll) + abs(pitch)  # the largest force: some corner has both signs alike
    share = 1.0
    if worst > ATTITUDE_SHARE * reverse:
        share = ATTITUDE_SHARE * reverse / worst
        roll *= share
        pitch *= share
        worst *= share
    up = 0.25 * want[0]
    up_given = max(worst - reverse, min(full - worst, up))
    turn = 0.25 * reaction_nm / KQ_M
    room = abs(turn)
    for j in range(4):
        f = ROLL[j] * roll + PITCH[j] * pitch + up_given
        room = min(room, full - f, reverse + f)
    turn_given = max(0.0, room) * (1 if turn > 0 else -1)
    realised[0] = realised[1] = realised[2] = 0.0
    for j in range(4):
        f = ROLL[j] * roll + PITCH[j] * pitch + up_given + REACTION[j] * turn_given
        forces[j] = f = max(forces[j] - slew_n, min(forces[j] + slew_n, f))
        realised[0] += f
        realised[1] += ARM_Y_M * ROLL[j] * f
        realised[2] += ARM_X_M * PITCH[j] * f
    return share < 1.0 or up_given != up or abs(turn_given) < abs(turn)


def flat(fx_n, fy_n, mz_nm, full, forces):
    """Forces of T5-T8 (N) for a planar push and a yaw moment, all scaled down together at the limit `full`."""
    turn = 0.25 * mz_nm / FLAT_ARM_M
    share = 1.0
    for j in range(4):
        forces[4 + j] = f = 0.5 * (FLAT_X[j] * fx_n + FLAT_Y[j] * fy_n) + turn
        limit = full if f > 0.0 else REVERSE_SHARE * full
        share = min(share, limit / max(abs(f), limit))
    for j in range(4, 8):
        forces[j] *= share
    return share < 1.0


def pulse_us(force_n, neutral_us, full):
    """The pulse that gives this thrust on a thruster that rests at `neutral_us` and gives `full` at full pulse, N."""
    if not force_n:
        return neutral_us
    f = force_n / full if force_n >= 0.0 else -force_n / (REVERSE_SHARE * full)
    f = min(f, 1.0)
    i = 1
    while i < 8 and f > CURVE[i]:
        i += 1
    f0, us0 = CURVE[i - 1], CURVE_US[i - 1]
    offset = us0 + (f - f0) * (CURVE_US[i] - us0) / (CURVE[i] - f0)
    us = neutral_us + (offset if force_n >= 0.0 else -offset)
    return int(max(LOWEST_US, min(HIGHEST_US, us)) + 0.5)
