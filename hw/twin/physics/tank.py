"""The water and what moves in it: every robot as a rigid body with six degrees of freedom, 500 steps a second.

(M_RB + M_A) nu' + C(nu) nu + (D_l + D_q |nu|) nu + g(R) = thrust + mooring + tether + contact + push, after Fossen,
Handbook of Marine Craft Hydrodynamics; where there is a current, nu is through the water. Drag is signed: the paper's
k v^2 drives a body that moves backwards. Semi-implicit Euler: velocities first, then the pose with the new velocities.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.core.messages import Vector
from hw.compiled import compiled
from hw.twin.physics.contact import add_contacts
from hw.twin.physics.forces import add_force, add_lines, add_stirred_water, add_thrust, add_water, add_weight
from hw.twin.physics.rotation import to_body, to_world, turned
from hw.twin.physics.servo import motor_deg_after, shaft_deg_after
from hw.twin.physics.thruster import lagged_thrust_n, static_thrust_n

STEP_S = 0.002  # 20 times shorter than the fastest lag, that of the servos
STEPS_PER_TICK = 5
TICK_NS = 10_000_000  # the firmware's 100 Hz

# One record per robot, all that moves. World: origin at the lower left corner of the tank's floor, z up.
STATE = np.dtype(
    [
        ("position_m", "f8", 3),
        ("quaternion", "f8", 4),  # w, x, y, z; body -> world
        ("velocity_m_s", "f8", 3),  # body frame
        ("rates_rad_s", "f8", 3),  # body frame
        ("thrust_n", "f8", 8),
        ("thrust_loss", "f8"),  # share that is missing because the battery sags
        ("motor_deg", "f8", 4),  # servos: camera pan, camera tilt, lamp pan, lamp tilt
        ("shaft_deg", "f8", 4),  # what they carry, behind the play of the gears
        ("held", "i8"),  # 1: in the hands of the crew
        ("push_n", "f8", 3),  # world frame
        ("push_at_m", "f8", 3),  # body frame
        ("push_s", "f8"),  # time left
        ("stirred", "i8"),  # 1: the water flows, the tether drags or is pulled; 0 leaves this out
        ("water_m_s", "f8", 3),  # current, world frame, and how it speeds up
        ("water_m_s2", "f8", 3),
        ("pull_n", "f8", 3),  # at the tether, world frame
    ],
    align=True,
)


@compiled()
def advance(
    bodies: NDArray[np.void],
    states: NDArray[np.void],
    pulses_us: NDArray[np.float64],
    nominal_deg: NDArray[np.float64],
    size_m: NDArray[np.float64],
    surface_m: float,
    dt_s: float,
    steps: int,
) -> None:
    """Move all robots on by `steps` steps of dt_s, in place.

    bodies (n,) BODY, states (n,) STATE, pulses_us (n, 8) to the thrusters (0: no pulses), nominal_deg (n, 4) to the
    servos, size_m (3,) of the tank, surface_m height of the water surface above its floor.
    """
    robots = states.shape[0]
    wrench = np.zeros((robots, 6))
    for _ in range(steps):
        wrench[:] = 0.0
        for i in range(robots):
            body, s = bodies[i], states[i]
            for k in range(8):
                gain = body.thrust_gain[k] * (1.0 - s.thrust_loss)
                target = static_thrust_n(pulses_us[i, k], body.neutral_us[k], gain)
                s.thrust_n[k] = lagged_thrust_n(s.thrust_n[k], target, body.thrust_lag_s[k], dt_s)
            for k in range(4):
                s.motor_deg[k] = motor_deg_after(
                    s.motor_deg[k],
                    nominal_deg[i, k],
                    body.servo_gain[k],
                    body.servo_zero_deg[k],
                    body.servo_low_deg[k],
                    body.servo_high_deg[k],
                    dt_s,
                )
                s.shaft_deg[k] = shaft_deg_after(s.shaft_deg[k], s.motor_deg[k])
            if s.held:
                continue
            q = (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3])
            p = (s.position_m[0], s.position_m[1], s.position_m[2])
            v = (s.velocity_m_s[0], s.velocity_m_s[1], s.velocity_m_s[2])
            w = (s.rates_rad_s[0], s.rates_rad_s[1], s.rates_rad_s[2])
            v_world = to_world(q, v)
            if s.stirred:
                add_stirred_water(body, s, q, v, w, dt_s, wrench[i])
            else:
                add_water(body, v, w, wrench[i])
            add_weight(body, p[2], q, surface_m, wrench[i])
            add_thrust(body, s.thrust_n, wrench[i])
            add_lines(body, p, q, v_world, w, wrench[i])
            add_contacts(states, i, q, v, v_world, w, size_m, wrench[i])
            if s.push_s > 0:
                push = (s.push_n[0], s.push_n[1], s.push_n[2])
                add_force(wrench[i], to_body(q, push), (s.push_at_m[0], s.push_at_m[1], s.push_at_m[2]))
                s.push_s -= dt_s
        for i in range(robots):
            body, s = bodies[i], states[i]
            if s.held:
                continue
            for k in range(3):
                s.velocity_m_s[k] += dt_s * wrench[i, k] / (body.mass_kg + body.added_kg[k])
                inertia = body.inertia_kgm2[k] + body.added_inertia_kgm2[k]
                s.rates_rad_s[k] += dt_s * wrench[i, 3 + k] / inertia
            q = (s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3])
            moved = to_world(q, (s.velocity_m_s[0], s.velocity_m_s[1], s.velocity_m_s[2]))
            q = turned(q, (s.rates_rad_s[0], s.rates_rad_s[1], s.rates_rad_s[2]), dt_s)
            for k in range(3):
                s.position_m[k] += dt_s * moved[k]
            for k in range(4):
                s.quaternion[k] = q[k]


def push(state: np.void, force_n: Vector, point_m: Vector, for_s: float) -> None:
    """Push one robot: a world-frame force at a body-frame point, from the next step on."""
    state["push_n"], state["push_at_m"], state["push_s"] = force_n, point_m, for_s
