# The gains of the default law, law.Observer: from SI units to the whole numbers that it works with.
# Only boot and new parameters need this, so the board holds it no longer than that.
import math

H_S = 0.01  # a tick; all gains hold for this one alone
SIGN = (-1, 1, 1)  # what a positive wrench does to depth, roll, pitch


def observer(heave_kg=8.0, tilt_kgm2=0.075, lag_s=0.10):
    """Of the three axes. Inertias with added mass; lag_s: first-order lag of thruster and ESC."""
    return [_axis(i, (heave_kg, tilt_kgm2, tilt_kgm2)[i], lag_s) for i in range(3)]


def _axis(i, inertia, lag_s):
    """The numbers of axis i (depth, roll, pitch) as law._step takes them, for an inertia in kg or kg m2.

    Gains and feedback are from a search on models of one axis, of the twin's body and of MuJoCo's ellipsoid: mass and
    drag +-30 %, lags of 0.10 and 0.15 s, one to three samples of delay. All come to rest, then as soon as possible,
    without more noise of thrust. In tilt the law takes a robot for lighter than it is: what it expects too much it sees
    as a disturbance, which passes; a robot that is lighter than it is taken for swings on.
    """
    inertia *= (1.0, 0.64)[i > 0]
    linear, quadratic = ((3.0, 40.0), (0.03, 0.12))[i > 0]  # drag, N s/m and N s2/m2, in roll and pitch with Nm
    k1, k2 = ((33.0, 11.23), (50.0, 20.8))[i > 0]  # feedback of position and speed, 1/s2 and 1/s
    cap = (0.20, 0.23)[i > 0]  # m, rad: bounds the error in a big step, and so the speed
    # of the innovation into position, speed and disturbance, a tick
    l1, l2, l3 = ((0.1001, 14.795, 26.55), (0.1719, 12.598, 44.7))[i > 0]
    lead = (0.875, 1.3)[i > 0]  # makes up for the thrusters' lag
    unit_un = inertia * 1e-7 / 32.0 / (H_S * H_S) * 1e6  # the wrench of one unit of acceleration
    shift = 0
    while unit_un * (1 << shift) < 360.0:  # nine bits are exact enough, more would not fit beside the wrench
        shift += 1
    most_un = min(
        9.6e8 / (1 << shift), (2e9, 4.2e7)[i > 0]
    )  # beyond any thruster, and what fits 31 bits when shared out
    gains = (
        unit_un * (1 << shift),
        (1.0 - math.exp(-H_S / lag_s)) * 16384.0,
        linear * H_S / inertia * 65536.0,
        quadratic * 1e-7 / 32.0 / inertia * 65536.0 * 1024.0 * 256.0,
        k1 * H_S * H_S * 32.0 * 8192.0,
        k2 * H_S * 4096.0,
        cap * 1e7,
        l1 * 4096.0,
        l2 * H_S * 32.0 * 256.0,
        l3 * H_S * H_S * 32.0 * 4096.0,
        lead * 1024.0,
        most_un / unit_un,
    )
    return (SIGN[i], shift) + tuple([int(gain + 0.5) for gain in gains])
