"""Where small windows of one picture are in others: what pictures say of poses before anything is built from them.

Each view gives its corners that have a depth by focus. A corner's window is a small plane, tilted as the focus map is
around it; another view that should see it does so by an affine map, as in the plane sweep (stereo.py). Poses are off, so
that it is not there: it is looked for all around, first blurred in steps of some pixels, then sharp in single ones,
with a parabola over the best. Steps are counted in the window's own plane, so that a picture is read once for all of
them. What is almost as alike elsewhere (tiles) is refused, as is what is not alike enough.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Floats, slopes_of
from agent.reconstruction.stack import Stack, camera_at
from agent.reconstruction.stereo import _between, _camera, _seen_at, slopes_of_map
from hw.compiled import compiled

CORNERS, CORNER_PX, CORNER_QUALITY = 150, 8, 0.005  # most of a view, how far apart, of the best one's strength
COARSE_BLUR_PX, FINE_BLUR_PX = 1.5, 0.7
COARSE, FINE = 4, 5  # half widths of windows, samples
FINE_REACH = 4  # single pixels
LIKE, UNIQUE = 0.75, 0.05  # least ZNCC of the sharp window, and how much less the next best blurred one must have
MOST_STRETCH, LEAST_SQUEEZE = 2.0, 0.45  # of a window by its map: singular values
HIDDEN = 0.12  # of z: where the other view knows another depth, it sees something else

kernel = compiled(error_model="numpy", fastmath={"contract", "arcp", "nsz"})


class Matches(NamedTuple):
    """m windows found again; corners come in the order of views, and a corner's matches one after the other."""

    corner: NDArray[np.int64]  # (m,) which one
    view: NDArray[np.int64]  # (m,) in which picture it was found
    pixel: Floats  # (m, 2) where
    alike: Floats  # (m,) ZNCC


class Corners(NamedTuple):
    """Of all views."""

    view: NDArray[np.int64]  # (c,)
    pixel: Floats  # (c, 2)
    depth_m: Floats  # (c,)
    sigma_m: Floats  # (c,)


def tones(stack: Stack, blur_px: float) -> NDArray[np.float32]:
    """Grey tones (n, height, width) as an eye has them, blurred."""
    grey = np.maximum(stack.pictures.mean(axis=-1), 0.0) ** np.float32(1.0 / 2.2)
    return np.stack([cv2.GaussianBlur(one, (0, 0), blur_px) for one in grey])


def corners(stack: Stack) -> Corners:
    """Corners of all pictures where a depth is known (Shi and Tomasi 1994)."""
    found = []
    for n, picture in enumerate(tones(stack, FINE_BLUR_PX)):
        mask = np.isfinite(stack.depth_m[n]).astype(np.uint8)
        rim = FINE + 1
        inside = np.zeros_like(mask)
        inside[rim : stack.sizes[n, 1] - rim, rim : stack.sizes[n, 0] - rim] = 1
        at = cv2.goodFeaturesToTrack(picture, CORNERS, CORNER_QUALITY, CORNER_PX, mask=mask * inside)
        if at is not None:
            pixels = np.rint(at.reshape(-1, 2)).astype(np.int64)
            found.append(np.concatenate([np.full((len(pixels), 1), n), pixels], axis=1))
    every = np.concatenate(found) if found else np.zeros((0, 3), np.int64)
    where = every[:, 0], every[:, 2], every[:, 1]
    depth, sigma = (field[where].astype(float) for field in (stack.depth_m, stack.sigma_m))
    return Corners(every[:, 0], every[:, 1:].astype(float), depth, sigma)


def matched(stack: Stack, found: Corners, reach_px: float) -> Matches:
    """Every corner in every picture that should show it, so many pixels at most from where poses say that it is."""
    coarse, fine = tones(stack, COARSE_BLUR_PX), tones(stack, FINE_BLUR_PX)
    step = 2
    count = len(stack.cameras)
    tilts = np.zeros((count, *stack.depth_m.shape[1:], 2))
    for n in range(count):
        slopes_of_map(stack.depth_m[n], tilts[n])
    out = np.full((len(found.view), count, 3), np.nan)
    _match(stack, coarse, fine, found.view, found.pixel, found.depth_m, tilts, step, math.ceil(reach_px / step), out)
    corner, view = np.nonzero(np.isfinite(out[..., 2]))
    return Matches(corner, view, out[corner, view, :2], out[corner, view, 2])


@kernel
def _square(side: int) -> Floats:
    return np.empty((side, side))


@kernel
def _match(
    stack: Stack, coarse: NDArray[np.float32], fine: NDArray[np.float32], views: NDArray[np.int64], pixels: Floats,
    depths: Floats, tilts: Floats, step: int, reach: int, out: Floats,
) -> None:  # fmt: skip
    count = len(stack.cameras)
    everyone = np.arange(count)
    turns, shifts = np.empty((count, 3, 3)), np.empty((count, 3))
    side, small = 2 * COARSE + 1, 2 * FINE + 1
    own, own_fine = _square(side), _square(small)
    wide, alike = _square(side + 2 * reach), _square(2 * reach + 1)
    wide_fine, alike_fine = _square(small + 2 * FINE_REACH), _square(2 * FINE_REACH + 1)
    before = -1
    for c in range(len(views)):
        n = views[c]
        if n != before:
            _between(stack, n, everyone, turns, shifts)
            before = n
        mine = _camera(stack, n)
        u, v, z0 = pixels[c, 0], pixels[c, 1], depths[c]
        right, down = tilts[n, int(v), int(u), 0], tilts[n, int(v), int(u), 1]
        x0, y0 = slopes_of(mine, u, v)
        x1, y1 = slopes_of(mine, u + 2.0, v)
        x2, y2 = slopes_of(mine, u, v + 2.0)
        z1, z2 = 1.0 / max(1.0 / z0 + 2.0 * right, 1e-3), 1.0 / max(1.0 / z0 + 2.0 * down, 1e-3)
        a0, a1, a2 = z0 - mine.ahead_m, z1 - mine.ahead_m, z2 - mine.ahead_m
        ready = False
        for o in range(count):
            if o == n:
                continue
            its = _camera(stack, o)
            u0, v0, good0 = _seen_at(its, turns[o], shifts[o], x0 * a0, y0 * a0, z0)
            u1, v1, good1 = _seen_at(its, turns[o], shifts[o], x1 * a1, y1 * a1, z1)
            u2, v2, good2 = _seen_at(its, turns[o], shifts[o], x2 * a2, y2 * a2, z2)
            if not (good0 and good1 and good2):
                continue
            if not (0.0 <= u0 < its.width - 1 and 0.0 <= v0 < its.height - 1):
                continue
            ux, vx, uy, vy = (u1 - u0) / 2.0, (v1 - v0) / 2.0, (u2 - u0) / 2.0, (v2 - v0) / 2.0
            total, area = 0.5 * (ux * ux + vx * vx + uy * uy + vy * vy), ux * vy - uy * vx
            rest = math.sqrt(max(total * total - area * area, 0.0))
            if area <= 0.0 or total + rest > MOST_STRETCH**2 or total - rest < LEAST_SQUEEZE**2:
                continue
            known = float(stack.depth_m[o, int(v0 + 0.5), int(u0 + 0.5)])
            there = turns[o, 2, 0] * x0 * a0 + turns[o, 2, 1] * y0 * a0 + turns[o, 2, 2] * z0 + shifts[o, 2]
            if abs(known - there) > HIDDEN * there:  # false where it is not known
                continue
            if not ready:
                _read(coarse, n, mine.width, mine.height, u, v, float(step), 0.0, 0.0, float(step), own)
                _read(fine, n, mine.width, mine.height, u, v, 1.0, 0.0, 0.0, 1.0, own_fine)
                ready = True
            _read(coarse, o, its.width, its.height, u0, v0, step * ux, step * vx, step * uy, step * vy, wide)
            _correlate(own, wide, alike)
            i, j = _top(alike)
            if _next(alike, i, j) > alike[i, j] - UNIQUE:
                continue
            du, dv = step * (j - reach), step * (i - reach)
            ub, vb = u0 + du * ux + dv * uy, v0 + du * vx + dv * vy
            _read(fine, o, its.width, its.height, ub, vb, ux, vx, uy, vy, wide_fine)
            _correlate(own_fine, wide_fine, alike_fine)
            i, j = _top(alike_fine)
            if alike_fine[i, j] < LIKE or i == 0 or j == 0 or i == 2 * FINE_REACH or j == 2 * FINE_REACH:
                continue
            fj = j - FINE_REACH + _vertex(alike_fine[i, j - 1], alike_fine[i, j], alike_fine[i, j + 1])
            fi = i - FINE_REACH + _vertex(alike_fine[i - 1, j], alike_fine[i, j], alike_fine[i + 1, j])
            out[c, o, 0], out[c, o, 1] = ub + fj * ux + fi * uy, vb + fj * vx + fi * vy
            out[c, o, 2] = alike_fine[i, j]


@kernel
def _read(
    pictures: NDArray[np.float32], n: int, width: int, height: int, u: float, v: float,
    ux: float, vx: float, uy: float, vy: float, out: Floats,
) -> None:  # fmt: skip
    """A picture along an affine map about (u, v); NaN beyond its rim."""
    half = out.shape[0] // 2
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            x = u + (j - half) * ux + (i - half) * uy
            y = v + (j - half) * vx + (i - half) * vy
            if not (0.0 <= x < width - 1 and 0.0 <= y < height - 1):
                out[i, j] = math.nan
                continue
            a, b = int(y), int(x)
            down, across = y - a, x - b
            top = pictures[n, a, b] + across * (pictures[n, a, b + 1] - pictures[n, a, b])
            bottom = pictures[n, a + 1, b] + across * (pictures[n, a + 1, b + 1] - pictures[n, a + 1, b])
            out[i, j] = top + down * (bottom - top)


@kernel
def _correlate(own: Floats, wide: Floats, alike: Floats) -> None:
    """ZNCC of a window with each of the same size in a wider one; -1 where that has a NaN."""
    side = own.shape[0]
    n = float(side * side)
    mean, texture = own.mean(), 0.0
    for i in range(side):
        for j in range(side):
            texture += (own[i, j] - mean) ** 2
    for a in range(alike.shape[0]):
        for b in range(alike.shape[1]):
            total, squares, product = 0.0, 0.0, 0.0
            for i in range(side):
                for j in range(side):
                    value = wide[a + i, b + j]
                    total += value
                    squares += value * value
                    product += value * (own[i, j] - mean)
            rest = squares - total * total / n
            alike[a, b] = product / math.sqrt(texture * rest) if rest > 1e-5 * n and texture > 1e-5 * n else -1.0


@kernel
def _top(alike: Floats) -> tuple[int, int]:
    best = 0
    flat = alike.ravel()
    for k in range(1, len(flat)):
        if flat[k] > flat[best]:
            best = k
    return best // alike.shape[1], best % alike.shape[1]


@kernel
def _next(alike: Floats, i: int, j: int) -> float:
    """The best that is not beside (i, j)."""
    best = -1.0
    for a in range(alike.shape[0]):
        for b in range(alike.shape[1]):
            if (abs(a - i) > 2 or abs(b - j) > 2) and alike[a, b] > best:
                best = alike[a, b]
    return best


@kernel
def _vertex(before: float, top: float, after: float) -> float:
    curve = before + after - 2.0 * top
    return 0.5 * (before - after) / curve if curve < 0.0 and before > -0.9 and after > -0.9 else 0.0
