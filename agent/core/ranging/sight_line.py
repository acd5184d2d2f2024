"""One frame of a target as a bearing in the world: no sweep, and so no range but what its size may say: a ball's well,
a creature's hardly, for it may be seen from any side.

Across the ray count the pixel, the gimbal, the body's level, and where the robot was by its own pose: what fluctuates
of it weaker by kappa, what stays as it is (own_pose.py).
"""

from __future__ import annotations

import math

from agent.core.bearing import bearing, ranged
from agent.core.config import Target
from agent.core.estimation.interface import Bearing
from agent.core.matrix import plus, times
from agent.core.messages import Vector
from agent.core.ranging.calibration import CameraFit, at_lens_position
from agent.core.ranging.camera_model import Eye, apply, ray
from agent.core.ranging.cues import Outline, size_range
from agent.core.ranging.fix import LEVEL_SIGMA_DEG
from agent.core.ranging.own_pose import OwnPose, carried

BENDING = 0.03  # of a box's longer side, by which a body that bends moves the middle of its box
HIGH = 0.3  # of a creature's length, as a fish; it heads the way it swims: which side it shows is known where that is
SHOWN = 0.6  # of its length, which it shows from most sides
HIDDEN = 0.5  # of what it lacks to what it ought to show: it may be turned, or a stone hides so much at one of its ends
# Its height is the same from all sides, as long as it swims level: in the twin's rendered dives 0.3 lengths, standard
# deviation of its logarithm 0.2, by what is blurred, bends and pitches; other fish are slimmer, or stouter. What one
# frame says of the range the next ones do, for as long as it keeps its side: half a second of frames count as one.
HIGH_SIGMA, ALIKE = 0.2, 5.0
CUT_PX = 4.0  # from the edge of the picture: there may be more of it beyond
HEADS = 0.5  # of its usual speed: slower, it may face anywhere
TURNS_RAD = 0.6  # by which it may face elsewhere than it is believed to swim: a track knows of a turn when it is over
NEAREST_M = 0.1  # a target that is believed to be nearer would weigh too much


def sight_line(
    camera: CameraFit,
    eye: Eye,
    outline: Outline,
    target: Target,
    own: OwnPose,
    gimbal_sigma_rad: float,
    believed_m: Vector | None,
    t_ns: int,
    unknown_m: float,
    sized: bool = True,
    velocity_m_s: Vector | None = None,
    tilt_sigma_rad: float = 0.0,
) -> Bearing:
    """The bearing of what a frame exposed at t_ns shows.

    eye, own: of that moment. believed_m: where the target is believed to have been then, world frame; it gives the
    range unless a ball's size does. None: nobody knows. unknown_m: the range then. sized: whether its size may say
    anything of the range. velocity_m_s: of the target as it is believed to swim; None: nobody knows.
    tilt_sigma_rad: what the gimbal may be off by up or down besides.
    """
    camera = at_lens_position(camera, outline.lens_position)
    axis = apply(eye.rotation, (0.0, 0.0, 1.0))
    px, py, pz = (p + camera.ahead_m * a for p, a in zip(eye.position_m, axis, strict=True))
    r = apply(eye.rotation, ray(camera, outline.centre_px))
    way = None if believed_m is None else (believed_m[0] - px, believed_m[1] - py, believed_m[2] - pz)
    side = None if velocity_m_s is None else _side(r, velocity_m_s, target)
    sigma_m, far_m = None, _height_range_m(outline, target, camera) if sized else None
    if sized and target.radius_m is not None and outline.radius_px is not None:
        size = size_range(camera, outline, target)
        range_m, sigma_m = size.distance_m, math.sqrt(size.variance_m2)
    elif way is not None:
        range_m = max(r[0] * way[0] + r[1] * way[1] + r[2] * way[2], NEAREST_M)
    else:
        range_m = unknown_m if far_m is None else max(far_m, NEAREST_M)
    arm = px + range_m * r[0] - eye.body_m[0], py + range_m * r[1] - eye.body_m[1], 0.0
    up_m = range_m * tilt_sigma_rad
    pose_m2 = plus(times(own.kappa, carried(arm, own.fluctuates)), carried(arm, own.stays))
    pose_m2 = plus(pose_m2, (0.0, 0.0, 0.0, 0.0, 0.0, up_m * up_m))
    px_sigma = math.hypot(
        camera.noise_px, outline.centre_sigma_px, *_bent_px(outline, target, camera.f_px / range_m, side)
    )
    sigma_rad = math.hypot(px_sigma / camera.f_px, gimbal_sigma_rad, math.radians(LEVEL_SIGMA_DEG))
    line = bearing((px, py, pz), r, range_m, sigma_rad, t_ns, pose_m2, sigma_m, way)
    if far_m is None:
        return line
    return ranged(line, (px, py, pz), r, far_m, HIGH_SIGMA * math.sqrt(ALIKE) * far_m, way)


def _side(ray: Vector, velocity_m_s: Vector, target: Target) -> float | None:
    """Share of its length that what swims so shows to who looks along the ray: 1 from its side; None: nobody knows."""
    u, v = velocity_m_s[:2]
    speed_m_s, far = math.hypot(u, v), math.hypot(ray[0], ray[1])
    if target.speed_m_s is None or speed_m_s < HEADS * target.speed_m_s or far == 0.0:
        return None
    return min(abs(ray[0] * v - ray[1] * u) / (speed_m_s * far), 1.0)


def _bent_px(outline: Outline, target: Target, px_per_m: float, side: float | None) -> tuple[float, float]:
    """How far the middle of a box may be from the body's by its bending, and by what of it does not show."""
    shown_px = max(outline.size_px or (0.0,))
    if target.length_m is None:
        return BENDING * shown_px, 0.0
    whole_px = target.length_m * px_per_m
    shows = SHOWN if side is None else max(math.sin(max(math.asin(side) - TURNS_RAD, 0.0)), HIGH)
    return BENDING * max(shown_px, whole_px), HIDDEN * max(shows * whole_px - shown_px, 0.0)


def _height_range_m(outline: Outline, target: Target, camera: CameraFit) -> float | None:
    """About how far a creature of that length is that is so high in the picture; None: nobody knows its length, or
    not all of its height shows."""
    if target.length_m is None or outline.size_px is None:
        return None
    high_px, y_px = outline.size_px[1], outline.centre_px[1]
    whole = y_px - 0.5 * high_px > CUT_PX and y_px + 0.5 * high_px < camera.height_px - CUT_PX
    return HIGH * target.length_m * camera.f_px / high_px if whole and high_px > 0.0 else None
