"""One measurement of a target as a place in the world, with a 3x3 covariance in two parts; or as a bearing.

x = p + a o + d r: p the gimbal's pivot, a the optical axis along which rays meet o = ahead_m before it, r the unit
ray through the ball's centre or the middle of a box, d the distance along it. To first order the error of x is the sum
of independent ones: along r that of d; across it pixel and gimbal; about the body's centre the error of its attitude;
and that of its place: of a robot that is moored as it was surveyed, of one that swims as its filter has them
(`OwnPose`). What averages out over measurements and what does not are kept apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from agent.core.attitude import DEPTH_NOISE_M, LEVEL_NOISE_RAD, TARED, Zeros
from agent.core.config import CAREFUL, Budget, Cues, Target
from agent.core.estimation.evidence_table import inside
from agent.core.estimation.interface import NOTHING, Bearing
from agent.core.linear_algebra import ZERO, cross, difference, plus, times
from agent.core.messages import Symmetric, Vector
from agent.core.ranging.camera_model import (
    Calibration,
    CameraFit,
    Eye,
    FocusFit,
    apply,
    at_lens_position,
    centre_behind_skin_m,
    pixel,
    ray,
    slopes_per_px,
    to_camera,
)
from agent.core.ranging.focus import at_tilt, h, in_direction, port_share, range_variance, through_port
from agent.core.target_state import bearing, ranged
from agent.core.verdict import Ratio

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
BOX_NOISE = 0.05  # of a box's width and height: trackers jitter by so much, and people draw no better


class Fix(NamedTuple):
    """One measurement of the target's centre in the world."""

    position_m: Vector
    random_m2: Symmetric  # averages out over measurements
    systematic_m2: Symmetric  # does not: the same in every measurement of this robot, and of no other
    focus_share: float = 1.0  # of the range, by focus; the rest by size
    lever_m: Vector = (0.0, 0.0, 0.0)  # from the camera to there
    drift_m2_s2: Symmetric = NOTHING  # of how fast the systematic error changes

    @property
    def covariance_m2(self) -> Symmetric:
        xx, xy, xz, yy, yz, zz = (p + q for p, q in zip(self.random_m2, self.systematic_m2, strict=True))
        return xx, xy, xz, yy, yz, zz


def locate(
    calibration: Calibration,
    eye: Eye,
    outline: Outline,
    rho: float | None,
    sigma_rho: float,
    ball: Target,
    cues: Cues = "both",
    own: OwnPose | None = None,
    budget: Budget = CAREFUL,
    zeros: Zeros = TARED,
) -> Fix | NoRange:
    """The ball's centre from its outline in the sharpest frame and from the lens position of the clarity's peak. By the
    outline alone where the focus is fixed (rho: None); of a thing of unknown size that is a bearing.

    Of what is in a box: the point of its surface behind the middle of the box. own: how well a robot that swims knows
    where it was then; None: it is moored. budget: of it counts what each robot has wrong for itself; what all have
    alike, the ball's radius too, is added where their measurements are put together (protocols.shared_of). zeros: by
    then, of the sensors that tell height and attitude.

    NoRange where the wanted cues have no range, or contradict each other.
    """
    axis = apply(eye.rotation, (0.0, 0.0, 1.0))
    d = distance(calibration, outline, rho, sigma_rho, ball, cues, eye.tilt_rad)
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
    heading, place2 = math.radians(budget.heading_deg) ** 2, budget.place_m**2
    if own is not None:
        heading = place2 = 0.0  # `own` has them
    rolled, pitched, turned = (cross(e, arm) for e in (X, Y, Z))
    white = [(rolled, LEVEL_NOISE_RAD**2), (pitched, LEVEL_NOISE_RAD**2), (Z, DEPTH_NOISE_M**2)]
    attitude = [(rolled, zeros.tilt_rad**2), (pitched, zeros.tilt_rad**2), (turned, heading)]
    place = [(X, place2), (Y, place2), (Z, zeros.height_m**2)]
    drift_m2_s2 = _sum([(rolled, zeros.tilt_rad_s**2), (pitched, zeros.tilt_rad_s**2), (Z, zeros.height_m_s**2)])
    random_m2 = _sum([(r, d.random_m2), *turns, *shifts, *white])
    systematic_m2 = _sum([(r, d.systematic_m2), *attitude, *place, *boxed])
    if own is not None:
        random_m2 = plus(random_m2, times(own.kappa, carried(arm, own.fluctuates)))
        systematic_m2 = plus(systematic_m2, carried(arm, own.stays))
    lever_m = difference((x, y, z), eye.position_m)
    return Fix((x, y, z), random_m2, systematic_m2, d.focus_share, lever_m, drift_m2_s2)


def _slope_shift(e: Vector, r: Vector, m_e: float, m_z: float, d: Range) -> Vector:
    """dx / d(slope along image axis e): the ray turns by m_z (e - m_e r), and at a given z-depth it grows longer."""
    turn = d.distance_m * m_z
    stretch = d.focus_share * turn * m_e  # d = z / m_z for the focus's share of d; the size's does not change
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


# --- range by focus and by size ---
# Two ways to know how far a ball is, from one sharp picture, and the weights by which they are combined.
#
# Focus: h of the lens position at which the ball's skin is sharpest (paper, section 3). Size: the outline of a ball of
# known radius R is a cone of rays with the half angle theta, and its centre is at d = R / sin(theta), off the axis as
# on it. Both give d from the point where the camera's rays meet, along the ray to the ball's centre.
#
# Each carries three variances. `random` averages out over measurements. `systematic` does not: the focus fit's own
# covariance, the picture's scale, and where an edge seems to lie. Nor does `shared`, which all robots have alike: the
# ball's tolerance.

# Measured on the twin, three cameras, clear and coastal water, 0.32 to 1.2 m: the radius of a whole, sharp outline is
# off by 0.05 to 0.12 px (rms), mostly alike from frame to frame: texture at the rim, and blur that gamma makes uneven.
EDGE_BIAS_PX = 0.09
EDGE_NOISE_PX = 0.03
ARC_POWER = 1.5  # where vision states no sigma, share ** -1.5 times as much: 0.25 px of half an outline
CENTRE_NOISE_PX = 0.1  # of the middle of an outline, beside the residual of the camera's calibration
TEXTURE = 0.1  # share by which what a port does may be off, for texture runs in some directions more than in others
WARMTH = 0.005  # peak half-widths by which the lens moves as its coil warms up: a tenth of a micrometre
FARTHEST_M = 1.2  # so far a target is found in most kinds of water
TURNED = 0.25  # of the range, standard deviation: a thing of known length shows less of it from most sides
DISAGREE = 5.0  # standard deviations of their difference beyond which focus and size do not speak of one ball


class NoRange(NamedTuple):
    """What was seen gives no range, or two that contradict each other."""

    reason: str
    contradicts: bool = False


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
    focus_share: float = 1.0  # how much of it is by focus; the rest is by size
    shared_m2: float = 0.0

    @property
    def variance_m2(self) -> float:
        return self.random_m2 + self.systematic_m2 + self.shared_m2


def distance(
    calibration: Calibration,
    outline: Outline,
    rho: float | None,
    sigma_rho: float,
    ball: Target,
    cues: Cues,
    tilt_rad: float,
) -> Range | NoRange:
    """The range by the wanted cues; NoRange where they have no range, or contradict each other.

    rho, sigma_rho: lens position of the clarity's peak and its standard deviation; None: the focus is fixed. tilt_rad:
    how far the camera looks up.
    """
    camera = at_lens_position(calibration.camera, outline.lens_position)
    if cues == "size":
        return size_range(camera, outline, ball)
    if calibration.focus is None or rho is None:
        return fixed_focus_range(camera, outline, ball)
    focus = focus_range(calibration.focus, camera, outline.centre_px, rho, sigma_rho, ball, tilt_rad)
    if focus is None:
        return NoRange(f"peak at {rho:.0f} is sharp beyond all ranges")
    alone = cues == "focus" or ball.radius_m is None
    return focus if alone else fuse(focus, size_range(camera, outline, ball))


def cue_ratio(
    calibration: Calibration, outline: Outline, rho: float | None, sigma_rho: float, ball: Target, tilt_rad: float
) -> Ratio | None:
    """How the range by focus stands to that by size; None where one of them is missing."""
    if calibration.focus is None or rho is None:
        return None
    camera = at_lens_position(calibration.camera, outline.lens_position)
    focus = focus_range(calibration.focus, camera, outline.centre_px, rho, sigma_rho, ball, tilt_rad)
    if focus is None or ball.radius_m is None or outline.radius_px is None:
        return None
    size = size_range(camera, outline, ball)
    stays_m2 = size.systematic_m2 + size.shared_m2
    random, systematic = (
        (f / focus.distance_m**2 + s / size.distance_m**2)
        for f, s in ((focus.random_m2, size.random_m2), (focus.systematic_m2, stays_m2))
    )
    return Ratio(math.log(focus.distance_m / size.distance_m), random, systematic)


def focus_range(
    fit: FocusFit,
    camera: CameraFit,
    centre_px: tuple[float, float],
    rho: float,
    sigma_rho: float,
    ball: Target,
    tilt_rad: float = 0.0,
) -> Range | None:
    """The skin's z-depth from the pivot is h(rho), by as much more as the port makes it look nearer off the axis; the
    centre lies behind it on the same ray. None beyond the pole.

    Of a thing without known shape the skin is all there is.
    """
    fit = in_direction(at_tilt(fit, tilt_rad), camera, centre_px, rho)
    sharp_m = h(fit, rho)
    if sharp_m is None:
        return None
    m_z, share = ray(camera, centre_px)[2], port_share(camera, centre_px)
    u_m = through_port(sharp_m, share)
    skin_m = (u_m - camera.ahead_m) / m_z
    random, systematic = range_variance(fit, rho, sigma_rho)
    travel = rho - fit.rho0
    systematic += (fit.b_m / travel**2 * WARMTH * fit.width) ** 2
    per_m = 1.0 / (share * m_z)
    stripes_m = TEXTURE * (1.0 - share) * u_m / m_z
    return Range(
        skin_m + (0.0 if ball.radius_m is None else centre_behind_skin_m(skin_m, ball.radius_m)),
        random * per_m * per_m,
        systematic * per_m * per_m + stripes_m * stripes_m,
    )


def size_range(camera: CameraFit, outline: Outline, ball: Target) -> Range:
    """d = R / sin(theta), theta = radius_px / f_px at the lens position of the frame.

    Systematic: d / tan(theta) times the edge's bias in radians, the twin's or what vision states if that is more (it
    grows as less of the outline is seen), d times the scale's relative error, and where rays meet. Shared: d / R times
    the ball's tolerance.
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
        (per_px * bias_px) ** 2 + max(scale, 0.0),
        focus_share=0.0,
        shared_m2=tolerance * tolerance,
    )


def fixed_focus_range(camera: CameraFit, outline: Outline, target: Target) -> Range:
    """By the size of a ball; of a thing in a box by its length, if that is known; else any range within which targets
    are found, which leaves a bearing. What a size does not say it does not say in any frame: it is systematic."""
    if target.radius_m is not None and outline.radius_px is not None:
        return size_range(camera, outline, target)
    if target.length_m is not None and outline.size_px is not None:
        far_m = min(target.length_m * camera.f_px / max(*outline.size_px, 1.0), FARTHEST_M)
        return Range(far_m, 0.0, (TURNED * far_m) ** 2, focus_share=0.0)
    return Range(0.5 * FARTHEST_M, 0.0, FARTHEST_M**2 / 12.0, focus_share=0.0)


def fuse(focus: Range, size: Range) -> Range | NoRange:
    """Both ranges, each weighted by the inverse of its whole variance; NoRange where they contradict each other."""
    apart_m, both = focus.distance_m - size.distance_m, focus.variance_m2 + size.variance_m2
    if apart_m * apart_m > DISAGREE * DISAGREE * both:
        return NoRange(
            f"focus says {focus.distance_m:.3f} m, size {size.distance_m:.3f} m, {abs(apart_m) / math.sqrt(both):.0f} "
            "standard deviations apart; check the target's radius_m, or calibrate again",
            contradicts=True,
        )
    w = size.variance_m2 / both
    v = 1.0 - w
    return Range(
        w * focus.distance_m + v * size.distance_m,
        w * w * focus.random_m2 + v * v * size.random_m2,
        w * w * focus.systematic_m2 + v * v * size.systematic_m2,
        focus_share=w,
        shared_m2=v * v * size.shared_m2,
    )


def shows_whole(calibration: Calibration, eye: Eye, target: Target, x_m: Vector, covariance_m2: Symmetric) -> bool:
    """Whether a camera there has all of a target in its picture, in reach of its lens, wherever it is by 3 sigma."""
    camera, fit = calibration.camera, calibration.focus
    at = to_camera(eye, x_m)
    centre_px, nearest_m = pixel(camera, at), 0.0 if fit is None else h(fit, fit.highest)
    sigma_m = math.sqrt(max(covariance_m2[0], covariance_m2[3], covariance_m2[5]))
    size_m = target.radius_m or 0.5 * (target.length_m or 0.0)
    if centre_px is None or nearest_m is None or not max(nearest_m, 3.0 * sigma_m) < at[2] < FARTHEST_M:
        return False
    rim_px = camera.f_px * (size_m + 3.0 * sigma_m) / at[2]
    u, v = centre_px
    return rim_px < min(u, camera.width_px - u, v, camera.height_px - v)


# --- uncertainty of the robot's own pose ---
# What an uncertain pose of the robot adds to the place of a target that it measures.
#
# random += kappa J P_f J' ;  systematic += J B J' ;  J = [e_x, e_y, e_z x arm], arm from the robot to the target
#
# P_f: what fluctuates of (x, y, psi); B: what stays. Errors of a filtered pose are alike from one moment to the next,
# so that samples of a target, dt apart, do not average out as independent ones do: n Var(mean) / P tends to
# kappa = (1 + phi) / (1 - phi), phi = exp(-dt / tau), by which each sample is therefore made weaker.

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
    """By how much a sample weighs less than an independent one. since_last_s: since the robot's sample before it."""
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


# --- bearing by one frame ---
# One frame of a target as a bearing in the world: no sweep, and so no range but what its size may say: a ball's well, a
# creature's hardly, for it may be seen from any side.
#
# Across the ray count the pixel, the gimbal, the body's level, and where the robot was by its own pose: what fluctuates
# of it weaker by kappa, what stays as it is (`OwnPose`).

BENDING = 0.03  # of a box's longer side, by which a body that bends moves the middle of its box
HIGH = 0.3  # of a creature's length, as a fish; it heads the way it swims: the side it shows is known where that is
SHOWN = 0.6  # of its length, which it shows from most sides
HIDDEN = 0.5  # of what it lacks to what it ought to show: it may be turned, or a stone hides so much at one of its ends
# Its height is the same from all sides, as long as it swims level: in rendered dives 0.3 lengths, standard deviation of
# its logarithm 0.25 within 1.1 m, by what is blurred, bends and pitches; other fish are slimmer, or stouter. Beyond,
# half of it is found: it seems to be twice as far, and is where a target is found at all (FARTHEST_M). What one frame
# says of the range the next ones do: a second of frames counts as one.
HIGH_SIGMA, ALIKE = 0.3, 10.0
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
    tank_m: Vector,
    sized: bool = True,
    velocity_m_s: Vector | None = None,
    tilt_sigma_rad: float = 0.0,
    zeros: Zeros = TARED,
) -> Bearing:
    """The bearing of what a frame exposed at t_ns shows.

    eye, own: of that moment. believed_m: where the target is believed to have been then, world frame; it gives the
    range unless a ball's size does. None: unknown. tank_m: where it is for certain. sized: whether its size may say
    anything of the range. velocity_m_s: of the target as it is believed to swim; None: unknown.
    tilt_sigma_rad: what the gimbal may be off by up or down besides.
    """
    camera = at_lens_position(camera, outline.lens_position)
    axis = apply(eye.rotation, (0.0, 0.0, 1.0))
    px, py, pz = (p + camera.ahead_m * a for p, a in zip(eye.position_m, axis, strict=True))
    r = apply(eye.rotation, ray(camera, outline.centre_px))
    way = None if believed_m is None else (believed_m[0] - px, believed_m[1] - py, believed_m[2] - pz)
    side = None if velocity_m_s is None else _side(r, velocity_m_s, target)
    sigma_m, far_m = None, _height_range_m(outline, target, camera) if sized else None
    if far_m is not None and not inside((px + far_m * r[0], py + far_m * r[1], pz + far_m * r[2]), tank_m):
        far_m = None  # not all of it is seen, or it is no such animal: where it is across is right all the same
    if sized and target.radius_m is not None and outline.radius_px is not None:
        size = size_range(camera, outline, target)
        range_m, sigma_m = size.distance_m, math.sqrt(size.variance_m2)
    elif way is not None:
        range_m = max(r[0] * way[0] + r[1] * way[1] + r[2] * way[2], NEAREST_M)
    else:
        range_m = 0.5 * max(tank_m) if far_m is None else max(far_m, NEAREST_M)
    arm = px + range_m * r[0] - eye.body_m[0], py + range_m * r[1] - eye.body_m[1], 0.0
    up_m = range_m * tilt_sigma_rad
    pose_m2 = plus(times(own.kappa, carried(arm, own.fluctuates)), carried(arm, own.stays))
    pose_m2 = plus(pose_m2, (0.0, 0.0, 0.0, 0.0, 0.0, up_m * up_m))
    px_sigma = math.hypot(
        camera.noise_px, outline.centre_sigma_px, *_bent_px(outline, target, camera.f_px / range_m, side)
    )
    sigma_rad = math.hypot(px_sigma / camera.f_px, gimbal_sigma_rad, LEVEL_NOISE_RAD, zeros.tilt_rad)
    line = bearing((px, py, pz), r, range_m, sigma_rad, t_ns, pose_m2, sigma_m, way)
    if far_m is None:
        return line
    return ranged(line, (px, py, pz), r, far_m, HIGH_SIGMA * math.sqrt(ALIKE) * far_m, way)


def _side(ray: Vector, velocity_m_s: Vector, target: Target) -> float | None:
    """Share of its length that a target that swims so shows along the ray: 1 from its side; None: unknown."""
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
    """About how far a creature of that length is that is so high in the picture; None: its length is unknown, or not
    all of its height shows."""
    if target.length_m is None or target.detector == "box" or outline.size_px is None:
        return None
    high_px, y_px = outline.size_px[1], outline.centre_px[1]
    whole = y_px - 0.5 * high_px > CUT_PX and y_px + 0.5 * high_px < camera.height_px - CUT_PX
    return min(HIGH * target.length_m * camera.f_px / high_px, FARTHEST_M) if whole and high_px > 0.0 else None
