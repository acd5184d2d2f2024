"""One straight edge from black to white, as the line through the centroids of its gradient. Compiled.

Defocus is symmetric in linear light, so the centroid of the gradient across an edge stays where it is however blurred.
An edge is straight only in undistorted slopes: the line is fitted there.

Gradients are taken twice. First all rising ones within reach: they find the line, but noise rises everywhere, most on
the white side, and draws the edges of a sharp tag outwards by 0.2 px (at a noise of 2 % of full light). So then all
gradients, falling ones too, but only as far from that line as the edge's own blur goes; that leaves 0.02 px.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import UNBEND
from agent.perception.landmarks.slopes import Array
from hw.compiled import compiled

kernel = compiled(error_model="numpy")

Plane = NDArray[np.uint8]

PROFILES = 28  # across the edge
FIRST, LAST = 0.08, 0.92  # of its length: 0.6 modules from a corner no blur that can be read shows it
STEP_PX = 0.5
WEAK = 0.35  # of the edge's median contrast: something lies over the edge there
FEWEST = 14  # profiles that have the edge
BURNT = 0.99  # of full light, in half of the paper beside the edge: what it was before the sensor's limit is lost
LINE_ROUNDS, OUTLIER = 3, 2.5 * 1.48  # 1.48 medians of residuals are a standard deviation
FAINT, MARGIN_PX = 0.15, 0.75  # the blur ends where the mean gradient has fallen to this share, and so much beyond
SHARP_PX2 = 1.0 / 12.0 + 1.0 / 6.0 + STEP_PX**2 / 12.0  # variance of a perfect edge: pixel, interpolation, step


class Room(NamedTuple):
    """Where `fit_edge` works: numba takes seconds to compile what makes arrays of its own."""

    gradient: Array  # (2, PROFILES, n): across the edge, and what of it counts
    at_px: Array  # (PROFILES,) where the edge crosses each profile, NaN where it has none
    slopes: Array  # (PROFILES, 2) the same as slopes
    off: Array  # (PROFILES,) how far from the line that is, slopes
    ranked: Array  # (PROFILES,)


def room(reach_px: float) -> Room:
    """For edges that are looked for so far to either side."""
    steps = int(reach_px / STEP_PX)
    line, pair = np.empty(PROFILES), np.empty((PROFILES, 2))
    return Room(np.empty((2, PROFILES, 2 * steps)), line, pair, line.copy(), line.copy())


@kernel
def fit_edge(plane: Plane, light: Array, start: Array, end: Array, lens: Array, room: Room, line: Array) -> float:
    """Line (4,), in slopes: a point of it and the unit vector along it from start to end.

    plane: one colour of the picture, a byte a pixel; light (256,): linear, of each byte, 1 at the sensor's limit.
    start, end (2,): roughly where the edge ends, pixels; the square is on the right of who goes there, y pointing down.
    lens: f_px, cx_px, cy_px, bend. Returns the variance of the blur, px2, or -1 where the edge leaves the picture, is
    covered or burnt out; then `line` means nothing.
    """
    if not _across(plane, light, start, end, room.gradient):
        return -1.0
    rise, counted = room.gradient
    n = rise.shape[1]
    for again in range(2):
        reach_px = _half_width_px(rise, room.at_px) if again else 0.0
        for p in range(PROFILES):
            for k in range(n):
                if again:
                    near = abs(_place_px(k, n) - room.at_px[p]) <= reach_px
                    counted[p, k] = rise[p, k] if near else 0.0
                else:
                    counted[p, k] = max(rise[p, k], 0.0)
        if not _line_up(counted, start, end, lens, room, line):
            return -1.0
    total = moment = 0.0
    for p in range(PROFILES):
        if not math.isnan(room.at_px[p]):
            for k in range(n):
                total += counted[p, k]
                moment += counted[p, k] * (_place_px(k, n) - room.at_px[p]) ** 2
    return max(moment / total - SHARP_PX2, 0.0)


@kernel
def _place_px(k: int, n: int) -> float:
    """Where along its profile the k-th of n gradients is, from the rough edge outwards."""
    return STEP_PX * (k + 0.5 - n // 2)


@kernel
def _across(plane: Plane, light: Array, start: Array, end: Array, gradient: Array) -> bool:
    """Gradients along the profiles, outwards; False where one leaves the picture, or the paper is burnt out.

    (cv2.remap rounds places to 1/32 px, alike all along an edge.)
    """
    height, width = plane.shape
    n = gradient.shape[2]
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length = math.hypot(along_x, along_y)
    burnt = 0
    for p in range(PROFILES):
        share = FIRST + (LAST - FIRST) * p / (PROFILES - 1)
        before = 0.0
        for k in range(n + 1):
            s = STEP_PX * (k - n // 2) / length
            x, y = start[0] + share * along_x + s * along_y, start[1] + share * along_y - s * along_x
            if not (x >= 0.0 and y >= 0.0 and x <= width - 1 and y <= height - 1):
                return False
            i, j = min(int(x), width - 2), min(int(y), height - 2)
            u, v = x - i, y - j
            upper = (1.0 - u) * light[plane[j, i]] + u * light[plane[j, i + 1]]
            lower = (1.0 - u) * light[plane[j + 1, i]] + u * light[plane[j + 1, i + 1]]
            here = (1.0 - v) * upper + v * lower
            if k:
                gradient[0, p, k - 1] = here - before
            before = here
            if 4 * k > 3 * n and here > BURNT:
                burnt += 1
    return bool(burnt <= PROFILES * n // 8)


@kernel
def _line_up(counted: Array, start: Array, end: Array, lens: Array, room: Room, line: Array) -> bool:
    """Fit the line to the centroids of the gradients; at_px becomes where it runs on each profile that has an edge."""
    n = counted.shape[1]
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length = math.hypot(along_x, along_y)
    for p in range(PROFILES):
        contrast = 0.0
        for k in range(n):
            contrast += counted[p, k]
        room.off[p] = contrast
    least, count = WEAK * max(_median(room.off, room.ranked), 0.0), 0
    for p in range(PROFILES):
        contrast = room.off[p]
        if not contrast > least:
            room.at_px[p] = room.slopes[p, 0] = room.slopes[p, 1] = np.nan
            continue
        count += 1
        moment = 0.0
        for k in range(n):
            moment += counted[p, k] * _place_px(k, n)
        room.at_px[p] = moment / contrast
        share, s = FIRST + (LAST - FIRST) * p / (PROFILES - 1), moment / contrast / length
        seen_x = (start[0] + share * along_x + s * along_y - lens[1]) / lens[0]
        seen_y = (start[1] + share * along_y - s * along_x - lens[2]) / lens[0]
        x, y = seen_x, seen_y
        for _ in range(UNBEND):  # as `to_slopes`
            bend = 1.0 + lens[3] * (x * x + y * y)
            x, y = seen_x / bend, seen_y / bend
        room.slopes[p, 0], room.slopes[p, 1] = x, y
    if count < FEWEST:
        return False
    fit_line(room.slopes, line, room.off, room.ranked)
    for p in range(PROFILES):
        room.at_px[p] -= room.off[p] * lens[0]
    return True


@kernel
def fit_line(points: Array, line: Array, off: Array, ranked: Array) -> None:
    """Total least squares through (n, 2) points, some of them NaN, in rounds without those far off.

    line (4,): a point of it and the unit vector along it, from the first point to the last. off (n,): how far each
    point lies to the left of it.
    """
    n, limit = len(points), 0.0
    for round_ in range(LINE_ROUNDS + 1):
        if round_:
            for p in range(n):
                off[p] = abs(off[p])
            limit = OUTLIER * _median(off, ranked)
        count = x = y = 0.0
        for p in range(n):
            if not math.isnan(points[p, 0]) and (round_ == 0 or off[p] <= limit):
                count, x, y = count + 1.0, x + points[p, 0], y + points[p, 1]
        x, y = x / count, y / count
        across = difference = way_x = way_y = 0.0
        for p in range(n):
            if not math.isnan(points[p, 0]) and (round_ == 0 or off[p] <= limit):
                dx, dy = points[p, 0] - x, points[p, 1] - y
                across, difference = across + dx * dy, difference + dx * dx - dy * dy
                way_x, way_y = way_x + p * dx, way_y + p * dy
        turn = 0.5 * math.atan2(2.0 * across, difference)
        u, v = math.cos(turn), math.sin(turn)
        if u * way_x + v * way_y < 0.0:
            u, v = -u, -v
        line[0], line[1], line[2], line[3] = x, y, u, v
        for p in range(n):
            off[p] = (points[p, 0] - x) * v - (points[p, 1] - y) * u


@kernel
def _median(values: Array, ranked: Array) -> float:
    """Of those that are numbers; of two in the middle the lower one. ranked: room for them.

    np.median takes seconds to compile.
    """
    count = 0
    for value in values:
        if not math.isnan(value):
            ranked[count] = value
            count += 1
    for i in range(count // 2 + 1):
        for j in range(i + 1, count):
            if ranked[j] < ranked[i]:
                low = ranked[j]
                ranked[j] = ranked[i]
                ranked[i] = low
    return float(ranked[(count - 1) // 2])


@kernel
def _half_width_px(rise: Array, at_px: Array) -> float:
    """How far from its line the edge's gradient reaches, by the mean over all profiles."""
    n, peak, away = rise.shape[1], 0.0, 0
    while True:
        total = count = 0.0
        for p in range(PROFILES):
            if math.isnan(at_px[p]):
                continue
            for k in range(n):
                if int(abs(_place_px(k, n) - at_px[p]) / STEP_PX) == away:
                    total, count = total + rise[p, k], count + 1.0
        if away < 3:
            peak = max(peak, total / max(count, 1.0))
        elif total < FAINT * peak * count or away >= n // 2:
            return STEP_PX * away + MARGIN_PX
        away += 1
