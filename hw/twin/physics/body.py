"""What one robot really is: mass, water, arms, thrusters, servos, lamp and battery, drawn per seed, hidden from agents.

Body frame: x forward, y left, z up, origin in the centre of gravity, which is also the centre of the hull.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from agent.core.config import Body as Mounting
from agent.core.config import Tank
from hw.compiled import compiled
from hw.twin.scene import generator

# --- body ---

# One record per robot, read by the compiled kernels. Vectors are body x, y, z; six-vectors add roll, pitch, yaw.
BODY = np.dtype(
    [
        ("mass_kg", "f8"),
        ("displaced_kg", "f8"),  # mass of the water that the submerged hull displaces
        ("added_kg", "f8", 3),
        ("inertia_kgm2", "f8", 3),
        ("added_inertia_kgm2", "f8", 3),
        ("linear_drag", "f8", 6),  # N s/m and N m s
        ("quadratic_drag", "f8", 6),  # N s2/m2 and N m s2
        ("buoyancy_arm_m", "f8"),  # centre of buoyancy above the centre of gravity
        ("arm_m", "f8", 2),  # central thrusters at (+-a, +-b)
        ("reaction_m", "f8"),  # torque of a rotor per newton of its thrust
        ("neutral_us", "f8", 8),  # each ESC's own zero, from 1500 us
        ("thrust_gain", "f8", 8),
        ("thrust_lag_s", "f8", 8),
        ("sensor_m", "f8"),  # pressure sensors at (+-s, +-s)
        ("stagnation", "f8"),  # share of the dynamic pressure that they see
        ("servo_gain", "f8", 4),  # camera pan, camera tilt, lamp pan, lamp tilt
        ("servo_zero_deg", "f8", 4),
        ("servo_low_deg", "f8", 4),  # mechanical stops
        ("servo_high_deg", "f8", 4),
        ("home_m", "f8", 3),  # where the crew put it, and where the mooring holds it
        ("home_yaw_rad", "f8"),
        ("mooring", "f8", 4),  # N/m, N s/m, N m/rad, N m s/rad; zeros: not moored
        ("anchor_m", "f8", 3),  # the tether's upper end, at the rim of the tank
        ("tether_m", "f8"),  # length at which the tether comes taut
        ("tether_drag", "f8"),  # N s2/m2 at its lower end; 0: it hangs slack beside a moored robot
    ],
    align=True,
)

HULL_M = (0.14, 0.14, 0.08)  # semi-axes: the largest that leaves r3 of the tank scene clear of the wall

# Sizes of the open-frame robot. The paper prints none; added mass is Lamb's for a solid spheroid of this size,
# reduced for an open frame, and every figure has the spread that this ignorance deserves.
MASS_KG, MASS_SPREAD = 4.0, 0.05
NET_BUOYANCY = 0.01  # largest (B - W) / W of either sign: the crew trims it neutral
ADDED_KG = (2.0, 2.0, 4.0)
INERTIA_KGM2, INERTIA_SPREAD = (0.045, 0.045, 0.06), 0.15
ADDED_INERTIA_KGM2 = (0.03, 0.03, 0.03)
LINEAR_DRAG = (2.0, 2.0, 3.0, 0.03, 0.03, 0.03)
QUADRATIC_DRAG = (20.0, 20.0, 40.0, 0.12, 0.12, 0.10)
WATER_SPREAD = (0.6, 1.6)  # factor on added mass, added inertia and quadratic drag
LINEAR_SPREAD = (0.5, 2.0)
BUOYANCY_ARM_M = (0.003, 0.03)
ARM_M, ARM_SPREAD_M = (0.08, 0.06), 0.002
REACTION_M, REACTION_SPREAD = 0.012, 0.3
SENSOR_M, SENSOR_SPREAD_M = 0.13, 0.001

NEUTRAL_SPREAD_US = 5.0  # what is left after the crew set the zeros
THRUST_SPREAD = 0.05
LAG_FACTOR = (0.9, 1.3)

SURVEY_M = 0.001  # standard deviations between the surveyed pose of the fleet file and where the robot is
SURVEY_DEG = 0.1

SERVO_GAIN_SPREAD = 0.01  # a hobby servo's scale error
SERVO_ZERO_DEG = 1.0  # one spline tooth is more; the crew trims to about this

# Two taut lines fore and aft. The robot cannot observe x, y and yaw; the lines keep what is left of hover
# disturbances (about 0.3 N and 3 mN m) near 1 mm and 0.1 deg. Both motions are damped by half of critical or more.
MOORING = (300.0, 40.0, 2.0, 0.6)

TETHER_SLACK = 1.1  # paid-out length over the distance from rim to hull

# A robot that swims drags its tether along, and can go anywhere on it. 6 mm thick and 1.5 m of it in the water, with a
# drag coefficient of 1.2: the end moves with the robot and the rest less and less, rho C_d d L / 6 all together.
FREE_SLACK = 1.2  # paid-out length over the tank's diagonal
TETHER_DRAG = 1.8


def draw_body(
    seed: int, robot: str, start: tuple[float, float, float, float], tank: Tank, mounting: Mounting
) -> NDArray[np.void]:
    """The hidden record () BODY of one robot; start is its surveyed (x_m, y_m, z_m, yaw_deg)."""
    rng = generator(seed, robot, "body")
    body = np.zeros((), BODY)

    def about(middle: float | tuple[float, ...], share: float) -> NDArray[np.float64]:
        return np.asarray(np.asarray(middle) * rng.uniform(1 - share, 1 + share, np.shape(middle)))

    def factor(middle: tuple[float, ...], spread: tuple[float, float]) -> NDArray[np.float64]:
        low, high = math.log(spread[0]), math.log(spread[1])
        return np.asarray(np.asarray(middle) * np.exp(rng.uniform(low, high, np.shape(middle))))

    body["mass_kg"] = about(MASS_KG, MASS_SPREAD)
    body["displaced_kg"] = body["mass_kg"] * rng.uniform(1 - NET_BUOYANCY, 1 + NET_BUOYANCY)
    body["added_kg"] = factor(ADDED_KG, WATER_SPREAD)
    body["inertia_kgm2"] = about(INERTIA_KGM2, INERTIA_SPREAD)
    body["added_inertia_kgm2"] = factor(ADDED_INERTIA_KGM2, WATER_SPREAD)
    body["linear_drag"] = factor(LINEAR_DRAG, LINEAR_SPREAD)
    body["quadratic_drag"] = factor(QUADRATIC_DRAG, WATER_SPREAD)
    body["buoyancy_arm_m"] = factor((1.0,), BUOYANCY_ARM_M)[0]
    body["arm_m"] = np.asarray(ARM_M) + rng.uniform(-ARM_SPREAD_M, ARM_SPREAD_M, 2)
    body["reaction_m"] = about(REACTION_M, REACTION_SPREAD)
    body["sensor_m"] = SENSOR_M + rng.uniform(-SENSOR_SPREAD_M, SENSOR_SPREAD_M)
    body["stagnation"] = 1.0
    body["neutral_us"] = rng.uniform(-NEUTRAL_SPREAD_US, NEUTRAL_SPREAD_US, 8)
    body["thrust_gain"] = about((1.0,) * 8, THRUST_SPREAD)
    body["thrust_lag_s"] = THRUSTER_LAG_S * rng.uniform(*LAG_FACTOR, 8)

    survey = generator(seed, robot, "survey")
    x_m, y_m, z_m, yaw_deg = start
    body["home_m"] = (x_m + survey.normal(0, SURVEY_M), y_m + survey.normal(0, SURVEY_M), z_m)
    body["home_yaw_rad"] = math.radians(yaw_deg + survey.normal(0, SURVEY_DEG))
    body["mooring"] = MOORING
    body["anchor_m"] = (x_m, tank.size_m[1] if y_m > tank.size_m[1] / 2 else 0.0, tank.size_m[2])
    top = body["home_m"] + (0.0, 0.0, HULL_M[2])
    body["tether_m"] = TETHER_SLACK * np.linalg.norm(body["anchor_m"] - top)

    draw_servos(body, seed, robot, mounting)
    return body


def cast_off(body: NDArray[np.void], tank: Tank) -> None:
    """Take the mooring off a drawn record () BODY, and pay out tether."""
    body["mooring"] = 0.0
    body["tether_m"] = FREE_SLACK * np.linalg.norm(tank.size_m)
    body["tether_drag"] = TETHER_DRAG


def draw_servos(body: NDArray[np.void], seed: int, robot: str, mounting: Mounting) -> None:
    """Fill in the servos from their own stream: the calibration bench has the same servos without the rest."""
    rng = generator(seed, robot, "servo")
    low = (mounting.pan_limit_deg[0], mounting.tilt_limit_deg[0])
    high = (mounting.pan_limit_deg[1], mounting.tilt_limit_deg[1])
    body["servo_gain"] = rng.uniform(1 - SERVO_GAIN_SPREAD, 1 + SERVO_GAIN_SPREAD, 4)
    body["servo_zero_deg"] = rng.uniform(-SERVO_ZERO_DEG, SERVO_ZERO_DEG, 4)
    body["servo_low_deg"] = np.array(low * 2) - STOP_MARGIN_DEG
    body["servo_high_deg"] = np.array(high * 2) + STOP_MARGIN_DEG


# --- thruster: pulse -> static curve with dead band -> first-order lag -> force ---

F_MAX_N = 10.0  # forward, at 1900 us: small thrusters; a T200 would be oversized for 4 kg

# Shape of the Blue Robotics T200 at 12 V (manufacturer's workbook of September 2019): dead band +-36 us, reverse
# 79 % of forward. The firmware inverts a curve of its own; they differ as a data sheet differs from a thruster.
DELTA_US = np.array([-400.0, -300.0, -200.0, -100.0, -36.0, 36.0, 100.0, 200.0, 300.0, 400.0])
THRUST_N = np.array([-28.6, -19.0, -10.0, -3.2, 0.0, 0.0, 4.0, 12.4, 24.0, 36.4]) * (F_MAX_N / 36.4)

STICTION_N = 0.05  # the rotor does not turn below this
NEUTRAL_US = 1500.0
THRUSTER_LAG_S = 0.10  # a value of one simulator, not a measurement; draw_body spreads it


@compiled()
def static_thrust_n(pulse_us: float, neutral_us: float, gain: float) -> float:
    """Steady force in newtons; a pulse of 0 us is an ESC without signal, which stops."""
    if pulse_us <= 0.0:
        return 0.0
    delta = min(max(pulse_us - NEUTRAL_US - neutral_us, DELTA_US[0]), DELTA_US[-1])
    k = 1
    while delta > DELTA_US[k]:
        k += 1
    share = (delta - DELTA_US[k - 1]) / (DELTA_US[k] - DELTA_US[k - 1])
    force = gain * (THRUST_N[k - 1] + share * (THRUST_N[k] - THRUST_N[k - 1]))
    return float(force) if abs(force) >= STICTION_N else 0.0


@compiled()
def lagged_thrust_n(force_n: float, target_n: float, lag_s: float, dt_s: float) -> float:
    """Force after dt_s on the way to target_n, exact for a constant target."""
    return target_n + (force_n - target_n) * math.exp(-dt_s / lag_s)


# --- ESC: one that has just got power, or has long had no pulses, gives nothing until it has heard what is neutral ---

ESC_LIVES_V = 6.0
ESC_STARTS_S, ESC_LEARNS_S = 1.5, 1.0  # its tunes, then neutral pulses; assumed, of the size of common ones
ESC_SLEEPS_S = 3.0  # without pulses
NEUTRAL_WITHIN_US = 40.0


class Escs:
    """Those of all robots, and the loops of their kill switches; at first all are awake, and all loops closed."""

    def __init__(self, robots: int) -> None:
        self.open = [False] * robots  # loops: no pulse gets through
        self._broken = [False] * robots
        self._heard_s = np.full((robots, 8), ESC_LEARNS_S)  # of neutral; negative: it starts up
        self._silent_s = np.zeros((robots, 8))
        self._through = np.ones((robots, 8), bool)

    def turn(self, robot: int, to: Literal["open", "closed", "broken"]) -> None:
        """The kill switch. A broken wire stays open."""
        self._broken[robot] |= to == "broken"
        self.open[robot] = to != "closed" or self._broken[robot]

    def lose_power(self, robot: int) -> None:
        """They begin anew."""
        self._heard_s[robot] = -ESC_STARTS_S

    def tick(self, pulses_us: NDArray[np.float64], volts: NDArray[np.float64], dt_s: float) -> None:
        """Hear pulses (n, 8), 0: none, for dt_s on a supply of so many volts (n,)."""
        pulses_us = np.where(np.array(self.open)[:, None], 0.0, pulses_us)
        self._silent_s = np.where(pulses_us > 0, 0.0, self._silent_s + dt_s)
        awake = self._heard_s >= ESC_LEARNS_S
        neutral = np.abs(pulses_us - NEUTRAL_US) <= NEUTRAL_WITHIN_US
        heard_s = np.where((self._heard_s < 0) | neutral | awake, self._heard_s + dt_s, 0.0)
        heard_s = np.where(awake & (self._silent_s > ESC_SLEEPS_S), 0.0, np.minimum(heard_s, ESC_LEARNS_S))
        self._heard_s = np.where(volts[:, None] < ESC_LIVES_V, -ESC_STARTS_S, heard_s)
        self._through = (self._heard_s >= ESC_LEARNS_S) & ~np.array(self.open)[:, None]

    def driven_us(self, pulses_us: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pulses (n, 8) as far as they have an effect."""
        return pulses_us if self._through.all() else np.where(self._through, pulses_us, 0.0)


# --- gimbal servo: commanded angle -> scale and zero error -> lag and slew of the motor -> play of the gears ---

SERVO_LAG_S = 0.04
SLEW_DEG_S = 300.0  # 0.2 s per 60 deg, a usual figure of digital hobby servos
PLAY_DEG = 0.5  # full width of the backlash: the camera hangs behind the motor by half of it
STOP_MARGIN_DEG = 3.0  # mechanical stops lie outside the limits that the fleet file allows


@compiled()
def motor_deg_after(
    motor_deg: float, nominal_deg: float, gain: float, zero_deg: float, low_deg: float, high_deg: float, dt_s: float
) -> float:
    """Angle of the motor after dt_s of following the commanded nominal angle."""
    target = min(max(zero_deg + gain * nominal_deg, low_deg), high_deg)
    move = (target - motor_deg) * (1.0 - math.exp(-dt_s / SERVO_LAG_S))
    return motor_deg + min(max(move, -SLEW_DEG_S * dt_s), SLEW_DEG_S * dt_s)


@compiled()
def shaft_deg_after(shaft_deg: float, motor_deg: float) -> float:
    """Angle of what the servo carries: it stays until the motor has taken up the play, then it is dragged along."""
    return min(max(shaft_deg, motor_deg - PLAY_DEG / 2), motor_deg + PLAY_DEG / 2)


# --- lamp ---
#
# A lamp of 15 W in the water that cools it. Its driver keeps to that power, and to less where it is hot or the pack
# low. Figures are assumed, of the size of small underwater lamps; each robot's differs a little.

Array = NDArray[np.float64]

FULL_W = 15.0
LIGHT_SPREAD = 0.05  # of the light of one lamp and another at one power
WATER_C = 12.0
K_PER_W, K_SPREAD = 3.6, 0.15  # of the LED's plate above the water, through glue and housing
SETTLING_S = 90.0
HOT_C, HOTTEST_C = 60.0, 90.0  # light falls between them, in a straight line to nothing: a lamp settles before that
LOW_V, DEAD_V = 12.0, 10.0  # of the pack, between which the driver gives less and less


class Lamps:
    """All of a fleet: what each takes from its pack, how warm it gets, and how much light is left.

    Dark and as warm as the water at the start.
    """

    def __init__(self, seed: int, robots: Sequence[str]) -> None:
        drawn = np.array([generator(seed, name, "lamp").uniform(-1, 1, 2) for name in robots]).reshape(-1, 2)
        self._brightness = 1 + LIGHT_SPREAD * drawn[:, 0]
        self._k_per_w = K_PER_W * (1 + K_SPREAD * drawn[:, 1])
        self.asked = np.zeros(len(robots))  # share of full power, by the pin
        self.output = np.zeros(len(robots))  # light, as a share of a mean lamp's at full power
        self.temperature_c = np.full(len(robots), WATER_C)
        self.current_a = np.zeros(len(robots))  # that they draw from their packs

    def tick(self, battery_v: Array, dt_s: float) -> None:
        """dt_s on packs (n,) of so many volts."""
        if not self.asked.any() and not self.current_a.any() and self.temperature_c.max() < WATER_C + 0.01:
            self.output[:] = 0.0
            return
        cool = np.clip((HOTTEST_C - self.temperature_c) / (HOTTEST_C - HOT_C), 0, 1)
        fed = np.clip((battery_v - DEAD_V) / (LOW_V - DEAD_V), 0, 1)
        share = np.clip(self.asked, 0, 1) * np.minimum(cool, fed)
        power_w = FULL_W * share
        self.current_a = power_w / np.maximum(battery_v, DEAD_V)
        self.output = self._brightness * share
        end_c = WATER_C + self._k_per_w * power_w
        self.temperature_c += (end_c - self.temperature_c) * -np.expm1(-dt_s / SETTLING_S)


# --- battery: the voltage falls with the current that the thrusters draw, and their thrust with it ---

OPEN_V = 14.92  # four cells half way down, without load
OHM = 0.08  # pack, leads and plugs together; assumed
IDLE_A = 1.5  # electronics, camera and servos; assumed
A_PER_N = 0.45  # Blue Robotics T200 at 12 V: 17 A at 36.4 N (manufacturer's workbook of September 2019, from memory)

NOMINAL_V = OPEN_V - OHM * IDLE_A  # 14.8: at this supply THRUST_N holds
THRUST_EXPONENT = 1.2  # the T200's full thrust of 36.4 N at 12 V and 51.4 N at 16 V


def current_a(thrust_n: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) amperes for the thrust (n, 8) of all thrusters, either way alike."""
    return np.asarray(IDLE_A + A_PER_N * np.abs(thrust_n).sum(axis=1))


def supply_v(open_v: NDArray[np.float64], drawn_a: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) volts at the board for the open-circuit voltage (n,) and the current (n,)."""
    return np.asarray(np.maximum(open_v - OHM * drawn_a, 0.0))


def thrust_loss(volts: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) share of the thrust at NOMINAL_V that is missing; negative for a fuller pack."""
    return np.asarray(1.0 - (volts / NOMINAL_V) ** THRUST_EXPONENT)


# --- rotations ---
#
# A quaternion (w, x, y, z) turns body into world; R = Rz(yaw) Ry(pitch) Rx(roll), positive pitch is nose down. For the
# compiled kernels, vectors and quaternions are tuples, so that nothing is allocated.

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

# Camera axes (right, down, forward) as columns in the gimbal frame (forward, left, up).
GIMBAL_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@compiled()
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled()
def to_world(q: Quaternion, v: Vector) -> Vector:
    """Body vector -> world: v + 2 w (r x v) + 2 r x (r x v) with r the vector part."""
    r = (q[1], q[2], q[3])
    t = cross(r, v)
    s = cross(r, t)
    return (v[0] + 2 * (q[0] * t[0] + s[0]), v[1] + 2 * (q[0] * t[1] + s[1]), v[2] + 2 * (q[0] * t[2] + s[2]))


@compiled()
def to_body(q: Quaternion, v: Vector) -> Vector:
    return to_world((q[0], -q[1], -q[2], -q[3]), v)


@compiled()
def turned(q: Quaternion, w: Vector, dt_s: float) -> Quaternion:
    """The quaternion after dt_s at body rates w (rad/s), unit length again."""
    h = 0.5 * dt_s
    a = q[0] - h * (q[1] * w[0] + q[2] * w[1] + q[3] * w[2])
    b = q[1] + h * (q[0] * w[0] + q[2] * w[2] - q[3] * w[1])
    c = q[2] + h * (q[0] * w[1] + q[3] * w[0] - q[1] * w[2])
    d = q[3] + h * (q[0] * w[2] + q[1] * w[1] - q[2] * w[0])
    n = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    return a * n, b * n, c * n, d * n


def quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> NDArray[np.float64]:
    """(4,) quaternion of the Euler angles."""
    cr, sr = math.cos(roll_rad / 2), math.sin(roll_rad / 2)
    cp, sp = math.cos(pitch_rad / 2), math.sin(pitch_rad / 2)
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def matrix(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) body -> world; the length of q does not matter."""
    w, x, y, z = q / math.sqrt(float(np.sum(q * q)))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def euler_rad(q: NDArray[np.float64]) -> tuple[float, float, float]:
    """Roll, pitch, yaw."""
    R = matrix(q)
    roll, yaw = math.atan2(R[2, 1], R[2, 2]), math.atan2(R[1, 0], R[0, 0])
    return roll, -math.asin(min(max(R[2, 0], -1.0), 1.0)), yaw


def gimbal(pan_deg: float, tilt_deg: float) -> NDArray[np.float64]:
    """(3, 3) gimbal -> body: Rz(pan) Ry(-tilt), so pan is positive to the left and tilt positive upwards."""
    return matrix(quaternion(0.0, -math.radians(tilt_deg), math.radians(pan_deg)))
