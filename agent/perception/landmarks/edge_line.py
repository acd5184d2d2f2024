"""One straight edge from black to white, as the line through the centroids of its gradient. Compiled.

Defocus is symmetric in linear light, so the centroid of the gradient across an edge stays where it is however blurred.
An edge is straight only in undistorted slopes: the line is fitted there.

Gradients are taken twice. First all rising ones within reach: they find the line, but noise rises everywhere, most on
the white side, and draws the edges of a sharp tag outwards by 0.2 px (at a noise of 2 % of full light). So then all
gradients, falling ones too, but only as far from that line as the edge's own blur goes; that leaves 0.02 px.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agent.kernel.ranging.camera_model import UNBEND
from agent.perception.landmarks.slopes import Array
from hw.compiled import compiled

kernel = compiled(error_model="numpy")

Plane = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Line = tuple[float, float, float, float]  # a point of it, and the unit vector along it

PROFILES = 28  # across the edge
FIRST, LAST = 0.08, 0.92  # of its length: 0.6 modules from a corner no blur that can be read shows it
STEP_PX = 0.5
WEAK = 0.35  # of the edge's median contrast: something lies over the edge there
FEWEST = 14  # profiles that have the edge
BURNT = 0.99  # of full light, in half of the paper beside the edge: what it was before the sensor's limit is lost
ROUNDS, OUTLIER = 3, 2.5 * 1.48  # 1.48 medians of residuals are a standard deviation
FAINT, MARGIN_PX = 0.15, 0.75  # the blur ends where the mean gradient has fallen to this share, and so much beyond
SHARP_PX2 = 1.0 / 12.0 + 1.0 / 6.0 + STEP_PX**2 / 12.0  # variance of a perfect edge: pixel, interpolation, step


@kernel
def fit_edge(plane: Plane, light: Array, start: Array, end: Array, reach_px: float, lens: Array, line: Array) -> float:
    """Line (4,), in slopes: a point of it and the unit vector along it from start to end.

    plane: one colour of the picture, a byte a pixel; light (256,): linear, of each byte, 1 at the sensor's limit.
    start, end (2,): roughly where the edge ends, pixels; the square is on the right of who goes there, y pointing down.
    reach_px: how far the edge is looked for to either side. lens: f_px, cx_px, cy_px, bend. Returns the variance of the
    blur, px2, or -1 where the edge leaves the picture, is covered or burnt out; then `line` means nothing.
    """
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length = math.hypot(along_x, along_y)
    out_x, out_y = along_y / length, -along_x / length
    steps = int(reach_px / STEP_PX)
    seen = np.empty(2 * steps + 1)
    rise, counted = np.empty((PROFILES, 2 * steps)), np.empty((PROFILES, 2 * steps))
    foot = np.empty((PROFILES, 2))  # where each profile crosses the rough edge
    burnt = 0
    for p in range(PROFILES):
        share = FIRST + (LAST - FIRST) * p / (PROFILES - 1)
        foot[p, 0], foot[p, 1] = start[0] + share * along_x, start[1] + share * along_y
        for k in range(2 * steps + 1):
            s = STEP_PX * (k - steps)
            seen[k] = _at(plane, light, foot[p, 0] + s * out_x, foot[p, 1] + s * out_y)
            if seen[k] < 0.0:
                return -1.0
            if 2 * k > 3 * steps and seen[k] > BURNT:
                burnt += 1
        for k in range(2 * steps):
            rise[p, k] = seen[k + 1] - seen[k]
            counted[p, k] = max(rise[p, k], 0.0)
    if burnt > PROFILES * steps // 4:
        return -1.0
    at_px, good = np.zeros(PROFILES), np.zeros(PROFILES, np.bool_)
    for again in range(2):
        if again:
            half_width_px = _half_width_px(rise, at_px, good)
            for p in range(PROFILES):
                for k in range(2 * steps):
                    near = abs(_place_px(k, steps) - at_px[p]) <= half_width_px
                    counted[p, k] = rise[p, k] if near else 0.0
        if not _line_up(counted, foot, out_x, out_y, lens, at_px, good, line):
            return -1.0
    return _spread_px2(counted, at_px, good)


@kernel
def _place_px(k: int, steps: int) -> float:
    """Where along its profile a gradient is, from the rough edge outwards."""
    return STEP_PX * (k - steps + 0.5)


@kernel
def _at(plane: Plane, light: Array, x: float, y: float) -> float:
    """Light between pixels; -1 outside the picture. (cv2.remap rounds places to 1/32 px, alike all along an edge.)"""
    height, width = plane.shape
    if not (x >= 0.0 and y >= 0.0 and x <= width - 1 and y <= height - 1):
        return -1.0
    i, j = min(int(x), width - 2), min(int(y), height - 2)
    u, v = x - i, y - j
    upper = (1.0 - u) * light[plane[j, i]] + u * light[plane[j, i + 1]]
    lower = (1.0 - u) * light[plane[j + 1, i]] + u * light[plane[j + 1, i + 1]]
    return float((1.0 - v) * upper + v * lower)


@kernel
def _line_up(
    rise: Array, foot: Array, out_x: float, out_y: float, lens: Array, at_px: Array, good: Mask, line: Array
) -> bool:
    """Fit the line; at_px becomes where it runs on each profile, good which of them have the edge."""
    steps = rise.shape[1] // 2
    contrast = np.zeros(PROFILES)
    for p in range(PROFILES):
        for k in range(2 * steps):
            contrast[p] += rise[p, k]
    least = WEAK * max(_median(contrast, PROFILES), 0.0)
    slopes = np.zeros((PROFILES, 2))
    count = 0
    for p in range(PROFILES):
        good[p] = contrast[p] > least
        if not good[p]:
            continue
        count += 1
        moment = 0.0
        for k in range(2 * steps):
            moment += rise[p, k] * _place_px(k, steps)
        at_px[p] = moment / contrast[p]
        slopes[p, 0], slopes[p, 1] = _slope(lens, foot[p, 0] + at_px[p] * out_x, foot[p, 1] + at_px[p] * out_y)
    if count < FEWEST:
        return False
    residual = fit_line(slopes, good, line)
    for p in range(PROFILES):
        at_px[p] -= residual[p] * lens[0]
    return True


@kernel
def _slope(lens: Array, x_px: float, y_px: float) -> tuple[float, float]:
    """As `to_slopes`, for one point."""
    seen_x, seen_y = (x_px - lens[1]) / lens[0], (y_px - lens[2]) / lens[0]
    x, y = seen_x, seen_y
    for _ in range(UNBEND):
        bend = 1.0 + lens[3] * (x * x + y * y)
        x, y = seen_x / bend, seen_y / bend
    return x, y


@kernel
def fit_line(points: Array, good: Mask, line: Array) -> Array:
    """Total least squares through those of (n, 2) points that are good, in rounds without those far off.

    Returns how far each good point lies to the left of the line, 0 for the others.
    """
    n = len(points)
    kept, residual, off = good.copy(), np.zeros(n), np.empty(n)
    for round_ in range(ROUNDS + 1):
        count, x, y = 0, 0.0, 0.0
        for p in range(n):
            if kept[p]:
                count, x, y = count + 1, x + points[p, 0], y + points[p, 1]
        x, y = x / count, y / count
        across, difference = 0.0, 0.0
        for p in range(n):
            if kept[p]:
                dx, dy = points[p, 0] - x, points[p, 1] - y
                across, difference = across + dx * dy, difference + dx * dx - dy * dy
        turn = 0.5 * math.atan2(2.0 * across, difference)
        u, v = math.cos(turn), math.sin(turn)
        if u * (points[-1, 0] - points[0, 0]) + v * (points[-1, 1] - points[0, 1]) < 0.0:
            u, v = -u, -v
        line[0], line[1], line[2], line[3] = x, y, u, v
        for p in range(n):
            if good[p]:
                residual[p] = (points[p, 0] - x) * v - (points[p, 1] - y) * u
        if round_ < ROUNDS:
            count = 0
            for p in range(n):
                if good[p]:
                    off[count] = abs(residual[p])
                    count += 1
            limit = OUTLIER * _median(off, count)
            for p in range(n):
                kept[p] = good[p] and abs(residual[p]) <= limit
    return residual


@kernel
def _median(values: Array, count: int) -> float:
    """Of the first so many; of two in the middle the lower one. np.median takes seconds to compile."""
    ranked = values.copy()
    for i in range(count // 2 + 1):
        for j in range(i + 1, count):
            if ranked[j] < ranked[i]:
                ranked[i], ranked[j] = ranked[j], ranked[i]
    return float(ranked[(count - 1) // 2])


@kernel
def _half_width_px(rise: Array, at_px: Array, good: Mask) -> float:
    """How far from its line the edge's gradient reaches, by the mean over all profiles."""
    steps = rise.shape[1] // 2
    total, count = np.zeros(steps + 1), np.zeros(steps + 1)
    for p in range(PROFILES):
        if good[p]:
            for k in range(2 * steps):
                away = int(abs(_place_px(k, steps) - at_px[p]) / STEP_PX)
                if away <= steps:
                    total[away] += rise[p, k]
                    count[away] += 1.0
    peak = 0.0
    for away in range(3):
        peak = max(peak, total[away] / max(count[away], 1.0))
    away = 2
    while away < steps and total[away] >= FAINT * peak * count[away]:
        away += 1
    return STEP_PX * away + MARGIN_PX


@kernel
def _spread_px2(rise: Array, at_px: Array, good: Mask) -> float:
    """Variance of the gradient across the edge, less that of a perfect one."""
    steps = rise.shape[1] // 2
    total = moment = 0.0
    for p in range(PROFILES):
        if good[p]:
            for k in range(2 * steps):
                total += rise[p, k]
                moment += rise[p, k] * (_place_px(k, steps) - at_px[p]) ** 2
    return max(moment / total - SHARP_PX2, 0.0)
