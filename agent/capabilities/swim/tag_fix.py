"""A robot's place and yaw from the landmarks of one frame, with a covariance in two parts.

    theta = (x, y, psi, depth, roll, pitch, pan, tilt)
    minimise  sum_t rho(|| L_t^-1 f (s(theta) - s_t) ||) + sum_k ((theta_k - prior_k) / sigma_k)^2

over tags t with V_t = L_t L_t' (projection.tag_noise), rho Huber's per tag, by Gauss-Newton. Depth, level and gimbal
are known beforehand but not exactly; place and yaw have no prior: a fix owes nothing to the prediction that it starts
from. The covariance of (x, y, psi) is the block of (J' W J)^-1, and what the camera's calibration has wrong. Part of
it, which survey, priors and calibration have wrong in the same way in every frame, no filter may take for noise: B.

`tag_fix` begins at a predicted pose; `first_fix` has nothing to begin from.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from agent.capabilities.swim.landmarks import Marker, normal
from agent.capabilities.swim.projection import (
    CameraAxes,
    Seen,
    TagNoise,
    Theta,
    View,
    camera_axes,
    direction,
    seen,
    slope_error,
    tag_noise,
    upright,
)
from agent.core.attitude import DEPTH_NOISE_M, LEVEL_NOISE_RAD, TARED, Attitude, Zeros
from agent.core.config import Landmarks
from agent.core.linear_algebra import (
    ZERO,
    backward,
    cholesky,
    dot,
    dot8,
    forward,
    forward_all,
    forward_nine,
    lower_inverse,
    minus,
    plus,
    wrap,
)
from agent.core.messages import Symmetric
from agent.core.step_io import SeenTag

# --- priors ---
# What is known of depth, level and gimbal before any tag is seen, and how well.

WAKE_DEG_S2_M2 = 16.0  # dynamic pressure over the same base: at 0.25 m/s the body pitches by 1.0 degrees
REST_DEG = 0.02  # a servo at rest, after an approach from its low side
TURNING_DEG = 0.3  # and while it turns


class Prior(NamedTuple):
    """One angle, rad, or the depth, m."""

    value: float
    fluctuates: float  # sigma of what differs from frame to frame
    stays: float = 0.0  # sigma of what is the same in every frame

    @property
    def variance(self) -> float:
        return self.fluctuates * self.fluctuates + self.stays * self.stays


class Priors(NamedTuple):
    depth: Prior
    roll: Prior
    pitch: Prior
    pan: Prior
    tilt: Prior


def wake_rad(speed_m_s: float) -> float:
    """Sigma of what roll and pitch are off by as a robot swims."""
    return math.radians(WAKE_DEG_S2_M2 * speed_m_s * speed_m_s)


def priors(
    level: Attitude,
    gimbal_deg: tuple[float, float],
    speed_m_s: float,
    turning: bool,
    zero_deg: float = 0.0,
    lag_deg: float = 0.0,
    zeros: Zeros = TARED,
) -> Priors:
    """What telemetry and pulses say at the time of a frame.

    gimbal_deg: pan and tilt as the servos really do them; turning: whether they may still be moving; zero_deg: sigma of
    their calibrated zeros, which is in every frame the same; lag_deg: of how far they are behind what they are told;
    zeros: of the sensors; what they make wrong stays for minutes.
    """
    fluctuates = max(LEVEL_NOISE_RAD, wake_rad(speed_m_s))
    roll, pitch = (Prior(math.radians(deg), fluctuates, zeros.tilt_rad) for deg in (level.roll_deg, level.pitch_deg))
    servo_deg = math.hypot(TURNING_DEG if turning else REST_DEG, lag_deg)
    pan, tilt = (Prior(math.radians(deg), math.radians(servo_deg), math.radians(zero_deg)) for deg in gimbal_deg)
    return Priors(Prior(level.depth_m, DEPTH_NOISE_M, zeros.height_m), roll, pitch, pan, tilt)


# --- fix from a prediction ---

HUBER = 4.0  # whitened norm of a tag's eight residuals, whose mean is 2.8 where all is well
ROUNDS = 12  # Gauss-Newton from a filter's prediction needs 3
SETTLED = 1e-5  # m and rad: a last step, after which less than a hundredth of that is left to go
STRAY_M = 50.0  # a step longer than this has left the tank, and will not come back


class Map(NamedTuple):
    """What the fleet file says of landmarks."""

    landmarks: Landmarks
    markers: Mapping[int, Marker]  # landmarks.markers(landmarks)


class TagFix(NamedTuple):
    """Where the tags of one frame put the robot. Covariances of (x, y, psi), m and rad."""

    theta: Theta
    covariance: Symmetric  # of all errors
    stays: Symmetric  # B: the part that is the same in every frame
    cost: float  # what was minimised, at the minimum
    tags: int  # that were used
    odd: int  # of these, beyond Huber's limit: seen elsewhere than the others say

    @property
    def fluctuates(self) -> Symmetric:
        """What a filter over many fixes may take for noise: R - B."""
        return minus(self.covariance, self.stays)


class NoFix(NamedTuple):
    reason: str
    ambiguous: bool = False  # more than one pose explains the tags: nothing is wrong with them


class _Used(NamedTuple):
    tag: SeenTag
    marker: Marker
    noise: TagNoise


class _Normal(NamedTuple):
    """Sums at one theta."""

    H: list[list[float]]  # J' W J
    g: list[float]  # J' W r, r = seen less expected
    cost: float
    weights: list[float]  # of each tag
    columns: list[list[tuple[float, ...]]]  # whitened J of each tag, its 8 columns


class _Minimum(NamedTuple):
    theta: Theta
    normal: _Normal
    L: list[list[float]]  # of normal.H
    settled: bool


def tag_fix(
    of: View, priors: Priors, known: Map, tags: Sequence[SeenTag], start: tuple[float, float, float]
) -> TagFix | NoFix:
    """The pose from the tags of one frame. start: x, y, psi to begin from, as a filter predicts them.

    Where half of the tags and more are seen elsewhere than the others say, that which is farthest off is left out.
    """
    used = _used(of, known, tags, whole(start, priors))
    while used:
        found = _descend(of, priors, used, whole(start, priors))
        if isinstance(found, NoFix):
            return found
        odd = sum(weight < 1.0 for weight in found.normal.weights)
        if found.settled and 2 * odd < len(used):
            return _fix(of, priors, used, found)
        if len(used) < 3:
            return NoFix("the tags contradict each other, or the map")
        worst = min(range(len(used)), key=lambda k: found.normal.weights[k])
        used = used[:worst] + used[worst + 1 :]
    return NoFix("no tag of the map is before the camera")


def _descend(of: View, priors: Priors, used: Sequence[_Used], theta: Theta) -> _Minimum | NoFix:
    """Gauss-Newton from theta."""
    found: _Minimum | NoFix = NoFix("no pose explains the tags")
    for _ in range(ROUNDS):
        normal = _normal(of, priors, used, theta)
        L = None if normal is None else cholesky(normal.H)
        if normal is None or L is None:
            return NoFix("the tags do not say where the robot is")
        step = backward(L, forward(L, normal.g))
        size = max(abs(part) for part in step)
        if not size < STRAY_M:
            return NoFix("no pose explains the tags")
        theta = _moved(theta, step)
        found = _Minimum(theta, normal, L, size < SETTLED)
        if found.settled:
            break
    return found


def whole(start: tuple[float, float, float], priors: Priors) -> Theta:
    """theta with that place and yaw, and all else as it was known beforehand."""
    depth, roll, pitch, pan, tilt = (prior.value for prior in priors)
    return (*start, depth, roll, pitch, pan, tilt)


def _moved(theta: Theta, step: Sequence[float]) -> Theta:
    x, y, psi, depth, roll, pitch, pan, tilt = (a + b for a, b in zip(theta, step, strict=True))
    return x, y, wrap(psi), depth, roll, pitch, pan, tilt


def _used(of: View, known: Map, tags: Sequence[SeenTag], theta: Theta) -> list[_Used]:
    """Tags that are on the map and before the camera, in the order of their ids, with their noise at this theta.

    Of an id that is seen twice neither counts: one of them is something else.
    """
    at, used = camera_axes(of, theta), []
    ids = [tag.id for tag in tags]
    for tag in sorted(tags, key=lambda tag: tag.id):
        marker = known.markers.get(tag.id)
        if marker is None or ids.count(tag.id) > 1:
            continue
        expected = _expected(of, at, marker)
        noise = None if expected is None else tag_noise(of, tag, marker, expected, known.landmarks)
        if noise is not None:
            used.append(_Used(tag, marker, noise))
    return used


def _expected(of: View, at: CameraAxes, marker: Marker) -> tuple[Seen, ...] | None:
    """The four corners as they should be seen; None where one is not before the camera."""
    expected: list[Seen] = []
    for corner in marker.corners_m:
        point = seen(of, at, corner)
        if point is None:
            return None
        expected.append(point)
    return tuple(expected)


def _normal(of: View, priors: Priors, used: Sequence[_Used], theta: Theta) -> _Normal | None:
    """None where a tag is not before the camera."""
    at, cost = camera_axes(of, theta), 0.0
    H, g = [[0.0] * 8 for _ in range(8)], [0.0] * 8
    weights: list[float] = []
    whitened: list[list[tuple[float, ...]]] = []
    for tag, marker, noise in used:
        expected = _expected(of, at, marker)
        if expected is None:
            return None
        rows = []  # derivatives by theta, then the miss
        for (u, v), point in zip(tag.corners, expected, strict=True):
            by_u, by_v = point.by_theta
            rows += [(*by_u, u - point.slope[0]), (*by_v, v - point.slope[1])]
        *J, r = zip(*forward_nine(noise.L, [[of.f_px * part for part in row] for row in rows]), strict=True)
        norm = math.sqrt(dot8(r, r))
        weight = 1.0 if norm <= HUBER else HUBER / norm
        cost += norm * norm if norm <= HUBER else HUBER * (2.0 * norm - HUBER)
        for i, column in enumerate(J):
            g[i] += weight * dot8(column, r)
            for k in range(i + 1):
                H[i][k] += weight * dot8(column, J[k])
        weights.append(weight)
        whitened.append(J)
    for i, prior in enumerate(priors, start=3):
        off, precision = prior.value - theta[i], 1.0 / prior.variance
        H[i][i] += precision
        g[i] += precision * off
        cost += precision * off * off
    return _Normal(H, g, cost, weights, whitened)


def _fix(of: View, priors: Priors, used: Sequence[_Used], found: _Minimum) -> TagFix:
    """The fix at the minimum, and its covariance."""
    normal, C = found.normal, lower_inverse(found.L)
    odd = sum(weight < 1.0 for weight in normal.weights)
    stays = ZERO
    for (_, _, noise), weight, J in zip(used, normal.weights, normal.columns, strict=True):
        for error in zip(*forward_all(noise.L, noise.survey), strict=True):  # six, each as it moves the corners
            pull = [weight * dot8(column, error) for column in J]
            stays = plus(stays, _outer(dot(C[0], pull), dot(C[1], pull), dot(C[2], pull)))
    for k, prior in enumerate(priors, start=3):
        gain = prior.stays / prior.variance
        stays = plus(stays, _outer(gain * C[0][k], gain * C[1][k], gain * C[2][k]))
    by_lens = ZERO
    for pull in _lens_pulls(of, priors, used, found):
        by_lens = plus(by_lens, _outer(dot(C[0], pull), dot(C[1], pull), dot(C[2], pull)))
    covariance = plus((C[0][0], C[0][1], C[0][2], C[1][1], C[1][2], C[2][2]), by_lens)
    return TagFix(found.theta, covariance, plus(stays, by_lens), normal.cost, len(used), odd)


def _lens_pulls(of: View, priors: Priors, used: Sequence[_Used], found: _Minimum) -> list[list[float]]:
    """What each error of the calibration adds to J' W r: all tags are moved at once, and the gimbal turns."""
    if not of.errors:
        return []
    at, pan, tilt = camera_axes(of, found.theta), found.theta[6], found.theta[7]
    pulls = [
        [0.0] * 6
        + [(error.pan + error.pan_gain * pan) / priors.pan.variance]
        + [(error.tilt + error.tilt_gain * tilt) / priors.tilt.variance]
        for error in of.errors
    ]
    for (tag, marker, noise), weight, J in zip(used, found.normal.weights, found.normal.columns, strict=True):
        expected = _expected(of, at, marker)
        if expected is None:  # the last step, a hundredth of a millimetre, took it out of sight
            continue
        rows = []
        for slope, point in zip(tag.corners, expected, strict=True):
            moved = [slope_error(error, of.bend, slope, point.per_m) for error in of.errors]
            rows += [[of.f_px * du for du, _ in moved], [of.f_px * dv for _, dv in moved]]
        for pull, error_px in zip(pulls, zip(*forward_all(noise.L, rows), strict=True), strict=True):
            for i, column in enumerate(J):
                pull[i] += weight * dot8(column, error_px)
    return pulls


def _outer(x: float, y: float, p: float) -> Symmetric:
    return x * x, x * y, x * p, y * y, y * p, p * p


# --- first fix ---
# A pose from tags with nothing to begin from: neither place nor yaw.
#
# Depth, roll, pitch and gimbal are known, so of a tag's corner c and the ray (o, d) along which it is seen, in the
# body's frame made upright, only x, y and psi are not: d x (Rz(psi)' (c - p) - o) = 0. With (cos psi, sin psi) for
# psi and Rz(psi)' p + o for p this is linear, and the four corners of one tag give all four. Where a wall's tag is
# far away or square on, the same picture is nearly had from the other side of its normal, so that mirror image is
# tried as well.

LARGEST = 3  # tags to begin from: the nearest say most
UNLIKELY = 9.0  # difference of cost, as of chi^2, beyond which a second pose is none
SAME_M, SAME_RAD = 0.02, 0.05  # two fixes nearer than this are one

Start = tuple[float, float, float]


def first_fix(of: View, priors: Priors, known: Map, tags: Sequence[SeenTag]) -> TagFix | NoFix:
    """The pose that explains the tags of one frame best; none where another one explains them nearly as well."""
    found: list[TagFix] = []
    for start in starts(of, priors, known, tags):
        near = tag_fix(of, priors, known, tags, start)
        # Once more, with the noise of the tags as it is there.
        fix = tag_fix(of, priors, known, tags, near.theta[:3]) if isinstance(near, TagFix) else near
        if isinstance(fix, TagFix):
            found.append(fix)
    if not found:
        return NoFix("no tag of the map is seen well enough to begin from")
    most = max(fix.tags for fix in found)
    best, *others = sorted((fix for fix in found if fix.tags == most), key=lambda fix: fix.cost)
    if any(other.cost - best.cost < UNLIKELY and not _same(other.theta, best.theta) for other in others):
        return NoFix("two poses explain the tags; another view will tell", ambiguous=True)
    return best


def starts(of: View, priors: Priors, known: Map, tags: Sequence[SeenTag]) -> Iterator[Start]:
    """(x, y, psi) to begin from, of the largest tags first."""
    of_map = [tag for tag in tags if tag.id in known.markers]
    theta = whole((0.0, 0.0, 0.0), priors)
    for tag in sorted(of_map, key=lambda tag: (-tag.size_px, tag.id))[:LARGEST]:
        marker = known.markers[tag.id]
        start = closed_form(of, theta, marker, tag)
        if start is None:
            continue
        yield start
        if (mirrored := mirror(marker, start)) is not None:
            yield mirrored


def closed_form(of: View, theta: Theta, marker: Marker, tag: SeenTag) -> Start | None:
    """x, y and psi of the robot from one tag, by least squares; x, y and psi of theta do not count."""
    H, g = [[0.0] * 4 for _ in range(4)], [0.0] * 4
    mx, my, _ = marker.middle_m  # which all are counted from
    at = upright(of, theta)
    ox, oy, _ = at.origin_m
    for corner, slope in zip(marker.corners_m, tag.corners, strict=True):
        d = direction(at, slope)
        length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        dx, dy, dz = d[0] / length, d[1] / length, d[2] / length
        cx, cy, h = corner[0] - mx, corner[1] - my, corner[2] - at.height_m
        # Unknown: cos psi, sin psi, and t = Rz(psi)' p; the corner from the ray's origin is (v - o, h) with
        # v = (cx cos + cy sin - t_x, cy cos - cx sin - t_y).
        equations = (
            ((dz * cx, dz * cy, -dz, 0.0), dx * h + dz * ox),
            ((dz * cy, -dz * cx, 0.0, -dz), dy * h + dz * oy),
            ((dx * cy - dy * cx, -dx * cx - dy * cy, dy, -dx), dx * oy - dy * ox),
        )
        for row, right in equations:
            for i in range(4):
                g[i] += row[i] * right
                for k in range(i + 1):
                    H[i][k] += row[i] * row[k]
    L = cholesky(H)
    if L is None:
        return None
    c, s, tx, ty = backward(L, forward(L, g))
    scale = math.hypot(c, s)
    if not scale > 0.1:
        return None
    psi = math.atan2(s, c)
    c, s, tx, ty = c / scale, s / scale, tx / scale, ty / scale
    return mx + c * tx - s * ty, my + s * tx + c * ty, psi


def mirror(marker: Marker, start: Start) -> Start | None:
    """The robot mirrored at the normal of a wall's tag, which it sees in the same direction; None of the floor's."""
    out_x, out_y, out_z = normal(marker)
    length = math.hypot(out_x, out_y)
    if length <= abs(out_z):
        return None
    out_x, out_y = out_x / length, out_y / length
    x, y = start[0] - marker.middle_m[0], start[1] - marker.middle_m[1]
    turn = -2.0 * math.atan2(out_x * y - out_y * x, out_x * x + out_y * y)
    c, s = math.cos(turn), math.sin(turn)
    return marker.middle_m[0] + c * x - s * y, marker.middle_m[1] + s * x + c * y, wrap(start[2] + turn)


def _same(a: Theta, b: Theta) -> bool:
    return math.hypot(a[0] - b[0], a[1] - b[1]) < SAME_M and abs(wrap(a[2] - b[2])) < SAME_RAD
