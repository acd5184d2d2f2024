"""The image model as surfels: discs on the surface, without torch. Pictures tell their colours, the water, and how each
picture was exposed.

Discs are drawn as elliptical Gaussians (EWA splatting, Zwicker et al. 2001), nearest first. A disc's Gaussian of
standard deviation r in its plane is one in the picture, of covariance r^2 J (1 - n n') J' + what a pixel is wide; J is
the camera's Jacobian, bend and all. Discs that lie within FRONT_M + FRONT_SHARE of the front are one surface, and
blended; what is behind them is hidden.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.process.command import Progress
from agent.reconstruction.bricks import balls_of, cone, touched
from agent.reconstruction.held_back import ImageModel, Pictures
from agent.reconstruction.mesh import Mesh
from agent.reconstruction.views import Camera, View, pixel_grid, ray_slopes
from hw.compiled import compiled

# --- points of a surface, thinned to discs that cover it once ---

Floats = NDArray[np.float64]

SPACING, RADIUS = 0.75, 0.55  # of a cell of the surface's grid: one disc for each cube so wide; its standard deviation


class Cloud(NamedTuple):
    """Discs in the world, in the order of their places."""

    place_m: Floats  # (n, 3)
    normal: Floats  # (n, 3) unit vectors, out of what is solid
    radius_m: float


def thinned(points_m: Floats, normals: Floats, cell_m: float) -> Cloud:
    """The mean of all points (n, 3) in each cube of SPACING cells; of normals (n, 3) likewise, at unit length.

    Points that are NaN, or whose normals cancel out, are left out.
    """
    good = np.isfinite(points_m).all(axis=1) & np.isfinite(normals).all(axis=1)
    points, normals = points_m[good], normals[good]
    cube = np.floor(points / (SPACING * cell_m)).astype(np.int64)
    _, which = np.unique(cube, axis=0, return_inverse=True)
    which = which.ravel()
    count = np.bincount(which)
    place, normal = (
        np.stack([np.bincount(which, weights=field[:, k]) / count for k in range(3)], axis=1)
        for field in (points, normals)
    )
    length = np.linalg.norm(normal, axis=1)
    clear = length > 0.1
    return Cloud(place[clear], normal[clear] / length[clear, None], RADIUS * cell_m)


def cloud_of(mesh: Mesh, cell_m: float) -> Cloud:
    """Discs that cover a surface that was found on cells of cell_m."""
    return thinned(mesh.vertices_m, mesh.normals.astype(float), cell_m)


# --- discs drawn into a picture ---

CUT = 2.5  # standard deviations at which a Gaussian ends
FRONT_CUT = 1.4  # and within which it hides what is behind: discs are half that far apart
PIXEL_VARIANCE = 0.3  # px^2 added to every disc, so that none falls between pixels
FRONT_M, FRONT_SHARE = 10e-3, 0.02
NEAREST_M = 0.03
LEAST_WEIGHT = 0.05  # of a pixel's discs together: with less it is a hole
PIECE = 64  # discs that follow one another lie near each other: a view passes over those it cannot see together
BESIDE = 4.0  # standard deviations that a disc shows beside its middle at most: CUT, seen through the lens

kernel = compiled(error_model="numpy")


class Splats(NamedTuple):
    """The discs as one camera sees them, and in which depth each pixel's front is."""

    numbers: NDArray[np.int64]  # (n,) of the discs that may be in the picture, ascending
    discs: Floats  # (n, 8): u, v, depth, conic a, b, c, half width and height [px]; depth 0: not seen
    front_m: Floats  # (height, width) inf: nothing
    weight: Floats  # (height, width) sum over the pixel's discs
    depth_m: Floats  # (height, width) from the pivot along the axis; NaN: a hole


def pieces_of(cloud: Cloud) -> Floats:
    """(m, 4) middle and radius of a ball around each PIECE discs, for `splats`."""
    return balls_of(cloud.place_m, PIECE)


def splats(cloud: Cloud, view: View, pieces: Floats | None = None) -> Splats:
    """All but the colours, which change more often. pieces: of `pieces_of`, where many views look at one cloud."""
    around = pieces_of(cloud) if pieces is None else pieces
    seen = touched(around, cone(view.camera, view.rotation, view.position_m), BESIDE * cloud.radius_m)
    numbers = np.flatnonzero(np.repeat(seen, PIECE)[: len(cloud.place_m)])
    discs, place, normal = np.zeros((len(numbers), 8)), cloud.place_m[numbers], cloud.normal[numbers]
    camera, size = view.camera, (view.camera.height, view.camera.width)
    _project(camera, view.rotation, view.position_m, place, normal, cloud.radius_m, discs)
    front, weight, depth = np.full(size, np.inf), np.zeros(size), np.zeros((*size, 1))
    _front(discs, front)
    _blend(discs, front, discs[:, 2:3], weight, depth)
    with np.errstate(invalid="ignore", divide="ignore"):
        depth_m = np.where(weight > LEAST_WEIGHT, depth[..., 0] / weight, np.nan)
    return Splats(numbers, discs, front, weight, depth_m)


def blended(drawn: Splats, values: Floats) -> Floats:
    """Mean (height, width, k) of the values (n, k) of drawn.numbers in each pixel; NaN in holes."""
    weight, total = np.zeros_like(drawn.weight), np.zeros((*drawn.weight.shape, values.shape[1]))
    _blend(drawn.discs, drawn.front_m, values, weight, total)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where((drawn.weight > LEAST_WEIGHT)[..., None], total / weight[..., None], np.nan)


def gathered(drawn: Splats, pixels: Floats) -> tuple[Floats, Floats]:
    """What comes back to each disc of drawn.numbers of pixels' values (height, width, k).

    Sums (n, k) of share times value, and of shares (n,). A disc's share of a pixel is its part in the mean; holes must
    be 0.
    """
    total, shares = np.zeros((len(drawn.discs), pixels.shape[2])), np.zeros(len(drawn.discs))
    _gather(drawn.discs, drawn.front_m, drawn.weight, pixels, total, shares)
    return total, shares


@kernel
def _project(
    camera: Camera, rotation: Floats, position: Floats, place: Floats, normal: Floats, radius: float, discs: Floats
) -> None:
    for i in range(place.shape[0]):
        p, n = np.zeros(3), np.zeros(3)
        for k in range(3):
            for j in range(3):
                p[k] += rotation[j, k] * (place[i, j] - position[j])
                n[k] += rotation[j, k] * normal[i, j]
        d = p[2] - camera.ahead_m
        if d < NEAREST_M or n[0] * p[0] + n[1] * p[1] + n[2] * d >= 0.0:
            continue
        x, y = p[0] / d, p[1] / d
        r2 = x * x + y * y
        if r2 > 1.0:
            continue
        k, b2 = 1.0 + camera.bend * r2, 2.0 * camera.bend
        f = camera.f_px / d
        xx, xy, yy = f * (k + b2 * x * x), f * b2 * x * y, f * (k + b2 * y * y)
        ju = (xx, xy, -xx * x - xy * y)
        jv = (xy, yy, -xy * x - yy * y)
        nu = ju[0] * n[0] + ju[1] * n[1] + ju[2] * n[2]
        nv = jv[0] * n[0] + jv[1] * n[1] + jv[2] * n[2]
        area = radius * radius
        suu = area * (ju[0] * ju[0] + ju[1] * ju[1] + ju[2] * ju[2] - nu * nu) + PIXEL_VARIANCE
        suv = area * (ju[0] * jv[0] + ju[1] * jv[1] + ju[2] * jv[2] - nu * nv)
        svv = area * (jv[0] * jv[0] + jv[1] * jv[1] + jv[2] * jv[2] - nv * nv) + PIXEL_VARIANCE
        det = suu * svv - suv * suv
        discs[i, 0] = camera.cx_px + camera.f_px * k * x
        discs[i, 1] = camera.cy_px + camera.f_px * k * y
        discs[i, 2] = p[2]
        discs[i, 3], discs[i, 4], discs[i, 5] = svv / det, -suv / det, suu / det
        discs[i, 6], discs[i, 7] = math.sqrt(suu), math.sqrt(svv)


@kernel
def _reach(discs: Floats, i: int, cut: float, height: int, width: int) -> tuple[int, int, int, int]:
    """Rows and columns that a disc may cover."""
    u, v, half_u, half_v = discs[i, 0], discs[i, 1], cut * discs[i, 6], cut * discs[i, 7]
    top, down = max(math.ceil(v - half_v), 0), min(math.floor(v + half_v) + 1, height)
    left, right = max(math.ceil(u - half_u), 0), min(math.floor(u + half_u) + 1, width)
    return top, down, left, right


@kernel
def _front(discs: Floats, front: Floats) -> None:
    for i in range(discs.shape[0]):
        z = discs[i, 2]
        if z == 0.0:
            continue
        top, down, left, right = _reach(discs, i, FRONT_CUT, front.shape[0], front.shape[1])
        for row in range(top, down):
            dv = row - discs[i, 1]
            for col in range(left, right):
                du = col - discs[i, 0]
                q = discs[i, 3] * du * du + 2.0 * discs[i, 4] * du * dv + discs[i, 5] * dv * dv
                if q < FRONT_CUT * FRONT_CUT and z < front[row, col]:
                    front[row, col] = z


@kernel
def _blend(discs: Floats, front: Floats, values: Floats, weight: Floats, total: Floats) -> None:
    for i in range(discs.shape[0]):
        z = discs[i, 2]
        if z == 0.0:
            continue
        top, down, left, right = _reach(discs, i, CUT, front.shape[0], front.shape[1])
        for row in range(top, down):
            dv = row - discs[i, 1]
            for col in range(left, right):
                if z > front[row, col] * (1.0 + FRONT_SHARE) + FRONT_M:
                    continue
                du = col - discs[i, 0]
                q = discs[i, 3] * du * du + 2.0 * discs[i, 4] * du * dv + discs[i, 5] * dv * dv
                if q < CUT * CUT:
                    w = math.exp(-0.5 * q)
                    weight[row, col] += w
                    for k in range(values.shape[1]):
                        total[row, col, k] += w * values[i, k]


@kernel
def _gather(discs: Floats, front: Floats, weight: Floats, pixels: Floats, total: Floats, shares: Floats) -> None:
    for i in range(discs.shape[0]):
        z = discs[i, 2]
        if z == 0.0:
            continue
        top, down, left, right = _reach(discs, i, CUT, front.shape[0], front.shape[1])
        for row in range(top, down):
            dv = row - discs[i, 1]
            for col in range(left, right):
                if z > front[row, col] * (1.0 + FRONT_SHARE) + FRONT_M or weight[row, col] <= LEAST_WEIGHT:
                    continue
                du = col - discs[i, 0]
                q = discs[i, 3] * du * du + 2.0 * discs[i, 4] * du * dv + discs[i, 5] * dv * dv
                if q < CUT * CUT:
                    share = math.exp(-0.5 * q) / weight[row, col]
                    shares[i] += share
                    for k in range(pixels.shape[2]):
                        total[i, k] += share * pixels[row, col, k]


# --- colours and water, fitted to pictures by Adam: one picture a step, each once an epoch ---

GAMMA, DARKEST = 1.0 / 2.2, 1e-5  # a picture's tone is (light + DARKEST)^GAMMA, as in the field
TONE_HUBER = 0.1
COLOUR_RATE, WATER_RATE, LAST_RATE = 0.03, 5e-3, 0.1
MOMENTS = (0.9, 0.99)
EVERYTHING = slice(None)
BESIDE_IT = 3  # one picture's gain has errors of its own
BURNT_OUT = 0.95  # of the sensor's limit: such light says nothing of a gain
START_WATER = (0.10, 0.15, 0.05)  # b_D, b_B [1/m], B_inf


@dataclass(frozen=True, eq=False)
class Surfels:
    """Discs with their colours, and the water in which they were seen."""

    cloud: Cloud
    colour: Floats  # (n, 3) linear light, red green blue, as without water; NaN: no picture showed it
    water: Floats  # (3, 3) rows b_D, b_B, B_inf; columns red green blue
    pieces: Floats  # of `pieces_of`
    gain: Floats  # (k, 3) of each picture: what its camera made of the light, by exposure and white balance
    taken: Floats  # (k, 6) of each, `stand`


def stand(view: View) -> Floats:
    """(6,) where a camera is, and what is a metre ahead of it."""
    return np.concatenate([view.position_m, view.position_m + view.rotation[:, 2]])


def picture(surfels: Surfels, view: View) -> tuple[Floats, Floats]:
    """Linear light (height, width, 3) and depth (height, width) from a view's pose by its camera; NaN in holes.

    Its exposure is that of the BESIDE_IT pictures which were taken nearest to it: the mean of their gains.
    """
    drawn = splats(surfels.cloud, view, surfels.pieces)
    light = _seen(blended(drawn, np.nan_to_num(surfels.colour[drawn.numbers])), _range(view, drawn), surfels.water)
    nearest = np.argsort(np.linalg.norm(surfels.taken - stand(view), axis=1))[:BESIDE_IT]
    return light * np.exp(np.log(surfels.gain[nearest]).mean(axis=0)), drawn.depth_m


def fit(cloud: Cloud, views: Sequence[View], epochs: int, done: Callable[[int, int], None]) -> Surfels:
    """Start at the mean of what pictures show of each disc, then `epochs` times through all of them.

    done(pictures seen, in all) is called after each.
    """
    order, total = np.random.default_rng(0), (epochs + 1) * len(views)
    sums, shares, pieces = np.zeros((len(cloud.place_m), 3)), np.zeros(len(cloud.place_m)), pieces_of(cloud)
    for n, view in enumerate(views):
        drawn = splats(cloud, view, pieces)
        back = gathered(drawn, view.picture.astype(float))
        sums[drawn.numbers] += back[0]
        shares[drawn.numbers] += back[1]
        done(n + 1, total)
    with np.errstate(invalid="ignore", divide="ignore"):
        colour = np.where(shares[:, None] > 0.0, np.maximum(sums / shares[:, None], 0.0), 0.0)
    water = np.repeat(np.array(START_WATER)[:, None], 3, axis=1)
    of_colour, of_water, gain = _Moments(colour), _Moments(water), np.ones((len(views), 3))
    for n in range(epochs * len(views)):
        if n % len(views) == 0:
            turn = order.permutation(len(views))
            # Brighter things and lower gains make the same pictures: the gains' mean is 1.
            mean = np.exp(np.log(gain).mean(axis=0))
            gain, colour, water = gain / mean, colour * mean, water * np.stack([np.ones(3), np.ones(3), mean])
        fade = LAST_RATE ** (n / (epochs * len(views)))
        k = turn[n % len(views)]
        drawn = splats(cloud, views[k], pieces)
        here, down_colour, down_water, gain[k] = _gradients(drawn, views[k], colour, water)
        colour[here] = np.maximum(colour[here] - fade * COLOUR_RATE * of_colour.step(down_colour, here), 0.0)
        water = np.maximum(water - fade * WATER_RATE * of_water.step(down_water, EVERYTHING), 0.0)
        done(len(views) + n + 1, total)
    taken = np.array([stand(view) for view in views])
    return Surfels(cloud, np.where(shares[:, None] > 0.0, colour, np.nan), water, pieces, gain, taken)


class _Moments:
    """Adam's (Kingma and Ba 2015), with a count for each disc: a picture tells nothing of those it does not show."""

    def __init__(self, like: Floats) -> None:
        self._first, self._second = np.zeros_like(like), np.zeros_like(like)
        self._count = np.zeros((len(like), 1))

    def step(self, gradient: Floats, where: NDArray[np.int64] | slice) -> Floats:
        """How far to go against it, in rates; gradient: of the rows `where` alone."""
        self._count[where] += 1.0
        first = self._first[where] = MOMENTS[0] * self._first[where] + (1.0 - MOMENTS[0]) * gradient
        second = self._second[where] = MOMENTS[1] * self._second[where] + (1.0 - MOMENTS[1]) * gradient * gradient
        bias = [1.0 - moment ** self._count[where] for moment in MOMENTS]
        return np.asarray(first / bias[0] / (np.sqrt(second / bias[1]) + 1e-12))


def _gradients(
    drawn: Splats, view: View, colour: Floats, water: Floats
) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
    """Which discs (m,) one picture shows, its loss's gradient by their colours (m, 3) and by the water (3, 3), and the
    picture's gain (3,), the best for these."""
    t, here = _range(view, drawn), blended(drawn, colour[drawn.numbers])
    light = _seen(here, t, water)
    good = np.isfinite(light)
    light = np.maximum(np.where(good, light, 0.5), 0.0)
    gain = _gain(light, view.picture, good)
    shown = light * gain
    off = _tone(shown) - _tone(view.picture)
    down = np.clip(off, -TONE_HUBER, TONE_HUBER) * GAMMA * (shown + DARKEST) ** (GAMMA - 1.0) * good * gain
    t = np.nan_to_num(t)[..., None]
    arrives, cleared = np.exp(-water[0] * t), np.exp(-water[1] * t)
    back, shares = gathered(drawn, down * arrives)
    by_direct = -(down * np.nan_to_num(here) * arrives * t).sum(axis=(0, 1))
    by_scatter = (down * water[2] * cleared * t).sum(axis=(0, 1))
    by_veil = (down * (1.0 - cleared)).sum(axis=(0, 1))
    seen = shares > 0.0
    return drawn.numbers[seen], back[seen], np.stack([by_direct, by_scatter, by_veil]), gain


def _gain(light: Floats, picture: NDArray[np.float32], good: NDArray[np.bool_]) -> Floats:
    """(3,) by which light (height, width, 3) comes nearest to a picture of it, in tones, where it is good."""
    counts = good & (picture < BURNT_OUT)
    a, b = (np.where(counts, _tone(each), 0.0) for each in (light, picture))
    both, own = (a * b).sum(axis=(0, 1)), (a * a).sum(axis=(0, 1))
    return np.where(both > 0.0, both / np.maximum(own, 1e-12), 1.0) ** (1.0 / GAMMA)


def _tone(light: Floats | NDArray[np.float32]) -> Floats:
    return np.asarray((np.maximum(light, 0.0) + DARKEST) ** GAMMA, float)


def _range(view: View, drawn: Splats) -> Floats:
    """Way through the water (height, width) to what each pixel shows, m."""
    slopes = ray_slopes(view.camera, pixel_grid(view.camera))
    return np.asarray((drawn.depth_m - view.camera.ahead_m) * np.sqrt(1.0 + (slopes**2).sum(axis=-1)))


def _seen(colour: Floats, range_m: Floats, water: Floats) -> Floats:
    """colour exp(-b_D t) + B_inf (1 - exp(-b_B t))."""
    t = range_m[..., None]
    return np.asarray(colour * np.exp(-water[0] * t) - water[2] * np.expm1(-water[1] * t))


# --- the whole of it ---

EPOCHS = 8  # more is worth less than 0.1 dB


def learnt(views: Sequence[View], mesh: Mesh, cell_m: float, progress: Progress) -> ImageModel:
    """Surfels on a surface that was found on cells of cell_m, fitted to all views as they are."""
    found = fit(cloud_of(mesh, cell_m), views, EPOCHS, progress)

    def look(view: View) -> tuple[Pictures, Pictures]:
        light, depth_m = picture(found, view)
        return filled(light.astype(np.float32)), depth_m.astype(np.float32)

    return ImageModel("surfels", look, (EPOCHS + 1) * len(views))


def filled(light: Pictures) -> Pictures:
    """The picture (h, w, 3) with holes (NaN) filled from around them, the coarser the farther: for the eye."""
    known: NDArray[np.bool_] = np.asarray(np.isfinite(light).all(axis=-1))
    if known.all() or not known.any():
        return np.nan_to_num(light)
    out: Pictures = np.where(known[..., None], light, 0.0).astype(np.float32)
    sums: Pictures = np.array(out, np.float32)
    weight: Pictures = np.array(known, np.float32)
    left: NDArray[np.bool_] = np.array(~known)
    sigma = 2.0
    while left.any():
        mean, share = (np.asarray(cv2.GaussianBlur(one, (0, 0), sigma), np.float32) for one in (sums, weight))
        # Of a picture that is nearly empty no share is large: what is as wide as the picture sees all there is.
        now = left & (share > (1e-3 if sigma < max(known.shape) else 0.0))
        out[now] = mean[now] / share[now, None]
        left, sigma = np.asarray(left & ~now), 2.0 * sigma
    return out
