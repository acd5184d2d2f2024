"""A standing wave along the tank, as the pressure sensors see it: linear theory, water of finite depth.

p = rho g A cosh(k z) / cosh(k h) cos(k x) cos(omega t), k = m pi / L, omega^2 = g k tanh(k h), z above the floor
(Dean and Dalrymple, Water Wave Mechanics, chapter 3). What the wave does to the hull is left out.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hw.compiled import compiled
from hw.twin.physics.forces import GRAVITY_M_S2
from hw.twin.physics.rotation import to_world
from hw.twin.physics.sensors import CORNERS, PA_PER_M
from hw.twin.scene import Waves


def add_waves(
    waves: Waves,
    length_m: float,
    surface_m: float,
    t_s: float,
    bodies: NDArray[np.void],
    states: NDArray[np.void],
    pressure_pa: NDArray[np.float64],
) -> None:
    """Add to pressure_pa (n, 4) what the wave of a tank `length_m` long in x exerts at t_s."""
    k = waves.mode * math.pi / length_m
    omega = math.sqrt(GRAVITY_M_S2 * k * math.tanh(k * surface_m))
    _add(PA_PER_M * waves.amplitude_m * math.cos(omega * t_s), k, surface_m, bodies, states, pressure_pa)


@compiled()
def _add(
    crest_pa: float,
    k: float,
    surface_m: float,
    bodies: NDArray[np.void],
    states: NDArray[np.void],
    pressure_pa: NDArray[np.float64],
) -> None:
    for i in range(states.shape[0]):
        s, reach = states[i], bodies[i].sensor_m
        q = (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3])
        for j in range(4):
            arm = to_world(q, (reach * CORNERS[j, 0], reach * CORNERS[j, 1], 0.0))
            x, z = s.position_m[0] + arm[0], s.position_m[2] + arm[2]
            if z < surface_m:
                pressure_pa[i, j] += crest_pa * math.cosh(k * z) / math.cosh(k * surface_m) * math.cos(k * x)
