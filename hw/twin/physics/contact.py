"""Contacts of a hull with the floor, the walls and the other hulls."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hw.compiled import compiled
from hw.twin.physics.body import HULL_M
from hw.twin.physics.forces import Wrench, add_force, support_m
from hw.twin.physics.rotation import Quaternion, Vector, cross, to_body, to_world

# Contacts are springs that resist being pressed in; 2 kN/m lets a 4 kg hull sink in by millimetres.
CONTACT_N_M, CONTACT_N_S_M, FRICTION = 2000.0, 60.0, 0.3
CREEP_M_S = 0.01  # below this sliding speed friction grows linearly, so that rest is rest


@compiled()
def contact_force(gap_m: float, normal: Vector, slide: Vector) -> Vector:
    """Force of a contact: normal points to us, slide is our velocity relative to what we touch."""
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
