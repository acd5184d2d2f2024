"""Two ways to know how far a ball is, from one sharp picture, and what they are worth together.

Focus: h of the lens position at which the ball's skin is sharpest (paper, section 3). Size: the outline of a ball of
known radius R is a cone of rays with the half angle theta, and its centre is at d = R / sin(theta), off the axis as on
it. Both give d from the point where the camera's rays meet, along the ray to the ball's centre.

Each carries two variances. `random` averages out over measurements. `systematic` does not: the focus fit's own
covariance, the picture's scale, the ball's tolerance, and where an edge seems to lie.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.core.config import Cues, Target
from agent.core.ranging.calibration import Calibration, CameraFit, FocusFit, at_lens_position
from agent.core.ranging.camera_model import centre_behind_skin_m, ray
from agent.core.ranging.focus import h, range_variance
from agent.core.ranging.lens_sag import at_tilt

# Measured on the twin, three cameras, clear and coastal water, 0.32 to 1.2 m: the radius of a whole, sharp outline is
# off by 0.05 to 0.12 px (rms), mostly alike from frame to frame: texture at the rim, and blur that gamma makes uneven.
EDGE_BIAS_PX = 0.09
EDGE_NOISE_PX = 0.03
ARC_POWER = 1.5  # where vision states no sigma, share ** -1.5 times as much: 0.25 px of half an outline
CENTRE_NOISE_PX = 0.1  # of the middle of an outline, beside the residual of the camera's calibration
WARMTH = 0.005  # peak half-widths by which the lens moves as its coil warms up: a tenth of a micrometre
DISAGREE = 5.0  # standard deviations of their difference beyond which focus and size do not speak of one ball


class NoRange(NamedTuple):
    """What was seen gives no range, or two that contradict each other."""

    reason: str


class Outline(NamedTuple):
    """A ball as one frame shows it, or the box around something else."""

    centre_px: tuple[float, float]  # where the ray to the ball's centre meets the image; middle of the box
    radius_px: float | None  # angular radius times the f_px of that lens position; None: no ball
    share: float  # vision's score, 0 to 1; where no sigma is stated, the share of the outline that was seen
    lens_position: float | None  # of that frame
    size_px: tuple[float, float] | None = None  # width and height of the box; None: a ball
    radius_sigma_px: float | None = None  # standard deviation of the radius, as vision states it; None: it does not
    centre_sigma_px: float = CENTRE_NOISE_PX  # of the middle, each way


class Range(NamedTuple):
    """Distance from the point where rays meet to the ball's centre, or to the surface in the middle of the box."""

    distance_m: float
    random_m2: float
    systematic_m2: float
    focus_share: float = 1.0  # how much of it is the focus's word; the rest is the size's

    @property
    def variance_m2(self) -> float:
        return self.random_m2 + self.systematic_m2


def distance(
    calibration: Calibration, outline: Outline, rho: float, sigma_rho: float, ball: Target, cues: Cues, tilt_rad: float
) -> Range | NoRange:
    """What the wanted cues say; NoRange where they have no range, or contradict each other.

    rho, sigma_rho: lens position of the clarity's peak and its standard deviation. tilt_rad: how far the camera looks
    up.
    """
    camera = at_lens_position(calibration.camera, outline.lens_position)
    if cues == "size":
        return size_range(camera, outline, ball)
    focus = focus_range(calibration.focus, camera, outline.centre_px, rho, sigma_rho, ball, tilt_rad)
    if focus is None:
        return NoRange(f"peak at {rho:.0f} is sharp beyond all ranges")
    alone = cues == "focus" or ball.radius_m is None
    return focus if alone else fuse(focus, size_range(camera, outline, ball))


def focus_range(
    fit: FocusFit,
    camera: CameraFit,
    centre_px: tuple[float, float],
    rho: float,
    sigma_rho: float,
    ball: Target,
    tilt_rad: float = 0.0,
) -> Range | None:
    """The skin's z-depth from the pivot is h(rho); the centre lies behind it on the same ray. None beyond the pole.

    Of a thing without known shape the skin is all there is.
    """
    fit = at_tilt(fit, tilt_rad)
    u_m = h(fit, rho)
    if u_m is None:
        return None
    m_z = ray(camera, centre_px)[2]
    skin_m = (u_m - camera.ahead_m) / m_z
    random, systematic = range_variance(fit, rho, sigma_rho)
    travel = rho - fit.rho0
    return Range(
        skin_m + (0.0 if ball.radius_m is None else centre_behind_skin_m(skin_m, ball.radius_m)),
        random / (m_z * m_z),
        (systematic + (fit.b_m / travel**2 * WARMTH * fit.width) ** 2) / (m_z * m_z),
    )


def size_range(camera: CameraFit, outline: Outline, ball: Target) -> Range:
    """d = R / sin(theta), theta = radius_px / f_px at the lens position of the frame.

    Systematic: d / tan(theta) times the edge's bias in radians, the twin's or what vision states if that is more (it
    grows as less of the outline is seen), d times the scale's relative error, d / R times the ball's tolerance, and
    where rays meet.
    """
    assert ball.radius_m is not None and outline.radius_px is not None  # see distance()
    f_px = at_lens_position(camera, outline.lens_position).f_px
    theta = outline.radius_px / f_px
    d = ball.radius_m / math.sin(theta)
    per_px = d / math.tan(theta) / f_px
    if outline.radius_sigma_px is None:
        per_px *= outline.share**-ARC_POWER
    bias_px = max(EDGE_BIAS_PX, outline.radius_sigma_px or 0.0)
    ff, fa, aa = camera.scale_covariance
    # A longer ahead_m is made up for by a shorter d: both count from the pivot.
    scale = d * d * ff + 2.0 * d * fa + aa
    tolerance = d / ball.radius_m * ball.radius_sigma_m
    return Range(
        d,
        (per_px * EDGE_NOISE_PX) ** 2,
        (per_px * bias_px) ** 2 + max(scale, 0.0) + tolerance * tolerance,
        focus_share=0.0,
    )


def fuse(focus: Range, size: Range) -> Range | NoRange:
    """Both, each weighed by the inverse of its whole variance; NoRange where they contradict each other."""
    apart_m, both = focus.distance_m - size.distance_m, focus.variance_m2 + size.variance_m2
    if apart_m * apart_m > DISAGREE * DISAGREE * both:
        return NoRange(
            f"focus says {focus.distance_m:.3f} m, size {size.distance_m:.3f} m, {abs(apart_m) / math.sqrt(both):.0f} "
            "standard deviations apart; check the target's radius_m, or calibrate again"
        )
    w = size.variance_m2 / both
    v = 1.0 - w
    return Range(
        w * focus.distance_m + v * size.distance_m,
        w * w * focus.random_m2 + v * v * size.random_m2,
        w * w * focus.systematic_m2 + v * v * size.systematic_m2,
        focus_share=w,
    )
