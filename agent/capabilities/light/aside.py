"""A ball that is lit from aside: which of its cues hold, and where its middle is when only its lit part was outlined.

The edge towards the lamp is the ball's own, the one opposite is where its shadow begins. With the radius r of the
outline, the radius R that the ball must have in the picture at the range of its focus, and u the way to the lamp:

    middle = outline's middle - (R - r) u

Its size says nothing of its range then, so that the focus alone counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from agent.core.config import Cues, Target
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, Eye, at_lens_position, ray, to_camera
from agent.core.ranging.fix import Outline, focus_range

LEAST_PX = 3.0  # of R - r: twice what the range by focus leaves open of R at 1.5 m
MOST = 0.4  # of R: an outline that lacks more is of something else
ONE_SIDE = 0.5  # cosine between ways to lamps, above which they light the same side

# By pictures of nights with seeds 3, 11 and 15, 1.3 m from the ball: peaks scatter by so much more than their curves
# and the size of the outline say, for part of it is dark, and the rest dim; and its middle wanders by so many pixels.
SCATTERS = 1.75
WANDERS_PX = 2.0


def cues_by(cues: Cues) -> Cues:
    """What of the wanted cues a lamp from aside leaves."""
    return "focus" if cues == "both" else cues


def whole(
    calibration: Calibration,
    eye: Eye,
    outline: Outline,
    rho: float,
    sigma: float,
    ball: Target,
    lamps_m: Sequence[Vector],
) -> Outline:
    """The outline of the ball, where that was one of its lit part. lamps_m: places of the lamps that burned."""
    ways = []
    camera = at_lens_position(calibration.camera, outline.lens_position)
    if ball.radius_m is None or outline.radius_px is None or not lamps_m:
        return outline
    far = focus_range(calibration.focus, camera, outline.centre_px, rho, sigma, ball)
    if far is None or far.distance_m <= ball.radius_m:
        return outline
    whole_px = camera.f_px * math.asin(ball.radius_m / far.distance_m)
    lacks_px = whole_px - outline.radius_px
    if not LEAST_PX <= lacks_px <= MOST * whole_px:
        return outline
    at = tuple(far.distance_m * part for part in ray(camera, outline.centre_px))
    for place_m in lamps_m:
        x, y, _ = (lamp - ball_at for lamp, ball_at in zip(to_camera(eye, place_m), at, strict=True))
        length = math.hypot(x, y)
        if length > 0.0:
            ways.append((x / length, y / length))
    x, y = sum(way[0] for way in ways), sum(way[1] for way in ways)
    length = math.hypot(x, y)
    if not ways or length < 1e-6 or any(way[0] * x + way[1] * y < ONE_SIDE * length for way in ways):
        return outline  # from both sides: there is no telling which edge is whose
    u, v = outline.centre_px
    centre_px = u - lacks_px * x / length, v - lacks_px * y / length
    return outline._replace(centre_px=centre_px, radius_px=whole_px)
