"""Force and moment that bring a robot to its reference: control of velocity within control of place.

    v_d = sat(k_p (p_ref - p), v_max) + v_ref ;  k_p = w / (2 z), k_v = 2 z w ;  barrier.py has its say on v_d
    F = M R(psi + r tau)' (a_ref + k_v (v_d - v) + k v - d)                yaw when the thrust acts
    r_d = sat(w_psi / (2 z) e_psi, r_max) + r_ref ;  N = (J (2 z w_psi (r_d - r) + k_r r - d_psi) + munk) / (1 + gain)
    u = f + 1.4 (F - f), within limits

There is no integrator, and nothing that could wind up: d, Munk's moment and the gain are learnt from the force that was
sent, after the limits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.capabilities.swim.barrier import STILL, Planar
from agent.capabilities.swim.body_model import Hull, Wrench, damping, turn_damping
from agent.capabilities.swim.pose_filter import Belief
from agent.core.linear_algebra import wrap

# As stiff as is damped by 0.3 and more where thrusters lag by 0.08 to 0.15 s, mass and inertia are 0.75 to 1.3 times
# what is believed and fixes are 0.2 s late. At 3.0 the lightest and fastest body with the latest fixes swings for ever;
# so does its yaw at 1.3 times 2.5 (planar).
W_RAD_S = 2.8
YAW_W_RAD_S = 2.5
Z = 0.9
TURN_RAD_S = 1.0
LEAD = 1.4  # hurries the thrusters' lag; more makes noise of it
FORCE_N, MOMENT_NM = 6.0, 0.8  # what is asked for at most
SPEED_M_S = 0.25


class Reference(NamedTuple):
    """Where a robot shall be now, and how that moves; m and rad, world frame."""

    place_m: Planar
    yaw: float
    velocity_m_s: Planar = STILL
    acceleration_m_s2: Planar = STILL
    rate_rad_s: float = 0.0
    depth_m: float | None = None  # None: as before
    speed_m_s: float = SPEED_M_S  # at most, beside that of the reference
    most_m_s: float = math.inf  # what the behaviour asks to stay below, whatever the robot may
    turn_rad_s: float = TURN_RAD_S
    most_rad_s: float = math.inf  # likewise
    done: bool = False
    coast: bool = False  # without any force


def wanted_velocity(belief: Belief, to: Reference) -> Planar:
    """v_d, before the barrier."""
    gain = W_RAD_S / (2.0 * Z)
    x, y = gain * (to.place_m[0] - belief.x[0]), gain * (to.place_m[1] - belief.x[1])
    speed = math.sqrt(x * x + y * y)
    if speed > to.speed_m_s:
        x, y = x * to.speed_m_s / speed, y * to.speed_m_s / speed
    return x + to.velocity_m_s[0], y + to.velocity_m_s[1]


def wrench(belief: Belief, hull: Hull, to: Reference, velocity_m_s: Planar) -> Wrench:
    """What to ask the thrusters for, body frame: N ahead, N left, N m. velocity_m_s: v_d after the barrier.

    belief: at the time when it is sent.
    """
    _, _, psi, vx, vy, r, dx, dy, dpsi, munk_kg, gain = belief.x[:11]
    k = damping(hull, math.sqrt(vx * vx + vy * vy))
    stiff = 2.0 * Z * W_RAD_S
    px = hull.mass_kg * (to.acceleration_m_s2[0] + stiff * (velocity_m_s[0] - vx) + k * vx - dx)
    py = hull.mass_kg * (to.acceleration_m_s2[1] + stiff * (velocity_m_s[1] - vy) + k * vy - dy)
    c, s = math.cos(psi), math.sin(psi)
    munk = munk_kg * (c * vx + s * vy) * (c * vy - s * vx)
    c, s = math.cos(psi + r * hull.lag_s), math.sin(psi + r * hull.lag_s)
    turn = YAW_W_RAD_S / (2.0 * Z) * wrap(to.yaw - psi)
    rate = min(max(turn, -to.turn_rad_s), to.turn_rad_s) + to.rate_rad_s
    moment = hull.inertia_kgm2 * (2.0 * Z * YAW_W_RAD_S * (rate - r) + turn_damping(hull, r) * r - dpsi)
    moment = (moment + munk) / (1.0 + gain)
    ahead, left, round_ = (
        f + LEAD * (wish - f) for f, wish in zip(belief.force, (c * px + s * py, c * py - s * px, moment), strict=True)
    )
    size = math.sqrt(ahead * ahead + left * left)
    share = FORCE_N / size if size > FORCE_N else 1.0
    return share * ahead, share * left, min(max(round_, -MOMENT_NM), MOMENT_NM)
