"""A pose from tags with nothing to begin from: neither place nor yaw.

Depth, roll, pitch and gimbal are known, so of a tag's corner c and the ray (o, d) along which it is seen, in the body's
frame made upright, only x, y and psi are not: d x (Rz(psi)' (c - p) - o) = 0. With (cos psi, sin psi) for psi and
Rz(psi)' p + o for p this is linear, and the four corners of one tag give all four. Where a wall's tag is far away or
square on, the same picture is nearly had from the other side of its normal, so that mirror image is tried as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from agent.capabilities.swim.facing import normal
from agent.capabilities.swim.layout import Marker
from agent.capabilities.swim.projection import Theta, View, direction, upright
from agent.capabilities.swim.tag_fix import Map, NoFix, TagFix, tag_fix, whole
from agent.capabilities.swim.tag_priors import Priors
from agent.core.linear_algebra import backward, cholesky, forward, wrap
from agent.core.step_io import SeenTag

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
        return NoFix("two poses explain the tags; another view will tell")
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
