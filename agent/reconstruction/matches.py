"""Where corners of one picture are in others: what pictures say of poses before anything is built from them.

A corner's window is a small plane, tilted as the focus map is around it; another view that should see it does so by an
affine map, as in the plane sweep. Poses are off, so that it is not quite there: it is looked for all around, first
blurred in steps of STEP_PX, then sharp in single pixels, with parabolas over the best. Steps are counted in the
window's own plane, so that the other picture is read once for all of them. What is almost as alike elsewhere (tiles)
is refused, as are what is not alike enough, and maps that stretch or squeeze a window too much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.process.command import Progress
from agent.reconstruction.plane_sweep import between, seen_at, slopes_of_map
from agent.reconstruction.views import Floats, Stack, camera_in, slopes_of
from hw.compiled import compiled

# --- windows along affine maps, compared by zero-mean normalised cross correlation (ZNCC) ---

LEAST_TEXTURE = 1e-5  # variance of tones, 0 to 1: a standard deviation of 0.3 %

kernel = compiled(error_model="numpy")
quick = compiled(error_model="numpy", fastmath={"contract", "arcp", "nsz", "reassoc"})


@kernel
def square(side: int) -> Floats:
    return np.empty((side, side))


@kernel
def read(
    picture: NDArray[np.float32], width: int, height: int, u: float, v: float,
    across: tuple[float, float], down: tuple[float, float], out: Floats,
) -> None:  # fmt: skip
    """Fill out (odd, odd) from about (u, v), a column on by `across`, a row on by `down`; NaN beyond the rim."""
    half = out.shape[0] // 2
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            x = u + (j - half) * across[0] + (i - half) * down[0]
            y = v + (j - half) * across[1] + (i - half) * down[1]
            if not (0.0 <= x < width - 1 and 0.0 <= y < height - 1):
                out[i, j] = math.nan
                continue
            a, b = int(y), int(x)
            above = picture[a, b] + (x - b) * (picture[a, b + 1] - picture[a, b])
            below = picture[a + 1, b] + (x - b) * (picture[a + 1, b + 1] - picture[a + 1, b])
            out[i, j] = above + (y - a) * (below - above)


@quick
def correlate(own: Floats, wide: Floats, alike: Floats) -> None:
    """Fill alike: ZNCC of a window with each of its size in a wider one; -1 where that has a NaN, or no texture."""
    side = own.shape[0]
    n = float(side * side)
    mean, texture = 0.0, 0.0
    for i in range(side):
        for j in range(side):
            mean += own[i, j] / n
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
            textured = rest > LEAST_TEXTURE * n and texture > LEAST_TEXTURE * n
            alike[a, b] = product / math.sqrt(texture * rest) if textured else -1.0


@kernel
def top(alike: Floats) -> tuple[int, int]:
    """Row and column of the most alike."""
    row, col = 0, 0
    for i in range(alike.shape[0]):
        for j in range(alike.shape[1]):
            if alike[i, j] > alike[row, col]:
                row, col = i, j
    return row, col


@kernel
def elsewhere(alike: Floats, row: int, col: int) -> float:
    """The most that is not beside (row, col)."""
    best = -1.0
    for i in range(alike.shape[0]):
        for j in range(alike.shape[1]):
            if (abs(i - row) > 2 or abs(j - col) > 2) and alike[i, j] > best:
                best = alike[i, j]
    return best


@kernel
def summit(alike: Floats, row: int, col: int) -> tuple[float, float]:
    """Row and column with parabolas through the neighbours; not for the rim."""
    here = alike[row, col]
    down = _vertex(alike[row - 1, col], here, alike[row + 1, col])
    return row + down, col + _vertex(alike[row, col - 1], here, alike[row, col + 1])


@kernel
def _vertex(before: float, here: float, after: float) -> float:
    curve = before + after - 2.0 * here
    return 0.5 * (before - after) / curve if curve < 0.0 and before > -0.9 and after > -0.9 else 0.0


# --- corners of pictures: what can be found again in others, in both directions ---

MOST, APART_PX, LEAST_QUALITY = 150, 8, 0.005  # of a view; between two; of the strongest one's strength
RIM_PX = 6
BLUR_PX = 0.7  # at half as much, noise has corners
GAMMA = 1.0 / 2.2


class Corners(NamedTuple):
    """c corners, in the order of their views."""

    owner: NDArray[np.int64]  # (c,) its view
    pixel: Floats  # (c, 2) u, v
    depth_m: Floats  # (c,) by focus
    sigma_m: Floats  # (c,) of that


def corners(stack: Stack) -> Corners:
    """Corners of all pictures (Shi and Tomasi 1994), where a depth is known."""
    found = [_of_one(stack, n) for n in range(len(stack.cameras))]
    view = np.repeat(np.arange(len(found)), [len(pixels) for pixels in found])
    pixel = np.concatenate([*found, np.zeros((0, 2), np.int64)])
    where = view, pixel[:, 1], pixel[:, 0]
    return Corners(view, pixel.astype(float), stack.depth_m[where].astype(float), stack.sigma_m[where].astype(float))


def tones(stack: Stack, n: int, blur_px: float) -> NDArray[np.float32]:
    """Grey of one picture (height, width) as an eye has it, blurred."""
    grey = np.maximum(stack.pictures[n].mean(axis=-1), 0.0) ** np.float32(GAMMA)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), blur_px), np.float32)


def _of_one(stack: Stack, n: int) -> NDArray[np.int64]:
    width, height = stack.sizes[n]
    inside = np.zeros(stack.depth_m.shape[1:], np.uint8)
    inside[RIM_PX : height - RIM_PX, RIM_PX : width - RIM_PX] = 1
    mask = inside * np.isfinite(stack.depth_m[n]).astype(np.uint8)
    at = cv2.goodFeaturesToTrack(tones(stack, n, BLUR_PX), MOST, LEAST_QUALITY, APART_PX, mask=mask)
    return np.zeros((0, 2), np.int64) if at is None else np.rint(at.reshape(-1, 2)).astype(np.int64)


# --- corners found again in other pictures ---

BLURS_PX, STEP_PX = (1.5, 0.7), 2
COARSE, FINE, NEAR_PX = 4, 5, 4  # half widths of windows, samples; half of where the sharp one is looked for
LEAST, UNIQUE = 0.75, 0.05  # ZNCC of the sharp window; how much less it must be elsewhere, blurred
MOST_STRETCH, MOST_SQUEEZE = 2.0, 0.45  # of a window by its map: singular values
HIDDEN = 0.12  # of z: where the other view knows another depth, something else is before it
OWN_VIEWS, OTHER_VIEWS = 16, 24  # of the same robot and of others, those that should see the most corners


class Matches(NamedTuple):
    """m corners found again; in the order of corners, a corner's own one after the other."""

    corner: NDArray[np.int64]  # (m,) which one
    other: NDArray[np.int64]  # (m,) the view it was found in
    pixel: Floats  # (m, 2) where


def matched(
    stack: Stack, found: Corners, robots: Sequence[object], reach_px: float,
    progress: Progress = lambda done, total: None,
) -> Matches:  # fmt: skip
    """Every corner in the pictures that should show it, so many pixels at most from where its depth and poses put it.

    robots: of each view, whatever tells them apart. progress counts views.
    """
    count = len(stack.cameras)
    blurred, sharp = (np.stack([tones(stack, n, blur_px) for n in range(count)]) for blur_px in BLURS_PX)
    tilt = np.zeros((*stack.depth_m.shape[1:], 2))
    same = np.array([[a == b for b in robots] for a in robots])
    first = np.searchsorted(found.owner, np.arange(count + 1))
    reach = math.ceil(reach_px / STEP_PX)
    parts = []
    for n in range(count):
        mine = np.s_[first[n] : first[n + 1]]
        slopes_of_map(stack.depth_m[n], tilt)
        shown = np.zeros(count, np.int64)
        _shown(stack, n, found.pixel[mine], found.depth_m[mine], shown)
        others = np.sort(np.concatenate([_most(shown * same[n], OWN_VIEWS), _most(shown * ~same[n], OTHER_VIEWS)]))
        at = np.full((first[n + 1] - first[n], len(others), 2), np.nan)
        _search(stack, blurred, sharp, n, others, found.pixel[mine], found.depth_m[mine], tilt, reach, at)
        corner, other = np.nonzero(np.isfinite(at[..., 0]))
        parts.append(Matches(corner + first[n], others[other], at[corner, other]))
        progress(n + 1, count)
    return Matches(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def _most(shown: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """The views that show the most corners, and any at all."""
    best = np.argsort(-shown, kind="stable")[:most]
    return best[shown[best] > 0]


@kernel
def _shown(stack: Stack, n: int, pixels: Floats, depths: Floats, shown: NDArray[np.int64]) -> None:
    count, mine = len(stack.cameras), camera_in(stack, n)
    turns, shifts = np.empty((count, 3, 3)), np.empty((count, 3))
    between(stack, n, np.arange(count), turns, shifts)
    for c in range(len(pixels)):
        x, y = slopes_of(mine, pixels[c, 0], pixels[c, 1])
        a = depths[c] - mine.ahead_m
        for o in range(count):
            its = camera_in(stack, o)
            u, v, good = seen_at(its, turns[o], shifts[o], x * a, y * a, depths[c])
            if o != n and good and 0.0 <= u < its.width - 1 and 0.0 <= v < its.height - 1:
                shown[o] += 1


@kernel
def _search(
    stack: Stack, blurred: NDArray[np.float32], sharp: NDArray[np.float32], n: int, others: NDArray[np.int64],
    pixels: Floats, depths: Floats, tilt: Floats, reach: int, at: Floats,
) -> None:  # fmt: skip
    mine = camera_in(stack, n)
    turns, shifts = np.empty((len(others), 3, 3)), np.empty((len(others), 3))
    between(stack, n, others, turns, shifts)
    own, own_sharp = square(2 * COARSE + 1), square(2 * FINE + 1)
    wide, alike = square(2 * (COARSE + reach) + 1), square(2 * reach + 1)
    near, alike_near = square(2 * (FINE + NEAR_PX) + 1), square(2 * NEAR_PX + 1)
    for c in range(len(pixels)):
        u, v, z0 = pixels[c, 0], pixels[c, 1], depths[c]
        # Rays of the corner and of what lies two pixels right and below: 1/z is linear on the plane through them.
        more = 2.0 * tilt[int(v), int(u)]
        z1, z2 = 1.0 / max(1.0 / z0 + more[0], 1e-3), 1.0 / max(1.0 / z0 + more[1], 1e-3)
        x0, y0 = slopes_of(mine, u, v)
        x1, y1 = slopes_of(mine, u + 2.0, v)
        x2, y2 = slopes_of(mine, u, v + 2.0)
        a0, a1, a2 = z0 - mine.ahead_m, z1 - mine.ahead_m, z2 - mine.ahead_m
        read(blurred[n], mine.width, mine.height, u, v, (float(STEP_PX), 0.0), (0.0, float(STEP_PX)), own)
        read(sharp[n], mine.width, mine.height, u, v, (1.0, 0.0), (0.0, 1.0), own_sharp)
        for k in range(len(others)):
            o = others[k]
            its = camera_in(stack, o)
            u0, v0, good0 = seen_at(its, turns[k], shifts[k], x0 * a0, y0 * a0, z0)
            u1, v1, good1 = seen_at(its, turns[k], shifts[k], x1 * a1, y1 * a1, z1)
            u2, v2, good2 = seen_at(its, turns[k], shifts[k], x2 * a2, y2 * a2, z2)
            if not (good0 and good1 and good2 and 0.0 <= u0 < its.width - 1 and 0.0 <= v0 < its.height - 1):
                continue
            ux, vx, uy, vy = (u1 - u0) / 2.0, (v1 - v0) / 2.0, (u2 - u0) / 2.0, (v2 - v0) / 2.0
            there = turns[k, 2, 0] * x0 * a0 + turns[k, 2, 1] * y0 * a0 + turns[k, 2, 2] * z0 + shifts[k, 2]
            known = float(stack.depth_m[o, int(v0 + 0.5), int(u0 + 0.5)])  # a NaN hides nothing
            if not _alike_in_shape(ux, vx, uy, vy) or abs(known - there) > HIDDEN * there:
                continue
            across, down = (STEP_PX * ux, STEP_PX * vx), (STEP_PX * uy, STEP_PX * vy)
            read(blurred[o], its.width, its.height, u0, v0, across, down, wide)
            correlate(own, wide, alike)
            row, col = top(alike)
            if elsewhere(alike, row, col) > alike[row, col] - UNIQUE:
                continue
            i, j = float(STEP_PX * (row - reach)), float(STEP_PX * (col - reach))
            u0, v0 = u0 + j * ux + i * uy, v0 + j * vx + i * vy
            read(sharp[o], its.width, its.height, u0, v0, (ux, vx), (uy, vy), near)
            correlate(own_sharp, near, alike_near)
            row, col = top(alike_near)
            if alike_near[row, col] < LEAST or min(row, col) == 0 or max(row, col) == 2 * NEAR_PX:
                continue
            i, j = summit(alike_near, row, col)
            i, j = i - NEAR_PX, j - NEAR_PX
            at[c, k, 0], at[c, k, 1] = u0 + j * ux + i * uy, v0 + j * vx + i * vy


@kernel
def _alike_in_shape(ux: float, vx: float, uy: float, vy: float) -> bool:
    """Whether a map keeps a window's singular values within bounds, and does not turn it over."""
    half, area = 0.5 * (ux * ux + vx * vx + uy * uy + vy * vy), ux * vy - uy * vx
    rest = math.sqrt(max(half * half - area * area, 0.0))
    return area > 0.0 and half + rest < MOST_STRETCH**2 and half - rest > MOST_SQUEEZE**2
