"""The outline of a sphere, as a cone of rays; its edge to a fraction of a pixel; the disc against its surroundings.

The outline is a circular cone of rays m around the direction of the centre: m . g = 1, with g = a / cos(theta), a the
axis and theta the apparent angular radius. That is linear in g and exact off the optical axis, where the image is an
ellipse and its centroid is not the centre's image.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

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
    """The cone of most rays: least squares of m . g = 1 if all agree well with it, else RANSAC over triples."""
    cone = _through(rays)
    if cone is not None and agree(rays, cone, camera, 0.5 * tolerance_px).all():
        return cone
    m1, m2, m3 = rays[_triples(len(rays)).T]
    normal = _cross(m2 - m1, m3 - m1)  # of the plane through three points of the unit sphere
    offset = (normal * m1).sum(axis=1)
    size = np.sqrt((normal * normal).sum(axis=1))
    usable = np.abs(offset) > 0.2 * size  # theta below 78 deg, and three different points
    usable &= size > 1e-12
    if not usable.any():
        return None
    g = normal[usable] / offset[usable, None]
    limit = tolerance_px / camera.f_px * np.sqrt(np.maximum((g * g).sum(axis=1) - 1.0, 1e-9))
    near = np.abs(rays @ g.T - 1.0) < limit
    return refined(_cone(g[np.argmax(np.count_nonzero(near, axis=0))]), rays, camera, tolerance_px)


def refined(cone: Cone | None, rays: Array, camera: CameraFit, tolerance_px: float) -> Cone | None:
    """Least squares of m . g = 1 on the rays that agree with a cone, twice; None where they are too few."""
    for _ in range(2):
        if cone is None:
            return None
        near = rays[agree(rays, cone, camera, tolerance_px)]
        if len(near) < 6:
            return None
        cone = _through(near)
    return cone


def _through(rays: Array) -> Cone | None:
    """Least squares of m . g = 1 on all rays."""
    known, g = cv2.solve(rays, np.ones((len(rays), 1)), flags=cv2.DECOMP_QR)
    return _cone(np.asarray(g, float)[:, 0]) if known else None


def _cross(a: Array, b: Array) -> Array:
    """a x b of (n, 3): numpy's own takes four times as long."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.column_stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _cone(g: Array) -> Cone | None:
    length = math.sqrt(float(g @ g))
    if not length > 1.0 or g[2] <= 0.0:
        return None
    return Cone(g / length, math.acos(1.0 / length))


def misses_px(rays: Array, cone: Cone, camera: CameraFit) -> Array:
    """How far outside the cone each ray is."""
    misses: Array = (np.arccos(np.minimum(rays @ cone.axis, 1.0)) - cone.theta_rad) * camera.f_px
    return misses


def agree(rays: Array, cone: Cone, camera: CameraFit, tolerance_px: float) -> NDArray[np.bool_]:
    """Which rays are on the cone."""
    at, tolerance_rad = rays @ cone.axis, tolerance_px / camera.f_px
    outer, inner = math.cos(cone.theta_rad + tolerance_rad), math.cos(max(cone.theta_rad - tolerance_rad, 0.0))
    near: NDArray[np.bool_] = at > outer
    if cone.theta_rad > tolerance_rad:
        near &= at < inner
    return near


def outline(cone: Cone, camera: CameraFit) -> Array:
    """RAYS pixels (RAYS, 2) around the cone."""
    x, y, z = cone.axis.tolist()
    flat = math.hypot(x, z)
    # Two directions across the axis.
    across = np.array([[-z / flat, 0.0, x / flat], [x * y / flat, -flat, y * z / flat]])
    directions = math.sin(cone.theta_rad) * (CIRCLE @ across) + math.cos(cone.theta_rad) * cone.axis
    return project(directions, camera)


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
    if camera.bend:
        slope = slope * (1.0 + camera.bend * (slope * slope).sum(axis=-1, keepdims=True))
    px: Array = camera.f_px * slope + (camera.cx_px, camera.cy_px)
    return px


# --- the edge of a ball to a fraction of a pixel, along lines through its centre ---
#
# A profile is one number of a pixel's light, blue green red. It falls from an inner to an outer level; the edge is
# where it passes their mean, which a blur does not move.

Mask = NDArray[np.bool_]

SAMPLES = 49  # along each line
QUARTER = SAMPLES // 4  # of them for each of the two levels
STEPS = np.arange(SAMPLES) / (SAMPLES - 1)
ENDS = np.repeat([1.0, 0.0, -1.0], [QUARTER, SAMPLES - 2 * QUARTER, QUARTER]).astype(np.float32)  # inner less outer
RAY = np.arange(RAYS)
MIDDLE = 0.5 * (QUARTER - 1)  # of the inner samples; of these, a line's level there and slope from sample to sample:
OFF = np.arange(QUARTER) - MIDDLE
LEVEL_AND_SLOPE = np.column_stack([np.full(QUARTER, 1.0 / QUARTER), OFF / (OFF @ OFF)])
AROUND = np.column_stack([np.ones(RAYS), np.cos(TURN), np.sin(TURN)])  # (RAYS, 3): mean and first harmonic


class Lines(NamedTuple):
    """Light along lines through the centre, from well inside a predicted outline to well outside."""

    centre: Array  # (2,) pixels
    line: Array  # (RAYS, 2) from the centre to the predicted outline
    radius_px: float  # its length
    reach: Array  # (SAMPLES,) where along it the samples are, 1 at the outline
    light: Light  # (3, RAYS, SAMPLES)
    visible: Mask  # (RAYS,) within the picture, and where there is light outside


def lines(picture: Picture, outline: Array, centre: Array, inward: float, outward: float) -> Lines:
    """Sample a picture across an outline (RAYS, 2), from 1 - `inward` to 1 + `outward` of its radius."""
    reach = 1.0 - inward + (inward + outward) * STEPS
    line = outline - centre
    seen, at = _along(picture, centre, line, reach)
    light = np.asarray(cv2.LUT(np.concatenate(cv2.split(seen)), LIGHT), np.float32).reshape(3, RAYS, SAMPLES)
    # A view that ends in black, by a vignette or the rim of a port, ends there as at the frame's edge.
    lit = light[..., -QUARTER:].max(axis=0) @ ENDS[:QUARTER] > QUARTER * picture.dark
    inside = _inside(picture, at[..., [QUARTER, -QUARTER - 1]]).all(axis=1)
    return Lines(centre, line, math.sqrt(float(np.vdot(line, line)) / RAYS), reach, light, inside & lit)


def _along(picture: Picture, centre: Array, line: Array, reach: Array) -> tuple[NDArray[np.uint8], Light]:
    """Pixels (n, m, 3) along lines (n, 2) from the centre, and where they are: u and v (2, n, m)."""
    at = line.T.astype(np.float32)[..., None] * reach.astype(np.float32)
    at += centre.astype(np.float32)[:, None, None]
    seen = cv2.remap(picture.image, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, np.uint8), at


def _inside(picture: Picture, at: Light) -> Mask:
    """(n, m) which of places u and v (2, n, m) are in the picture."""
    (u, v), (height, width) = at, picture.image.shape[:2]
    inside: Mask = (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)
    return inside


class Edges(NamedTuple):
    """Where the lines cross the edge."""

    points: Array  # (n, 2) pixels
    on: Mask  # (RAYS,) the lines that do
    width_px: float  # from a quarter to three quarters of the edge's height, their median


def colour_profile(seen: Lines, weights: Light) -> Light:
    """(RAYS, SAMPLES): `weights` (3,) make one number of blue, green and red light."""
    return np.asarray(weights @ seen.light.reshape(3, -1), np.float32).reshape(RAYS, SAMPLES)


def local_profile(seen: Lines) -> Light:
    """(RAYS, SAMPLES): along each line how far the picture's own values have gone from those outside to those inside.

    Where the sun has burnt a ball's top white it is lightness that ends at the edge, below it is colour.
    """
    coded = np.sqrt(seen.light)
    along = coded @ ENDS
    along /= np.sqrt((along * along).sum(axis=0) + np.float32(1e-9))
    return np.asarray((coded * along[..., None]).sum(axis=0), np.float32)


def edges(seen: Lines, profile: Light, shaded: bool) -> Edges:
    """Sub-pixel edge on each line that has one. `shaded`: the profile grows with the light that falls on the ball."""
    profile = np.asarray(cv2.GaussianBlur(profile, (5, 1), 1.0), np.float32)
    levels = np.concatenate([profile[:, :QUARTER], profile[:, -QUARTER:]])
    levels.sort()
    inner, outer = levels[:, QUARTER // 2].reshape(2, RAYS)
    height = inner - outer
    least = 0.25 * median(height[seen.visible]) if seen.visible.any() else 0.0
    good = seen.visible & (height > max(least, 0.0))  # nothing else is in front
    if shaded:
        inner = inner * _shading(profile[:, :QUARTER], seen.reach, good)
        height = inner - outer
    half = outer + np.float32(0.5) * height
    above = profile > half[:, None]
    # The last step down, seen from inside: texture may dip below the level before.
    down = above[:, :-1] > above[:, 1:]
    last = SAMPLES - 2 - np.argmax(down[:, ::-1], axis=1)
    on = good & down[RAY, last]
    k = np.flatnonzero(on)
    if not len(k):
        return Edges(np.zeros((0, 2)), on, 0.0)
    profile, half, last = profile[k], half[k], last[k]
    n = RAY[: len(k)]
    a, b = profile[n, last], profile[n, last + 1]
    step = float(seen.reach[1] - seen.reach[0])
    at = seen.reach[last] + step * (a - half) / (a - b)
    # Where the profile lies in the middle half of the edge's height.
    within = np.abs(profile - half[:, None]) < (np.float32(0.25) * height[k])[:, None]
    slope = np.sort(within.sum(axis=1))[len(k) // 2]
    return Edges(seen.centre + seen.line[k] * at[:, None], on, float(slope) * step * seen.radius_px)


def _shading(inside: Light, reach: Array, good: Mask) -> Light:
    """(RAYS,) how much brighter the ball is at its outline than further in, `inside` (RAYS, n) at the first of `reach`.

    Light falls from above, and the edge of a ball that grows darker outwards seems to lie too far in. The gradient
    is smooth around the ball: level and slope are each a mean and a first harmonic, fitted to all rays at once.
    """
    if np.count_nonzero(good) < 6:
        return np.ones(len(inside), np.float32)
    # All rays have the same samples, so the fit to all is one around the ball to those of each.
    of_each = inside @ LEVEL_AND_SLOPE
    lit = AROUND[good]
    within, slope = (AROUND @ cv2.solve(lit.T @ lit, lit.T @ of_each[good], flags=cv2.DECOMP_CHOLESKY)[1]).T
    at_edge = within + slope * (float((1.0 - reach[0]) / (reach[1] - reach[0])) - MIDDLE)
    ratio = np.where(within > 0.0, at_edge / np.where(within > 0.0, within, 1.0), 1.0)
    return np.asarray(np.minimum(np.maximum(ratio, 0.5), 1.5), np.float32)


# --- a disc in a picture against the ring around it ---

Pixels = NDArray[np.uint8]  # (n, 3)

EVERY = 3  # of the outline's rays one is enough
FEWEST = 6  # of these
INNER = np.array([0.15, 0.30, 0.45, 0.58, 0.70, 0.80])  # of the radius, samples of the disc
NEAR_RIM = 4  # the first of these that are seen on a ball of which something hides a half
BEYOND = np.array([0.30, 0.45, 0.60, 0.80])  # of the radius, samples of the ring outside the outline
CLEAR_PX, FAR_PX = 2.0, 64.0  # there it is at least so far from the outline, for blur and JPEG, and ends before that


class Patch(NamedTuple):
    """Light of the ring, the disc's tone against it, and how clearly the one ends where the other begins."""

    ring: Sequence[float]  # blue, green, red
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
    seen, at = _along(picture, centre, line, np.concatenate([inner, outer]))
    inside, n = _inside(picture, at), len(inner)
    disc, ring = seen[:, :n][inside[:, :n]], seen[:, n:][inside[:, n:]]
    # No light is no colour: a vignette, a port's rim.
    ring = ring[LIGHT[np.maximum(np.maximum(ring[:, 0], ring[:, 1]), ring[:, 2])] > picture.dark]
    if len(disc) < n * len(line) // 4 or len(ring) < len(line) // 2:
        return None
    burnt, coloured = 0.0, disc
    if disc.max() >= picture.white:
        white = (disc >= picture.white).sum(axis=1) >= 2
        burnt = int(np.count_nonzero(white)) / len(white)
        if burnt >= BURNT:
            coloured = disc[np.argsort(disc.min(axis=1), kind="stable")[: max(len(disc) // 5, 1)]]
            if burnt < 1.0:
                disc = disc[~white]  # what is white says nothing for or against the colour
    own = [math.log(light + picture.dark) for light in cv2.mean(LIGHT[coloured][None])[:3]]
    return _compared(own, disc, ring, burnt, picture)


def _compared(own: list[float], disc: Pixels, ring: Pixels, burnt: float, picture: Picture) -> Patch:
    """`own`: logarithms of light (3,); `disc`, `ring`: the pixels."""
    inner, outer = picture.log_light[disc], picture.log_light[ring]
    ordered, half = np.sort(outer, axis=0), len(outer) // 2
    around = (ordered[half] if len(outer) % 2 else 0.5 * (ordered[half - 1] + ordered[half])).tolist()
    tone = tone_between(own, around, burnt)
    along = weights(tone.hue_rad)
    inner, outer = inner @ along, outer @ along
    level = 0.5 * (median(inner) + median(outer))
    more = [one - other for one, other in zip(own, around, strict=True)]
    scatter = sum(float(cv2.meanStdDev(part)[1][0, 0]) for part in (inner, outer))
    return Patch(
        ring=[math.exp(light) - picture.dark for light in around],
        tone=tone,
        dark=-max(more),
        bright=min(more),
        full=int(np.count_nonzero(inner > level)) / len(inner),
        clear=int(np.count_nonzero(outer < level)) / len(outer),
        unrest=scatter / max(tone.strength, 1e-6),
    )


def median(values: NDArray[np.floating[Any]]) -> float:
    """Of some (n,): numpy's own takes four times as long."""
    ordered, half = np.sort(values), len(values) // 2
    return float(ordered[half]) if len(values) % 2 else 0.5 * float(ordered[half - 1] + ordered[half])


# --- the outline around a spot ---
#
# It is a cone through the edge as colour shows it, and one through the edge as lightness does. Neither is right
# everywhere. Colour leads through shadow and texture, but JPEG blurs it and the sun burns it out; lightness is sharp,
# but what a camera makes of light moves the edge of a blurred thing. Each counts for as much as it is determined, and
# where they disagree the radius is the less certain.

BAND = 0.30  # the outline is looked for within this share of the radius inside and outside the first guess,
BAND_FRAME = 0.05  # and within this share of the frame's width: twice the largest blur's radius;
LEAST_PX = 4.0  # but so far at least: a camera's own blur and JPEG reach 2 px from an edge
# The second look reaches so many widths of the edge (a quarter to three quarters of its height), so that the levels
# inside and outside are taken beyond the blur, but not where the ball is shaded otherwise than at its rim.
WIDTHS, BEYOND_PX = 2.5, 1.5
INWARD, OUTWARD = 0.65, 1.2  # of the radius, at most: of a small ball there is not more
MIN_ARC = 0.28  # share of the whole outline: what is left of 120 deg where it runs into the edge of the frame
FIRST_ARC = 0.18  # of a first look, whose wide band loses more lines at that edge
LOOSE_PX, LOOSE = 2.0, 0.04  # an edge agrees with the cone within so many pixels, or this share of the radius:
TIGHT = 0.1  # of small ones never more than this, or anything would be round
MAX_GAIN = 2.5  # a plane weaker than that holds noise, not colour
# Radius errors that the scatter of the edges does not show. Colour: the blocks of JPEG, the twin's texture at the rim;
# lightness: share of the edge's width by which a camera's gamma moves it (rms 0.1 on the twin's defocused frames).
COLOUR_PX, GAMMA = 0.15, 0.10
# JPEG halves the resolution of colour: of a small ball lightness knows the outline better. Where it has one, that alone
# is used, and it has to be nearly whole, for so few pixels often lie on some circle.
SMALL_PX, SURE = 12.0, 0.85
PLAIN = 0.95  # of a larger one: share of agreeing edges by colour from which on a first look asks no more
SCATTER = 0.08  # of its radius: where edges scatter more, rms, too few of them will be on any circle
ALIKE = 4.0  # neighbouring rays see the same pixels: so many count as one
LITTLE = 1e-9 * np.eye(3)


class Edge(NamedTuple):
    """A cone through one profile's edges."""

    cone: Cone
    agree: float  # share of the visible rays whose edge is on it
    rms_px: float  # of these
    width_px: float  # of the edge
    sigma_px: float  # of the radius, from scatter and arc
    rays: NDArray[np.bool_]  # (RAYS,) those that agree


class OutlineFit(NamedTuple):
    """Both edges together."""

    axis: Array  # (3,) of the ray to the centre
    radius_px: float  # apparent angular radius times f_px
    sigma_px: float  # its standard deviation
    agree: float  # share of the visible rays, the mean of both
    rms_px: float
    width_px: float  # of the wider of both edges
    visible: float  # share of all rays
    rays: NDArray[np.bool_]  # (RAYS,) on which colour has its edge


def first_guess(points: Array, origin: Array, camera: CameraFit) -> Cone | None:
    """A cone through the outline of a spot (n, 2)."""
    tolerance_px = max(LOOSE_PX, 0.2 * math.sqrt(len(points)))
    return consensus(to_rays(points + origin, camera), camera, tolerance_px)


def look(
    picture: Picture, outline: Array, centre: Array, radius: float, camera: CameraFit, width_px: float | None
) -> Lines | None:
    """Lines across a predicted outline (RAYS, 2) of this radius, pixels; `width_px`: of the edge, None while unknown.

    None if too little of the outline is in the picture and in the light.
    """
    if width_px is None:
        reach = max(min(BAND * radius, BAND_FRAME * camera.width_px), LEAST_PX) / radius
    else:
        reach = max(min(WIDTHS * width_px + BEYOND_PX, BAND * max(radius, 2.0 * LEAST_PX / BAND)), LEAST_PX) / radius
    seen = lines(picture, outline, centre, min(reach, INWARD), min(reach, OUTWARD))
    return seen if seen.visible.sum() >= (FIRST_ARC if width_px is None else MIN_ARC) * RAYS else None


def colour_edge(
    seen: Lines, found: Patch, dark: float, origin: Array, camera: CameraFit, tolerance_px: float, near: Cone | None
) -> Edge | None:
    """The edge as colour shows it.

    `dark`: light without colour; `near`: a cone within a pixel or two; None: any may be right.
    """
    mean = sum(found.ring) / 3.0
    gain = [min(max(mean / (light + dark), 1.0 / MAX_GAIN), MAX_GAIN) for light in found.ring]
    profile = colour_profile(seen, np.asarray(weights(found.tone.hue_rad) * gain, np.float32))
    return _edge(seen, edges(seen, profile, True), origin, camera, tolerance_px, near)


def lightness_edge(
    seen: Lines, origin: Array, camera: CameraFit, tolerance_px: float, near: Cone | None
) -> Edge | None:
    """The edge as lightness shows it; `near` as for colour."""
    return _edge(seen, edges(seen, local_profile(seen), False), origin, camera, tolerance_px, near)


def tolerance_px(radius_px: float, last: bool) -> float:
    """How far from the cone an edge may be; at a first look the guess itself is off."""
    return max(LOOSE_PX if not last else min(LOOSE_PX, TIGHT * radius_px), LOOSE * radius_px)


def may_be_small(edge: Edge | None, camera: CameraFit) -> bool:
    """Whether the edge by lightness, at a first look at a small ball, may come out as a whole circle."""
    return edge is not None and edge.agree >= SURE and edge.rms_px <= SCATTER * edge.cone.theta_rad * camera.f_px


def combined(
    colour: Edge | None, lightness: Edge | None, burnt: bool, visible: float, camera: CameraFit
) -> OutlineFit | None:
    """One outline of two; of one alone with half of its evidence and twice its uncertainty.

    `burnt`: the disc is too bright to have a colour, which then ends somewhere within it or in the glow around it, so
    lightness alone says it all.
    """
    one, other = colour or lightness, lightness or colour
    if one is None or other is None:
        return None
    by_lightness = burnt or other.cone.theta_rad * camera.f_px < SMALL_PX
    if by_lightness and other.agree >= one.agree:
        one = other
    variances = one.sigma_px**2 + COLOUR_PX**2, other.sigma_px**2 + (GAMMA * other.width_px) ** 2
    share = variances[1] / sum(variances)
    axis = share * one.cone.axis + (1.0 - share) * other.cone.axis
    radii = [edge.cone.theta_rad * camera.f_px for edge in (one, other)]
    apart_px = radii[0] - radii[1] if one is not other else 2.0 * math.sqrt(variances[0])
    return OutlineFit(
        axis / np.sqrt((axis * axis).sum()),
        share * radii[0] + (1.0 - share) * radii[1],
        math.hypot(math.sqrt(variances[0] * variances[1] / sum(variances)), 0.5 * apart_px),
        0.5 * (one.agree + other.agree) if one is not other or by_lightness else 0.5 * one.agree,
        max(one, other, key=lambda edge: edge.agree).rms_px,
        max(one.width_px, other.width_px),
        visible,
        one.rays,
    )


def _edge(
    seen: Lines, found: Edges, origin: Array, camera: CameraFit, tolerance_px: float, near: Cone | None
) -> Edge | None:
    if len(found.points) < (MIN_ARC if near else FIRST_ARC) * RAYS:
        return None
    rays = to_rays(found.points + origin, camera)
    cone = refined(near, rays, camera, tolerance_px) if near else consensus(rays, camera, tolerance_px)
    if cone is None:
        return None
    misses = misses_px(rays, cone, camera)
    agree = np.abs(misses) < tolerance_px
    count = int(np.count_nonzero(agree))
    if count < (0.2 if near else FIRST_ARC) * RAYS:
        return None
    misses = misses[agree]
    rms_px = math.sqrt(float(misses @ misses) / count)
    on = found.on.copy()
    on[on] = agree
    terms = AROUND[on]  # of a radius and a shift of the centre
    (n, a, b), (_, aa, ab), (_, _, bb) = (terms.T @ terms + LITTLE).tolist()
    minor = aa * bb - ab * ab
    variance = minor / (n * minor - a * (a * bb - ab * b) + b * (a * ab - aa * b)) * ALIKE
    sigma_px = max(rms_px, 0.05) * math.sqrt(variance)
    return Edge(cone, count / int(np.count_nonzero(seen.visible)), rms_px, found.width_px, sigma_px, on)
