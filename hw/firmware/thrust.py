# Wrench -> forces of eight thrusters -> pulses. T1-T4 push upwards, T5-T8 lie flat at the corners, tangentially.
import math

ARM_X_M, ARM_Y_M = 0.08, 0.06  # half-distances of the central thrusters, the paper's a and b
KQ_M = 0.012  # reaction torque per thrust of a propeller; neighbours turn opposite ways
FLAT_ARM_M = 0.17  # from the middle to T5-T8, which sit at 45, 135, 225 and 315 degrees

FORWARD_N, REVERSE_N = 10.0, 8.0  # thrust at the ends of the pulse range; a propeller is weaker in reverse
ATTITUDE_SHARE = 0.8  # of the weaker direction: level but shallow can be mended, tilted cannot

NEUTRAL_US, LOWEST_US, HIGHEST_US = 1500, 1100, 1900  # Blue Robotics Basic ESC

# Signs of T1-T4 in roll, pitch and reaction. With the row of ones they are the paper's Theta made square: H H' = 4 I,
# so the inverse is a quarter of the transpose.
ROLL = (1, 1, -1, -1)
PITCH = (-1, 1, 1, -1)
REACTION = (1, -1, 1, -1)

# Thrust N -> pulse from neutral us, forward: ((d - 30)/370)^1.27 of the full thrust, a fit to the manufacturer's
# points for the T200 at 14 V. The dead band is crossed within 20 mN instead of in a jump, which would turn the noise
# of a pressure sensor into hammering. Reverse has the same shape.
CURVE_N = (0.0, 0.02, 0.245, 0.788, 1.66, 2.91, 4.58, 6.70, 10.0)
CURVE_US = (0, 30, 50, 80, 120, 170, 230, 300, 400)

_S = math.sqrt(0.5)
FLAT_X = (-_S, -_S, _S, _S)  # share of T5-T8 along x: -sin of their angle
FLAT_Y = (_S, -_S, -_S, _S)  # along y: cos of their angle


def central(want, reaction_nm, forces, realised):
    """Forces of T1-T4 (N) for the wrench [up N, roll Nm, pitch Nm] and a yaw reaction in Nm.

    Attitude goes first, depth gets the room that it leaves, reaction what is left then. `realised` becomes the
    wrench of these forces, for the law. Returns whether anything was cut.
    """
    roll = 0.25 * want[1] / ARM_Y_M
    pitch = 0.25 * want[2] / ARM_X_M
    worst = abs(roll) + abs(pitch)  # the largest force: some corner has both signs alike
    share = min(1.0, ATTITUDE_SHARE * REVERSE_N / worst) if worst > 0.0 else 1.0
    for j in range(4):
        forces[j] = share * (ROLL[j] * roll + PITCH[j] * pitch)
    up = 0.25 * want[0]
    up_given = max(-REVERSE_N - min(forces[:4]), min(FORWARD_N - max(forces[:4]), up))
    turn = 0.25 * reaction_nm / KQ_M
    room = abs(turn)
    for j in range(4):
        forces[j] += up_given
        room = min(room, FORWARD_N - forces[j], REVERSE_N + forces[j])
    turn_given = max(0.0, room) * (1 if turn > 0 else -1)
    realised[0] = realised[1] = realised[2] = 0.0
    for j in range(4):
        forces[j] += REACTION[j] * turn_given
        realised[0] += forces[j]
        realised[1] += ARM_Y_M * ROLL[j] * forces[j]
        realised[2] += ARM_X_M * PITCH[j] * forces[j]
    return share < 1.0 or up_given != up or abs(turn_given) < abs(turn)


def flat(fx_n, fy_n, mz_nm, forces):
    """Forces of T5-T8 (N) for a planar push and a yaw moment, all scaled down together at the limit."""
    turn = 0.25 * mz_nm / FLAT_ARM_M
    share = 1.0
    for j in range(4):
        forces[4 + j] = f = 0.5 * (FLAT_X[j] * fx_n + FLAT_Y[j] * fy_n) + turn
        limit = FORWARD_N if f > 0.0 else REVERSE_N
        share = min(share, limit / max(abs(f), limit))
    for j in range(4, 8):
        forces[j] *= share
    return share < 1.0


def pulse_us(force_n, neutral_us):
    """The pulse that gives this thrust on a thruster that rests at `neutral_us`."""
    f = force_n if force_n >= 0.0 else -force_n * (FORWARD_N / REVERSE_N)
    i = 1
    while i < 8 and f > CURVE_N[i]:
        i += 1
    f0, us0 = CURVE_N[i - 1], CURVE_US[i - 1]
    offset = us0 + (min(f, FORWARD_N) - f0) * (CURVE_US[i] - us0) / (CURVE_N[i] - f0)
    us = neutral_us + (offset if force_n >= 0.0 else -offset)
    return int(max(LOWEST_US, min(HIGHEST_US, us)) + 0.5)
