"""Poses of all views and depths of their corners that fit where corners were found in other pictures: bundle adjustment.

A corner lies on its own pixel's ray, at 1/z; so its unknowns are one each, and are eliminated (Schur), which leaves
six for each view. What is minimised, by Gauss and Newton's steps with Cauchy's weights of a scale that narrows:

    sum c^2 log(1 + |found - seen|^2 / c^2) / SIGMA_PX^2 + the same of (1/z - 1/z_focus) / sigma + xi' Lambda xi

Lambda is the information of what poses are off by (twist.together), xi (w, t) of each view along its camera's axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Camera, Floats, pixel_of, slopes_of
from agent.reconstruction.poses.matches import Corners, Matches
from agent.reconstruction.view import View, moved
from hw.compiled import compiled

SIGMA_PX = 0.5
FOCUS_WIDER = 2.0  # neighbouring blocks are wrong together: sigma so many times larger than they say
FOCUS_SCALE = 2.0  # Cauchy's, of depths, in those
DAMPING = 1e-6

kernel = compiled(error_model="numpy")


class Adjusted(NamedTuple):
    views: list[View]
    inverse: Floats  # (c,) 1/z of the corners
    gone: Floats  # (n, 6) how far each view is from where its prior has it
    off_px: Floats  # (m,) of each match


def adjusted(
    views: Sequence[View], corners: Corners, matches: Matches, information: Floats, gone: Floats,
    inverse: Floats, scales_px: Sequence[float],
) -> Adjusted:  # fmt: skip
    """One step for each of the scales. information (6 n, 6 n), gone (n, 6): where views are, seen from their priors."""
    now, count = list(views), len(views)
    cameras = np.array([view.camera for view in views], float)
    z = corners.depth_m
    q0, certain = 1.0 / z, (z * z / (FOCUS_WIDER * corners.sigma_m)) ** 2
    gone, q = gone.copy(), inverse.copy()
    first = np.searchsorted(matches.corner, np.arange(len(z) + 1))
    off = np.zeros(len(matches.view))
    for scale in scales_px:
        rotations, positions = (np.array([getattr(view, name) for view in now]) for name in ("rotation", "position_m"))
        hessian, pull = information.copy(), -information @ gone.ravel()
        slopes, back = np.zeros((len(z), 2)), np.zeros((len(matches.view) + len(z), 6))
        _sum(
            cameras, rotations, positions, corners.view, corners.pixel, q, q0, certain, first, matches.view,
            matches.pixel, scale, hessian, pull, off, slopes, back,
        )  # fmt: skip
        hessian[np.diag_indices_from(hessian)] *= 1.0 + DAMPING
        xi = np.linalg.solve(hessian, pull).reshape(count, 6)
        _back(xi, corners.view, first, matches.view, slopes, back, q)
        gone += xi
        now = [moved(view, one[:3], one[3:]) for view, one in zip(now, xi, strict=True)]
    return Adjusted(now, q, gone, off)


@kernel
def _camera_of(c: Floats) -> Camera:
    return Camera(c[0], c[1], c[2], c[3], c[4], int(c[5]), int(c[6]))


@kernel
def _sum(
    cameras: Floats, rotations: Floats, positions: Floats, views: NDArray[np.int64], pixels: Floats, q: Floats,
    q0: Floats, certain: Floats, first: NDArray[np.int64], others: NDArray[np.int64], found: Floats, scale: float,
    hessian: Floats, pull: Floats, off: Floats, slopes: Floats, back: Floats,
) -> None:  # fmt: skip
    """slopes (c, 2): a corner's own curvature and pull; back (m + c, 6): its coupling with other views, with its own."""
    toward, mine_by, its_by, pixel_by = np.empty((3, 3)), np.empty((2, 6)), np.empty((2, 6)), np.empty((2, 3))
    by_q, rest = np.empty(2), np.empty(2)
    for c in range(len(views)):
        if first[c] == first[c + 1]:
            continue
        n = views[c]
        mine = _camera_of(cameras[n])
        x, y = slopes_of(mine, pixels[c, 0], pixels[c, 1])
        z = 1.0 / q[c]
        p = (x * (z - mine.ahead_m), y * (z - mine.ahead_m), z)
        miss = q0[c] - q[c]
        weight = certain[c] / (1.0 + miss * miss * certain[c] / FOCUS_SCALE**2)
        curve, tug = weight, weight * miss
        own = back[len(others) + c]
        for m in range(first[c], first[c + 1]):
            o = others[m]
            its = _camera_of(cameras[o])
            there = np.zeros(3)
            for a in range(3):
                for b in range(3):
                    toward[a, b] = 0.0
                    for k in range(3):
                        toward[a, b] += rotations[o, k, a] * rotations[n, k, b]
                    there[a] += toward[a, b] * p[b] + rotations[o, b, a] * (positions[n, b] - positions[o, b])
            u, v, good = pixel_of(its, there[0], there[1], there[2])
            rest[0], rest[1] = found[m, 0] - u, found[m, 1] - v
            off[m] = (rest[0] ** 2 + rest[1] ** 2) ** 0.5
            if not good:
                continue
            share = 1.0 / SIGMA_PX**2 / (1.0 + off[m] ** 2 / scale**2)
            _by_point(its, there, pixel_by)
            # Of its view: p' -> p' + toward (w x p + t); of the other: p' -> p' - w x p' - t.
            for r in range(2):
                g = (pixel_by[r, 0], pixel_by[r, 1], pixel_by[r, 2])
                h = (
                    g[0] * toward[0, 0] + g[1] * toward[1, 0] + g[2] * toward[2, 0],
                    g[0] * toward[0, 1] + g[1] * toward[1, 1] + g[2] * toward[2, 1],
                    g[0] * toward[0, 2] + g[1] * toward[1, 2] + g[2] * toward[2, 2],
                )
                for k in range(3):
                    a, b = (k + 1) % 3, (k + 2) % 3
                    mine_by[r, k], mine_by[r, 3 + k] = p[a] * h[b] - p[b] * h[a], h[k]
                    its_by[r, k], its_by[r, 3 + k] = there[b] * g[a] - there[a] * g[b], -g[k]
                by_q[r] = -z * z * (h[0] * x + h[1] * y + h[2])
            for r in range(2):
                curve += share * by_q[r] * by_q[r]
                tug += share * by_q[r] * rest[r]
                for i in range(6):
                    own[i] += share * by_q[r] * mine_by[r, i]
                    back[m, i] += share * by_q[r] * its_by[r, i]
                    pull[6 * n + i] += share * mine_by[r, i] * rest[r]
                    pull[6 * o + i] += share * its_by[r, i] * rest[r]
                    for j in range(6):
                        hessian[6 * n + i, 6 * n + j] += share * mine_by[r, i] * mine_by[r, j]
                        hessian[6 * o + i, 6 * o + j] += share * its_by[r, i] * its_by[r, j]
                        hessian[6 * n + i, 6 * o + j] += share * mine_by[r, i] * its_by[r, j]
                        hessian[6 * o + j, 6 * n + i] += share * mine_by[r, i] * its_by[r, j]
        slopes[c, 0], slopes[c, 1] = curve, tug
        # The corner's own unknown is eliminated: it takes part with each pair of the views that see it.
        count = first[c + 1] - first[c] + 1
        for a in range(count):
            va, ba = (n, own) if a == 0 else (others[first[c] + a - 1], back[first[c] + a - 1])
            for i in range(6):
                pull[6 * va + i] -= ba[i] * tug / curve
            for b in range(count):
                vb, bb = (n, own) if b == 0 else (others[first[c] + b - 1], back[first[c] + b - 1])
                for i in range(6):
                    for j in range(6):
                        hessian[6 * va + i, 6 * vb + j] -= ba[i] * bb[j] / curve


@kernel
def _by_point(camera: Camera, p: Floats, out: Floats) -> None:
    """How a pixel changes with the point of the camera frame that it shows, (2, 3)."""
    d = p[2] - camera.ahead_m
    x, y = p[0] / d, p[1] / d
    k, b2, f = 1.0 + camera.bend * (x * x + y * y), 2.0 * camera.bend, camera.f_px / d
    xx, xy, yy = f * (k + b2 * x * x), f * b2 * x * y, f * (k + b2 * y * y)
    out[0, 0], out[0, 1], out[0, 2] = xx, xy, -xx * x - xy * y
    out[1, 0], out[1, 1], out[1, 2] = xy, yy, -xy * x - yy * y


@kernel
def _back(
    xi: Floats, views: NDArray[np.int64], first: NDArray[np.int64], others: NDArray[np.int64], slopes: Floats,
    back: Floats, q: Floats,
) -> None:  # fmt: skip
    """What the views' motions leave to each corner."""
    for c in range(len(views)):
        if first[c] == first[c + 1]:
            continue
        tug = slopes[c, 1]
        for i in range(6):
            tug -= back[len(others) + c, i] * xi[views[c], i]
        for m in range(first[c], first[c + 1]):
            for i in range(6):
                tug -= back[m, i] * xi[others[m], i]
        q[c] = min(max(q[c] + tug / slopes[c, 0], 0.5 * q[c]), 2.0 * q[c])
