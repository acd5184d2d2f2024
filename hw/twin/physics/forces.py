"""What water, weight, thrusters, lines and contacts do to one hull: each adds its part to a wrench in the body frame.

A wrench is (6,): force in newtons, then torque in newton metres about the centre of gravity.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hw.compiled import compiled
from hw.twin.physics.body import HULL_M, Quaternion, Vector, cross, to_body, to_world

Wrench = NDArray[np.float64]
Record = Any  # a numpy record of body.BODY or tank.STATE, whose fields numba knows and mypy does not

GRAVITY_M_S2 = 9.81
WATER_KG_M3 = 998.0  # fresh, 20 C

# Peripheral thrusters: tangential at the hull's corners. The paper does not print its geometry.
RING_M = 0.17
RING_RAD = np.radians(np.array([45.0, 135.0, 225.0, 315.0]))

# The tether hangs slack from the rim to the top of the hull: its weight in water, and a spring once it is taut.
TETHER_WEIGHT_N = 0.05
TETHER_N_M, TETHER_N_S_M = 20.0, 2.0


@compiled()
def support_m(n: Vector) -> float:
    """Support function of the hull's ellipsoid: how far it extends along the unit vector n of the body frame."""
    return math.sqrt((HULL_M[0] * n[0]) ** 2 + (HULL_M[1] * n[1]) ** 2 + (HULL_M[2] * n[2]) ** 2)


@compiled()
def add_force(wrench: Wrench, force: Vector, point: Vector) -> None:
    """Add a body-frame force that acts at a body-frame point."""
    torque = cross(point, force)
    for k in range(3):
        wrench[k] += force[k]
        wrench[3 + k] += torque[k]


@compiled()
def add_water(body: Record, v: Vector, w: Vector, wrench: Wrench) -> None:
    """Coriolis and Munk terms of rigid body and added mass, and drag. They do no work, respectively only lose it."""
    m, ma, J, ja = body.mass_kg, body.added_kg, body.inertia_kgm2, body.added_inertia_kgm2
    momentum = ((m + ma[0]) * v[0], (m + ma[1]) * v[1], (m + ma[2]) * v[2])
    spin = ((J[0] + ja[0]) * w[0], (J[1] + ja[1]) * w[1], (J[2] + ja[2]) * w[2])
    turn, munk, gyro = cross(w, momentum), cross(v, momentum), cross(w, spin)
    for k in range(3):
        wrench[k] -= turn[k] + (body.linear_drag[k] + body.quadratic_drag[k] * abs(v[k])) * v[k]
        wrench[3 + k] -= munk[k] + gyro[k]
        wrench[3 + k] -= (body.linear_drag[3 + k] + body.quadratic_drag[3 + k] * abs(w[k])) * w[k]


@compiled()
def add_stirred_water(
    body: Record, s: Record, q: Quaternion, v: Vector, w: Vector, dt_s: float, wrench: Wrench
) -> None:
    """As add_water, where the water flows, with one velocity everywhere, and has a tether to drag at.

    To a hull that drifts along, the water is at rest: (m + m_A) v_r' = F(v_r), add_water's of the velocity through it.
    In the tank's frame v' = v_r' - w x water + speeding, and the pressure that speeds up the water pushes the hull like
    the water in its place (Froude and Krylov), so that
    (m + m_A) v' = F(v_r) - (m + m_A) w x water + (m_displaced + m_A) speeding.
    """
    for k in range(3):
        s.water_m_s[k] += dt_s * s.water_m_s2[k]
    water = to_body(q, (s.water_m_s[0], s.water_m_s[1], s.water_m_s[2]))
    speeding = to_body(q, (s.water_m_s2[0], s.water_m_s2[1], s.water_m_s2[2]))
    through = (v[0] - water[0], v[1] - water[1], v[2] - water[2])
    add_water(body, through, w, wrench)
    turn = cross(w, water)
    for k in range(3):
        wrench[k] += body.added_kg[k] * speeding[k] - (body.mass_kg + body.added_kg[k]) * turn[k]
    m = body.displaced_kg
    add_force(wrench, (m * speeding[0], m * speeding[1], m * speeding[2]), (0.0, 0.0, body.buoyancy_arm_m))

    eye = (0.0, 0.0, HULL_M[2])  # of the tether
    swing = cross(w, eye)
    u = (through[0] + swing[0], through[1] + swing[1], through[2] + swing[2])
    drag = body.tether_drag * math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    pull = to_body(q, (s.pull_n[0], s.pull_n[1], s.pull_n[2]))
    add_force(wrench, (pull[0] - drag * u[0], pull[1] - drag * u[1], pull[2] - drag * u[2]), eye)


@compiled()
def add_weight(body: Record, z_m: float, q: Quaternion, surface_m: float, wrench: Wrench) -> None:
    """Weight in the centre of gravity; buoyancy above it, less by the share of the height that is out of the water."""
    up = to_body(q, (0.0, 0.0, 1.0))
    h = support_m(up)
    wet = min(max((surface_m - z_m + h) / (2 * h), 0.0), 1.0)
    lift = GRAVITY_M_S2 * body.displaced_kg * wet
    weight = GRAVITY_M_S2 * body.mass_kg + TETHER_WEIGHT_N
    add_force(wrench, (lift * up[0], lift * up[1], lift * up[2]), (0.0, 0.0, body.buoyancy_arm_m))
    add_force(wrench, (-weight * up[0], -weight * up[1], -weight * up[2]), (0.0, 0.0, 0.0))


@compiled()
def add_thrust(body: Record, f: NDArray[np.float64], wrench: Wrench) -> None:
    """T1-T4 push up at (+a,+b) (-a,+b) (-a,-b) (+a,-b), their rotors turning alternately; T5-T8 push along the rim."""
    a, b = body.arm_m[0], body.arm_m[1]
    wrench[2] += f[0] + f[1] + f[2] + f[3]
    wrench[3] += b * (f[0] + f[1] - f[2] - f[3])
    wrench[4] += a * (-f[0] + f[1] + f[2] - f[3])
    wrench[5] += body.reaction_m * (f[0] - f[1] + f[2] - f[3])
    for k in range(4):
        wrench[0] -= math.sin(RING_RAD[k]) * f[4 + k]
        wrench[1] += math.cos(RING_RAD[k]) * f[4 + k]
        wrench[5] += RING_M * f[4 + k]


@compiled()
def add_lines(body: Record, p: Vector, q: Quaternion, v_world: Vector, w: Vector, wrench: Wrench) -> None:
    """Mooring and tether. The mooring holds x, y and yaw; its vertical stiffness is of second order and left out."""
    spring, damper, twist_spring, twist_damper = body.mooring
    pull = (
        -spring * (p[0] - body.home_m[0]) - damper * v_world[0],
        -spring * (p[1] - body.home_m[1]) - damper * v_world[1],
        0.0,
    )
    add_force(wrench, to_body(q, pull), (0.0, 0.0, 0.0))
    ahead = to_world(q, (1.0, 0.0, 0.0))
    off = math.atan2(ahead[1], ahead[0]) - body.home_yaw_rad
    off -= 2 * math.pi * round(off / (2 * math.pi))
    twist = to_body(q, (0.0, 0.0, -twist_spring * off - twist_damper * to_world(q, w)[2]))
    for k in range(3):
        wrench[3 + k] += twist[k]

    eye = (0.0, 0.0, HULL_M[2])
    arm = to_world(q, eye)
    dx, dy, dz = body.anchor_m[0] - p[0] - arm[0], body.anchor_m[1] - p[1] - arm[1], body.anchor_m[2] - p[2] - arm[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length > body.tether_m:
        closing = (dx * v_world[0] + dy * v_world[1] + dz * v_world[2]) / length
        tension = max(0.0, TETHER_N_M * (length - body.tether_m) - TETHER_N_S_M * closing) / length
        add_force(wrench, to_body(q, (tension * dx, tension * dy, tension * dz)), eye)


# --- contacts with the floor, the walls and other hulls ---

# Contacts are springs that resist being pressed in; 2 kN/m lets a 4 kg hull sink in by millimetres.
CONTACT_N_M, CONTACT_N_S_M, FRICTION = 2000.0, 60.0, 0.3
CREEP_M_S = 0.01  # below this sliding speed friction grows linearly, so that rest is rest


@compiled()
def contact_force(gap_m: float, normal: Vector, slide: Vector) -> Vector:
    """Force of a contact: normal points to the hull, slide is the hull's velocity relative to what it touches."""
    speed_n = slide[0] * normal[0] + slide[1] * normal[1] + slide[2] * normal[2]
    press = max(0.0, -CONTACT_N_M * gap_m - CONTACT_N_S_M * speed_n)
    tx, ty, tz = slide[0] - speed_n * normal[0], slide[1] - speed_n * normal[1], slide[2] - speed_n * normal[2]
    rub = FRICTION * press / max(CREEP_M_S, math.sqrt(tx * tx + ty * ty + tz * tz))
    return press * normal[0] - rub * tx, press * normal[1] - rub * ty, press * normal[2] - rub * tz


@compiled()
def add_contacts(
    states: NDArray[np.void],
    i: int,
    q: Quaternion,
    v: Vector,
    v_world: Vector,
    w: Vector,
    size_m: NDArray[np.float64],
    wrench: Wrench,
) -> None:
    """Floor and four walls at the hull's support point; other hulls along the line between the centres."""
    p = states[i].position_m
    for face in range(5):
        axis = 2 if face == 4 else face // 2
        sign = -1.0 if face < 4 and face % 2 == 1 else 1.0
        normal = (sign * (axis == 0), sign * (axis == 1), sign * (axis == 2))
        n = to_body(q, normal)
        h = support_m(n)
        gap = (p[axis] if sign > 0 else size_m[axis] - p[axis]) - h
        if gap < 0:
            point = (-(HULL_M[0] ** 2) * n[0] / h, -(HULL_M[1] ** 2) * n[1] / h, -(HULL_M[2] ** 2) * n[2] / h)
            swing = cross(w, point)
            slide = to_world(q, (v[0] + swing[0], v[1] + swing[1], v[2] + swing[2]))
            add_force(wrench, to_body(q, contact_force(gap, normal, slide)), point)
    for j in range(states.shape[0]):
        if j == i:
            continue
        o = states[j]
        d = (p[0] - o.position_m[0], p[1] - o.position_m[1], p[2] - o.position_m[2])
        apart = math.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
        if apart >= 2 * HULL_M[0] or apart == 0.0:
            continue
        normal = (d[0] / apart, d[1] / apart, d[2] / apart)
        qo = (o.quaternion[0], o.quaternion[1], o.quaternion[2], o.quaternion[3])
        n = to_body(q, normal)
        h = support_m(n)
        gap = apart - h - support_m(to_body(qo, normal))
        if gap < 0:
            vo = to_world(qo, (o.velocity_m_s[0], o.velocity_m_s[1], o.velocity_m_s[2]))
            slide = (v_world[0] - vo[0], v_world[1] - vo[1], v_world[2] - vo[2])
            add_force(wrench, to_body(q, contact_force(gap, normal, slide)), (-h * n[0], -h * n[1], -h * n[2]))
