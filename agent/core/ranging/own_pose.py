"""What not knowing where one is oneself does to where one says that a target is.

    random += kappa J P_f J' ;  systematic += J B J' ;  J = [e_x, e_y, e_z x arm], arm from the robot to the target

P_f: what fluctuates of (x, y, psi); B: what stays. Errors of a filtered pose are alike from one moment to the next, so
that samples of a target, dt apart, do not average out as independent ones do: n Var(mean) / P tends to
kappa = (1 + phi) / (1 - phi), phi = exp(-dt / tau), by which each sample is therefore made weaker.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from agent.core.matrix import ZERO
from agent.core.messages import Symmetric, Vector

MEMORY_S = 10.0  # how far back gaps between fixes count
# tau of a filtered pose: measured 0.25 s with fixes at 5 Hz, 0.75 s with gaps of 2 s in every 4.
TAU_S, TAU_OF_GAP = 0.3, 0.25


class OwnPose(NamedTuple):
    """How well a robot knows its x, y and yaw where a target was seen: covariances, m and rad."""

    fluctuates: Symmetric
    stays: Symmetric
    kappa: float


EXACT = OwnPose(ZERO, ZERO, 1.0)  # for a measurement from the robot instead of in the world


def kappa(since_last_s: float, gap_s: float) -> float:
    """By how much a sample is worth less than an independent one. since_last_s: since the robot's sample before it."""
    phi = math.exp(-since_last_s / (TAU_S + TAU_OF_GAP * gap_s))
    return (1.0 + phi) / (1.0 - phi)


def longest_gap_s(fixes_ns: Iterable[int], now_ns: int) -> float:
    """The longest time without a fix of late; fixes_ns: their exposures, oldest first."""
    last_ns, longest_ns = now_ns - round(MEMORY_S * 1e9), 0
    for t_ns in (*fixes_ns, now_ns):
        if t_ns > last_ns:
            longest_ns, last_ns = max(longest_ns, t_ns - last_ns), t_ns
    return longest_ns * 1e-9


def carried(arm_m: Vector, of_pose: Symmetric) -> Symmetric:
    """J P J': what an uncertain (x, y, psi) does to a place that lies arm_m from the robot, world frame."""
    xx, xy, xp, yy, yp, pp = of_pose
    jx, jy = -arm_m[1], arm_m[0]  # e_z x arm
    return (
        xx + 2.0 * jx * xp + jx * jx * pp,
        xy + jy * xp + jx * yp + jx * jy * pp,
        0.0,
        yy + 2.0 * jy * yp + jy * jy * pp,
        0.0,
        0.0,
    )
