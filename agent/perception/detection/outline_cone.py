"""The outline of a sphere, as a cone of rays; its edge to a fraction of a pixel; and the disc against its surroundings.

The outline is a circular cone of rays m around the direction of the centre: m . g = 1, with g = a / cos(theta), a the
axis and theta the apparent angular radius. That is linear in g and exact off the optical axis, where the image is an
ellipse and its centroid is not the centre's image.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import UNBEND, CameraFit
from agent.perception.detection.colour import BURNT, LIGHT, Light, Picture, Tone, tone_between, weights

Array = NDArray[np.float64]

RAYS = 96  # points of the outline
TRIALS = 60  # RANSAC, three points each: with 60 % good points one of 60 triples is good but for 1 in 10^6
TURN = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
CIRCLE = np.column_stack([np.cos(TURN), np.sin(TURN)])  # (RAYS, 2)
SEED = 1  # the same frame gives the same answer


class Cone(NamedTuple):
    axis: Array  # (3,) unit vector, camera frame
    theta_rad: float


@lru_cache(maxsize=256)
def _triples(count: int) -> NDArray[np.int64]:
    """(TRIALS, 3) of so many points: the same ones each time."""
    return np.random.Generator(np.random.PCG64(SEED)).integers(0, count, (TRIALS, 3))


def consensus(rays: Array, camera: CameraFit, tolerance_px: float) -> Cone | None:
    """RANSAC over triples, then least squares of m . g = 1 on the rays that agree, twice."""
    m1, m2, m3 = rays[_triples(len(rays)).T]
    normal = _cross(m2 - m1, m3 - m1)  # of the plane through three points of the unit sphere
    offset = (normal * m1).sum(axis=1)
    size = np.sqrt((normal * normal).sum(axis=1))
    usable = np.abs(offset) > 0.2 * size  # theta below 78 deg, and three different points
    usable &= size > 1e-12
    if not usable.any():
        return None
    g = normal[usable] / offset[usable, None]
    theta_tolerance = tolerance_px / camera.f_px
    miss = np.abs(rays @ g.T - 1.0) / np.sqrt(np.maximum((g * g).sum(axis=1) - 1.0, 1e-9))
    return refined(_cone(g[np.argmax((miss < theta_tolerance).sum(axis=0))]), rays, camera, tolerance_px)


def refined(cone: Cone | None, rays: Array, camera: CameraFit, tolerance_px: float) -> Cone | None:
    """Least squares of m . g = 1 on the rays that agree with a cone, twice; None where they are too few."""
    for _ in range(2):
        if cone is None:
            return None
        near = rays[agree(rays, cone, camera, tolerance_px)]
        if len(near) < 6:
            return None
        cone = _cone(np.asarray(np.linalg.lstsq(near, np.ones(len(near)), rcond=None)[0], float))
    return cone


def _cross(a: Array, b: Array) -> Array:
    """a x b of (n, 3): numpy's own takes four times as long."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.column_stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _cone(g: Array) -> Cone | None:
    length = float(np.sqrt((g * g).sum()))
    if not length > 1.0 or g[2] <= 0.0:
        return None
    return Cone(g / length, float(np.arccos(1.0 / length)))


def misses_px(rays: Array, cone: Cone, camera: CameraFit) -> Array:
    """How far outside the cone each ray is."""
    misses: Array = (np.arccos(np.clip(rays @ cone.axis, -1.0, 1.0)) - cone.theta_rad) * camera.f_px
    return misses


def agree(rays: Array, cone: Cone, camera: CameraFit, tolerance_px: float) -> NDArray[np.bool_]:
    """Which rays are on the cone."""
    return np.abs(misses_px(rays, cone, camera)) < tolerance_px


def outline(cone: Cone, camera: CameraFit) -> Array:
    """RAYS pixels (RAYS, 2) around the cone."""
    x, _, z = cone.axis
    side = np.array([-z, 0.0, x]) / math.hypot(x, z)
    other = _cross(cone.axis[None], side[None])[0]
    ring = CIRCLE[:, :1] * side + CIRCLE[:, 1:] * other
    return project(np.cos(cone.theta_rad) * cone.axis + np.sin(cone.theta_rad) * ring, camera)


def to_rays(points_px: Array, camera: CameraFit) -> Array:
    """Unit rays (n, 3), camera frame, through pixels (n, 2)."""
    m: Array = np.ones((len(points_px), 3))
    seen = (points_px - (camera.cx_px, camera.cy_px)) / camera.f_px
    m[:, :2] = seen
    if camera.bend:
        for _ in range(UNBEND):
            m[:, :2] = seen / (1.0 + camera.bend * (m[:, :2] ** 2).sum(axis=1, keepdims=True))
    m /= np.sqrt((m * m).sum(axis=1))[:, None]
    return m


def project(directions: Array, camera: CameraFit) -> Array:
    """Pixels (..., 2) of directions (..., 3) in front of the camera."""
    slope = directions[..., :2] / directions[..., 2:]
    slope = slope * (1.0 + camera.bend * (slope * slope).sum(axis=-1, keepdims=True))
    px: Array = camera.f_px * slope + np.array([camera.cx_px, camera.cy_px])
    return px


# --- the edge of a ball to a fraction of a pixel, along lines through its centre ---
#
# A profile is one number of a pixel's light, blue green red. It falls from an inner to an outer level; the edge is
# where it passes their mean, which a blur does not move.

Mask = NDArray[np.bool_]

SAMPLES = 49  # along each line
QUARTER = SAMPLES // 4  # of them for each of the two levels
AROUND = np.column_stack([np.ones(RAYS), np.cos(TURN), np.sin(TURN)])  # (RAYS, 3): mean and first harmonic


class Lines(NamedTuple):
    """Light along lines through the centre, from well inside a predicted outline to well outside."""

    centre: Array  # (2,) pixels
    line: Array  # (RAYS, 2) from the centre to the predicted outline
    reach: Array  # (SAMPLES,) where along it the samples are, 1 at the outline
    light: Light  # (RAYS, SAMPLES, 3)
    visible: Mask  # (RAYS,) within the picture, and where there is light outside


def lines(picture: Picture, outline: Array, centre: Array, inward: float, outward: float) -> Lines:
    """Sample a picture across an outline (RAYS, 2), from 1 - `inward` to 1 + `outward` of its radius."""
    image = picture.image
    height, width = image.shape[:2]
    reach = np.linspace(1.0 - inward, 1.0 + outward, SAMPLES)
    line = outline - centre
    map_x = (centre[0] + line[:, :1] * reach).astype(np.float32)
    map_y = (centre[1] + line[:, 1:] * reach).astype(np.float32)
    inside = (map_x >= 0) & (map_x <= width - 1) & (map_y >= 0) & (map_y <= height - 1)
    seen = np.asarray(cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)
    sampled = LIGHT[seen]
    # A view that ends in black, by a vignette or the rim of a port, ends there as at the frame's edge.
    lit = sampled[:, -QUARTER:].max(axis=2).mean(axis=1) > picture.dark
    return Lines(centre, line, reach, sampled, inside[:, QUARTER:-QUARTER].all(axis=1) & lit)


class Edges(NamedTuple):
    """Where the lines cross the edge."""

    points: Array  # (n, 2) pixels
    on: Mask  # (RAYS,) the lines that do
    width_px: float  # from a quarter to three quarters of the edge's height, their median


def colour_profile(seen: Lines, weights: Light) -> Array:
    """(RAYS, SAMPLES): `weights` (3,) make one number of blue, green and red light."""
    return np.asarray(seen.light @ weights, float)


def local_profile(seen: Lines) -> Array:
    """(RAYS, SAMPLES): along each line how far the picture's own values have gone from those outside to those inside.

    Where the sun has burnt a ball's top white it is lightness that ends at the edge, below it is colour.
    """
    coded = np.sqrt(seen.light)
    along = coded[:, :QUARTER].mean(axis=1) - coded[:, -QUARTER:].mean(axis=1)
    along /= np.sqrt((along * along).sum(axis=1, keepdims=True) + 1e-9)
    profile: Array = (coded * along[:, None]).sum(axis=2)
    return profile


def edges(seen: Lines, profile: Array, shaded: bool) -> Edges:
    """Sub-pixel edge on each line that has one. `shaded`: the profile grows with the light that falls on the ball."""
    profile = np.asarray(cv2.GaussianBlur(np.asarray(profile, np.float32), (5, 1), 1.0))
    inner, outer = (np.sort(part, axis=1)[:, QUARTER // 2] for part in (profile[:, :QUARTER], profile[:, -QUARTER:]))
    contrast = inner - outer
    least = 0.25 * float(np.median(contrast[seen.visible])) if seen.visible.any() else 0.0
    good = seen.visible & (contrast > max(least, 0.0))  # nothing else is in front
    if shaded:
        inner = inner * _shading(profile[:, :QUARTER], seen.reach[:QUARTER], good)
    above = profile > (0.5 * (inner + outer))[:, None]
    # The last step down, seen from inside: texture may dip below the level before.
    down = above[:, :-1] & ~above[:, 1:]
    last = down.shape[1] - 1 - np.argmax(down[:, ::-1], axis=1)
    on = good & down.any(axis=1)
    k = np.flatnonzero(on)
    if not len(k):
        return Edges(np.zeros((0, 2)), on, 0.0)
    a, b = profile[k, last[k]], profile[k, last[k] + 1]
    step = seen.reach[1] - seen.reach[0]
    at = seen.reach[last[k]] + step * (a - 0.5 * (inner[k] + outer[k])) / (a - b)
    points: Array = seen.centre + seen.line[k] * at[:, None]
    low, high = (outer + share * (inner - outer) for share in (0.25, 0.75))
    slope = ((profile > low[:, None]) & (profile < high[:, None]))[k].sum(axis=1)
    radius_px = math.sqrt(float((seen.line * seen.line).sum()) / len(seen.line))
    return Edges(points, on, float(np.sort(slope)[len(k) // 2]) * float(step) * radius_px)


def _shading(inside: Array, reach: Array, good: Mask) -> Array:
    """(RAYS,) how much brighter the ball is at its outline than further in, `inside` (RAYS, n) at `reach` (n,).

    Light falls from above, and the edge of a ball that grows darker outwards seems to lie too far in. The gradient
    is smooth around the ball: level and slope are each a mean and a first harmonic, fitted to all rays at once.
    """
    if good.sum() < 6:
        return np.ones(len(inside))
    outward = reach - 1.0
    turn = AROUND[good]
    # The two sums over a line are all that its samples have to say.
    values = inside[good]
    level, slope = values.sum(axis=1), values @ outward
    n, first, second = len(reach), float(outward.sum()), float(outward @ outward)
    outer_product = turn.T @ turn
    normal = np.kron(np.array([[n, first], [first, second]]), outer_product)
    fit = np.linalg.lstsq(normal, np.concatenate([turn.T @ level, turn.T @ slope]), rcond=None)[0]
    at_edge, within = AROUND @ fit[:3], AROUND @ (fit[:3] + fit[3:] * outward.mean())
    ratio: Array = np.where(within > 0.0, at_edge / np.where(within > 0.0, within, 1.0), 1.0)
    return np.clip(ratio, 0.5, 1.5)


# --- a disc in a picture against the ring around it ---

Pixels = NDArray[np.uint8]  # (n, 3)

EVERY = 3  # of the outline's rays one is enough
FEWEST = 6  # of these
INNER = np.array([0.15, 0.30, 0.45, 0.58, 0.70, 0.80])  # of the radius, samples of the disc
NEAR_RIM = 4  # the first of these that are seen on a ball of which something hides a half
BEYOND = np.array([0.30, 0.45, 0.60, 0.80])  # of the radius, samples of the ring outside the outline
CLEAR_PX, FAR_PX = 2.0, 64.0  # there it is at least so far from the outline, for blur and JPEG, and ends before that


class Patch(NamedTuple):
    """Light (3,) of the ring, the disc's tone against it, and how clearly the one ends where the other begins."""

    ring: Light
    tone: Tone
    dark: float  # how much less light than the ring it has even in the plane in which it has most, logarithm
    bright: float  # how much more light in the plane in which it has least
    full: float  # share of the disc that is nearer to its own colour than to the ring's
    clear: float  # share of the ring that is nearer to its own
    unrest: float  # scatter within disc and ring along the line between their colours, in units of their distance


def patch(picture: Picture, outline: Array, centre: Array, rays: NDArray[np.bool_] | None = None) -> Patch | None:
    """None where there is not enough light or picture around to speak of.

    `rays`: those of the outline (n, 2) to look along, where something hides the others; None: all.
    """
    line = (outline if rays is None else outline[rays])[::EVERY] - centre
    if len(line) < FEWEST:
        return None
    radius = float(np.sqrt((line * line).sum(axis=1)).mean())
    outer = 1.0 + BEYOND * min(max(1.0, CLEAR_PX / (BEYOND[0] * radius)), FAR_PX / (BEYOND[-1] * radius))
    inner = INNER if rays is None else INNER[NEAR_RIM:]
    seen, inside = _along(picture, centre, line, np.concatenate([inner, outer]))
    n = len(inner)
    disc, ring = seen[:, :n][inside[:, :n]], seen[:, n:][inside[:, n:]]
    ring = ring[LIGHT[ring.max(axis=1)] > picture.dark]  # no light is no colour: a vignette, a port's rim
    if len(disc) < n * len(line) // 4 or len(ring) < len(line) // 2:
        return None
    around = np.median(picture.log_light[ring], axis=0)
    burnt = float(((disc >= picture.white).sum(axis=1) >= 2).mean())
    coloured = disc
    if burnt >= BURNT:
        coloured = disc[np.argsort(disc.min(axis=1), kind="stable")[: max(len(disc) // 5, 1)]]
        if burnt < 1.0:
            disc = disc[(disc >= picture.white).sum(axis=1) < 2]  # what is white says nothing for or against the colour
    own = LIGHT[coloured].mean(axis=0)
    return _compared(np.log(own + picture.dark), around, disc, ring, burnt, picture)


def _along(picture: Picture, centre: Array, line: Array, reach: Array) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Pixels (n, m, 3) along lines (n, 2) from the centre, and which of them (n, m) are in the picture."""
    height, width = picture.image.shape[:2]
    map_x = (centre[0] + line[:, :1] * reach).astype(np.float32)
    map_y = (centre[1] + line[:, 1:] * reach).astype(np.float32)
    inside = (map_x >= 0) & (map_x <= width - 1) & (map_y >= 0) & (map_y <= height - 1)
    seen = cv2.remap(picture.image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, np.uint8), inside


def _compared(own: Light, around: Light, disc: Pixels, ring: Pixels, burnt: float, picture: Picture) -> Patch:
    """`own`, `around`: logarithms of light (3,); `disc`, `ring`: the pixels."""
    tone = tone_between(own, around, burnt)
    along = weights(tone.hue_rad)
    inner, outer = picture.log_light[disc] @ along, picture.log_light[ring] @ along
    level = 0.5 * float(np.median(inner) + np.median(outer))
    return Patch(
        ring=np.asarray(np.exp(around) - picture.dark, np.float32),
        tone=tone,
        dark=-float((own - around).max()),
        bright=float((own - around).min()),
        full=float((inner > level).mean()),
        clear=float((outer < level).mean()),
        unrest=float(inner.std() + outer.std()) / max(tone.strength, 1e-6),
    )
