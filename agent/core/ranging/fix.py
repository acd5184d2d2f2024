"""One measurement of a target as a place in the world, with a 3x3 covariance in two parts.

x = p + a o + d r: p the gimbal's pivot, a the optical axis along which rays meet o = ahead_m before it, r the unit
ray through the ball's centre or the middle of a box, d the distance along it. To first order the error of x is the sum
of independent ones: along r that of d; across it pixel and gimbal; about the body's centre the error of its attitude;
and that of its place: of a robot that is moored as it was surveyed, of one that swims as its filter has them
(own_pose.py). What averages out over measurements and what does not are kept apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from agent.core.config import Cues, Target
from agent.core.matrix import cross, plus, times
from agent.core.messages import Symmetric, Vector
from agent.core.ranging.calibration import Calibration, at_lens_position
from agent.core.ranging.camera_model import Eye, apply, ray, slopes_per_px
from agent.core.ranging.cues import NoRange, Outline, Range, distance
from agent.core.ranging.own_pose import OwnPose, carried

# What the robot does not know of itself; figures of the twin, which took them from tape measures and cheap sensors.
PLACE_SIGMA_M = 0.0014  # x and y: surveyed to 1 mm, and moored to 1 mm
HEIGHT_SIGMA_M = 0.0007  # pressure: what the tare leaves, and the drift of four sensors in the first minutes
HEADING_SIGMA_DEG = 0.14  # surveyed to 0.1 degrees, and moored to 0.1
LEVEL_SIGMA_DEG = 0.1  # roll and pitch: drift and noise of pressure over a base of 0.26 m
BOX_NOISE = 0.05  # of a box's width and height: trackers tremble by so much, and people draw no better


class Fix(NamedTuple):
    """One measurement of the target's centre in the world."""

    position_m: Vector
    random_m2: Symmetric  # averages out over measurements
    systematic_m2: Symmetric  # does not: calibration and survey, the same in every measurement of this robot
    focus_share: float = 1.0  # of the range, by focus; the rest by size

    @property
    def covariance_m2(self) -> Symmetric:
        xx, xy, xz, yy, yz, zz = (p + q for p, q in zip(self.random_m2, self.systematic_m2, strict=True))
        return xx, xy, xz, yy, yz, zz


def locate(
    calibration: Calibration,
    eye: Eye,
    outline: Outline,
    rho: float,
    sigma_rho: float,
    ball: Target,
    cues: Cues = "both",
    own: OwnPose | None = None,
) -> Fix | NoRange:
    """The ball's centre from its outline in the sharpest frame and from the lens position of the clarity's peak.

    Of what is in a box: the point of its surface behind the middle of the box. own: how well a robot that swims knows
    where it was then; None: it is moored.

    NoRange where the wanted cues have no range, or contradict each other.
    """
    axis = apply(eye.rotation, (0.0, 0.0, 1.0))
    d = distance(calibration, outline, rho, sigma_rho, ball, cues, math.asin(max(-1.0, min(1.0, axis[2]))))
    if isinstance(d, NoRange):
        return d
    camera = at_lens_position(calibration.camera, outline.lens_position)
    m = ray(camera, outline.centre_px)
    r = apply(eye.rotation, m)
    x, y, z = (p + camera.ahead_m * a + d.distance_m * c for p, a, c in zip(eye.position_m, axis, r, strict=True))
    right, down = apply(eye.rotation, (1.0, 0.0, 0.0)), apply(eye.rotation, (0.0, 1.0, 0.0))
    px2 = camera.noise_px**2 + outline.centre_sigma_px**2
    gimbal = math.radians(camera.noise_deg) ** 2
    turns = [(cross(axis_, r), d.distance_m**2 * gimbal) for axis_ in (right, down)]
    along_x, along_y = (_slope_shift(e, r, m_e, m[2], d) for e, m_e in ((right, m[0]), (down, m[1])))
    pushed = [_combine(sx, along_x, sy, along_y) for sx, sy in slopes_per_px(camera, m)]  # by a pixel right, and down
    shifts = [(push, px2) for push in pushed]
    boxed = [(push, (BOX_NOISE * side) ** 2) for push, side in zip(pushed, outline.size_px or (), strict=False)]
    arm = (x - eye.body_m[0], y - eye.body_m[1], z - eye.body_m[2])
    level, heading = math.radians(LEVEL_SIGMA_DEG) ** 2, math.radians(HEADING_SIGMA_DEG) ** 2
    place2 = PLACE_SIGMA_M**2
    if own is not None:
        heading = place2 = 0.0  # its covariances have them
    attitude = [
        (cross(e, arm), s) for e, s in (((1.0, 0.0, 0.0), level), ((0.0, 1.0, 0.0), level), ((0.0, 0.0, 1.0), heading))
    ]
    place = [((1.0, 0.0, 0.0), place2), ((0.0, 1.0, 0.0), place2), ((0.0, 0.0, 1.0), HEIGHT_SIGMA_M**2)]
    random_m2 = _sum([(r, d.random_m2), *turns, *shifts])
    systematic_m2 = _sum([(r, d.systematic_m2), *attitude, *place, *boxed])
    if own is not None:
        random_m2 = plus(random_m2, times(own.kappa, carried(arm, own.fluctuates)))
        systematic_m2 = plus(systematic_m2, carried(arm, own.stays))
    return Fix((x, y, z), random_m2, systematic_m2, d.focus_share)


def _slope_shift(e: Vector, r: Vector, m_e: float, m_z: float, d: Range) -> Vector:
    """dx / d(slope along image axis e): the ray turns by m_z (e - m_e r), and at a given z-depth it grows longer."""
    turn = d.distance_m * m_z
    stretch = d.focus_share * turn * m_e  # d = z / m_z for the focus's share of d; the size's does not care
    return _combine(turn, e, stretch - turn * m_e, r)


def _combine(p: float, a: Vector, q: float, b: Vector) -> Vector:
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]


def _sum(parts: Iterable[tuple[Vector, float]]) -> Symmetric:
    """Sum of s v v^T over (v, s)."""
    xx = xy = xz = yy = yz = zz = 0.0
    for (x, y, z), s in parts:
        xx, xy, xz = xx + s * x * x, xy + s * x * y, xz + s * x * z
        yy, yz, zz = yy + s * y * y, yz + s * y * z, zz + s * z * z
    return xx, xy, xz, yy, yz, zz
