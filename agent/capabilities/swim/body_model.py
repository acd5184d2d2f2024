"""How a robot moves in the plane under the forces that it was asked for: constants, and one small step.

x, y and velocity in the world frame; force and moment in the body frame (forward, left, anticlockwise). Thrusters
follow with a lag of first order, drag is linear and quadratic; what pushes besides (tether, current) is an acceleration
d.
"""

from __future__ import annotations

import math
from typing import NamedTuple

OF_THRUST, OF_DRAG = 0.15, 0.4  # share, one sigma: thrusters' gains and the mass; drag may be half or twice as large
OF_TURN = 0.05  # of the moment, what its own gain, which is learnt, leaves: no two thrusters have the same lag
ARM_M = 0.003  # of every push, which makes some moment: no two thrusters are alike

# An ESC's zero is off by some 5 us; where thrusters are kept turning (hw/firmware/thrust.py) that is 0.09 N of each of
# four, at 0.17 m: what pushes and turns a robot from when they turn on, and no longer.
ZERO_N, ZERO_NM = 0.12, 0.03
TETHER_N, TETHER_NM = 0.15, 0.004  # what is left of one whose thrusters stand still: its tether pulls

Wrench = tuple[float, float, float]  # N forward, N left, N m

STEP_NS = 20_000_000  # no longer: what drag and turn change over it is neglected to first order


class Hull(NamedTuple):
    """Constants of a robot of 30 cm with its added mass; each may be half or twice as large."""

    mass_kg: float = 6.0
    drag: float = 2.0  # N s/m
    drag2: float = 20.0  # N s^2/m^2
    inertia_kgm2: float = 0.09
    turn_drag: float = 0.03  # N m s
    turn_drag2: float = 0.10  # N m s^2
    lag_s: float = 0.115  # of the thrusters


class Motion(NamedTuple):
    """Accelerations over one step, and how they change with what they depend on."""

    force: Wrench  # that acts at the end of the step
    ax: float
    ay: float
    turn: float  # rad/s^2
    damping: float  # -da/dv, 1/s
    turn_damping: float
    ax_by_yaw: float
    ay_by_yaw: float
    turn_by: tuple[float, float, float, float, float]  # yaw, v_x, v_y, Munk's difference, gain of the yaw moment
    doubt: float  # sigma of the acceleration, m/s^2, for what thrust and drag are not known to
    turn_doubt: float  # rad/s^2


def motion(hull: Hull, state: tuple[float, ...], force: Wrench, asked: Wrench, h: float) -> Motion:
    """What a step of h seconds does from state = (x, y, psi, v_x, v_y, r, d_x, d_y, d_psi, munk, gain, ...).

    Of a body that swims aslant, added mass that differs aside and ahead makes a moment: Munk's, that difference times
    both speeds.
    """
    _, _, psi, vx, vy, r, dx, dy, dpsi, munk_kg, gain = state[:11]
    reached = 1.0 - math.exp(-h / hull.lag_s)
    share = 1.0 - hull.lag_s * reached / h  # of the way to what is asked, on average over the step
    ahead, left, moment = (f + (u - f) * share for f, u in zip(force, asked, strict=True))
    c, s = math.cos(psi), math.sin(psi)
    px, py = (c * ahead - s * left) / hull.mass_kg, (s * ahead + c * left) / hull.mass_kg
    k, k_r = damping(hull, math.sqrt(vx * vx + vy * vy)), turn_damping(hull, r)
    f, g, n = (f + (u - f) * reached for f, u in zip(force, asked, strict=True))
    spin = moment / hull.inertia_kgm2
    doubt = math.hypot(OF_THRUST * math.hypot(px, py), OF_DRAG * k * math.hypot(vx, vy))
    turn_doubt = math.hypot(OF_TURN * spin, OF_DRAG * k_r * r, ARM_M * math.hypot(ahead, left) / hull.inertia_kgm2)
    u, v, bent = c * vx + s * vy, c * vy - s * vx, munk_kg / hull.inertia_kgm2
    ax, ay, turn = px - k * vx + dx, py - k * vy + dy, (1.0 + gain) * spin - bent * u * v - k_r * r + dpsi
    by_speed = -bent * (c * v - s * u), -bent * (s * v + c * u)
    turn_by = (bent * (u * u - v * v), *by_speed, -u * v / hull.inertia_kgm2, spin)
    return Motion((f, g, n), ax, ay, turn, k, k_r, -py, px, turn_by, doubt, turn_doubt)


def damping(hull: Hull, speed_m_s: float) -> float:
    """Deceleration by drag, for each m/s, 1/s."""
    return (hull.drag + hull.drag2 * speed_m_s) / hull.mass_kg


def turn_damping(hull: Hull, rate_rad_s: float) -> float:
    return (hull.turn_drag + hull.turn_drag2 * abs(rate_rad_s)) / hull.inertia_kgm2
