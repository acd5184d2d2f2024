"""What one robot really is: mass, water, arms, thrusters and servos, drawn per seed and hidden from the agents.

Body frame: x forward, y left, z up, origin in the centre of gravity, which is also the centre of the hull.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agent.core.config import Body as Mounting
from agent.core.config import Tank
from hw.twin.physics.servo import STOP_MARGIN_DEG
from hw.twin.physics.thruster import THRUSTER_LAG_S
from hw.twin.scene import generator

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
