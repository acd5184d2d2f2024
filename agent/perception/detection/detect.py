"""Find a ball of one colour in a frame, sharp or defocused, whole or cut off by the edge of the frame.

Colour says where it may be, shape says where it is. The outline of a sphere is a circular cone of rays m around the
direction of the centre: m . g = 1, with g = a / cos(theta), a the axis and theta the apparent angular radius. That is
linear in g and exact off the optical axis, where the image is an ellipse and its centroid is not the centre's image.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.kernel.config import Colour
from agent.kernel.ranging.calibration import CameraFit
from agent.kernel.ranging.camera_model import UNBEND
from agent.perception.detection.colour import CONTRAST, Light, light, share, untint

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SHRINK = 4  # the search runs on a picture this much smaller
MIN_SHARE = 0.06  # of the colour, see colour.share(): walls and floor stay below 0.03 where red is looked for
MIN_RADIUS_PX = 12.0  # 0.07 m at f = 1169 px: beyond 5 m
RAYS = 96  # points of the outline
BAND = 0.30  # the outline is looked for within this share of the radius inside and outside the first guess,
BAND_FRAME = 0.05  # and within this share of the frame's width: twice the largest blur's radius
SAMPLES = 49  # along each of them
TRIALS = 60  # RANSAC, three points each: with 60 % good points one of 60 triples is good but for 1 in 10^6
SEED = 1  # the same frame gives the same answer
MIN_INLIERS = 0.6  # share of the visible outline that has to agree
MIN_ARC = 0.28  # share of the whole outline: what is left of 120 deg where it runs into the edge of the frame


class Ball(NamedTuple):
    """A ball in the full frame. Pixels from the centre of the upper left pixel, u right, v down."""

    centre_px: tuple[float, float]  # where the ray to the centre meets the image
    radius_px: float  # apparent angular radius times f_px
    score: float  # share of the outline that agrees with the cone, 0 to 1


class Cone(NamedTuple):
    axis: Array  # (3,) unit vector, camera frame
    theta_rad: float


def find_ball(
    image: Image, camera: CameraFit, origin_px: tuple[int, int] = (0, 0), colour: Colour = "red"
) -> Ball | None:
    """The most convincing ball of an image (height, width, 3) blue green red; None if there is none.

    `origin_px` is where the image's upper left pixel lies in the full frame. A ball that overflows the frame is
    found while the frame shows 120 deg of its outline.
    """
    small = _smaller(image)
    if small is None:
        return None
    gain = untint(small, colour)
    # More of the colour than grey has in air, and more than the surroundings have: these are far, and tinted more.
    seed = _search(np.minimum(share(small, colour), share(small * gain, colour)), image)
    if seed is None:
        return None
    weights = gain * CONTRAST[colour]
    origin = np.asarray(origin_px, float)
    cone = _consensus(_rays(seed + origin, camera), camera, tolerance_px=1.5 * SHRINK)
    for _ in range(2):  # the second pass starts from an outline within a pixel or two
        if cone is None:
            return None
        band = min(BAND, BAND_FRAME * camera.width_px / (cone.theta_rad * camera.f_px))
        points = _edges(image, weights, _outline(cone, camera) - origin, _project(cone.axis, camera) - origin, band)
        if len(points) < MIN_ARC * RAYS:
            return None
        rays = _rays(points + origin, camera)
        cone = _consensus(rays, camera, tolerance_px=max(2.0, 0.03 * cone.theta_rad * camera.f_px))
    if cone is None:
        return None
    agree = _agree(rays, cone, camera, max(2.0, 0.03 * cone.theta_rad * camera.f_px))
    count, radius = int(agree.sum()), cone.theta_rad * camera.f_px
    if count < max(MIN_INLIERS * len(points), MIN_ARC * RAYS) or not MIN_RADIUS_PX <= radius <= _max_radius_px(camera):
        return None
    u, v = _project(cone.axis, camera)
    return Ball((float(u), float(v)), float(radius), count / RAYS)


def _max_radius_px(camera: CameraFit) -> float:
    """The largest circle of which the frame can hold 120 deg: their chord, sqrt(3) radii, fits into its diagonal."""
    return math.hypot(camera.width_px, camera.height_px) / math.sqrt(3.0)


def _smaller(image: Image) -> Light | None:
    """Light of a picture SHRINK times smaller; None if nothing could be seen in it."""
    height, width = image.shape[0] // SHRINK, image.shape[1] // SHRINK
    if min(height, width) < 8:
        return None
    return light(np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8))


def _search(coloured: Light, image: Image) -> Array | None:
    """Points (n, 2) on the outline of the largest spot of the colour, without those on the image's own border."""
    height, width = coloured.shape
    score = np.asarray(cv2.medianBlur((255.0 * np.maximum(coloured, 0.0)).astype(np.uint8), 3), np.uint8)
    otsu, _ = cv2.threshold(score, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, mask = cv2.threshold(score, max(otsu, 255 * MIN_SHARE), 255, cv2.THRESH_BINARY)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    spot = max(contours, key=cv2.contourArea)
    if cv2.contourArea(spot) * SHRINK**2 < MIN_RADIUS_PX**2:
        return None
    points: Array = spot[:, 0, :].astype(np.float64)
    free = (points > 0).all(axis=1) & (points < np.array([width - 1, height - 1])).all(axis=1)
    points = points[free]
    if len(points) < 8:
        return None
    points += 0.5  # centres of small pixels, from the corner of the picture
    points *= (image.shape[1] / width, image.shape[0] / height)
    points -= 0.5
    return points


def _edges(image: Image, weights: Light, outline: Array, centre: Array, band: float) -> Array:
    """Sub-pixel edge near each point of a predicted outline -> points (n, 2), where there is one.

    Along a line through the centre the ball's light falls from an inner to an outer level; the edge is where it
    passes their mean, which a blur does not move. `weights` (3,) make one number of blue, green and red light.
    """
    height, width = image.shape[:2]
    reach = np.linspace(1.0 - band, 1.0 + band, SAMPLES)
    line = outline - centre  # (RAYS, 2)
    map_x = (centre[0] + line[:, :1] * reach).astype(np.float32)
    map_y = (centre[1] + line[:, 1:] * reach).astype(np.float32)
    inside = (map_x >= 0) & (map_x <= width - 1) & (map_y >= 0) & (map_y <= height - 1)
    quarter = SAMPLES // 4
    visible = inside[:, quarter:-quarter].all(axis=1)
    if not visible.any():
        return outline[:0]
    seen = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profile: Array = np.asarray(cv2.GaussianBlur(light(np.asarray(seen, np.uint8)) @ weights, (5, 1), 1.0), float)
    inner = np.median(profile[:, :quarter], axis=1)
    outer = np.median(profile[:, -quarter:], axis=1)
    contrast = inner - outer
    good = visible & (contrast > max(0.25 * np.median(contrast[visible]), 0.0))  # nothing else is in front
    inner *= _shading(profile[:, :quarter], reach[:quarter], good)
    above = profile > (0.5 * (inner + outer))[:, None]
    # The last step down, seen from inside: texture may dip below the level before.
    down = above[:, :-1] & ~above[:, 1:]
    last = down.shape[1] - 1 - np.argmax(down[:, ::-1], axis=1)
    k = np.nonzero(good & down.any(axis=1))[0]
    a, b = profile[k, last[k]], profile[k, last[k] + 1]
    level = 0.5 * (inner[k] + outer[k])
    at = reach[last[k]] + (reach[1] - reach[0]) * (a - level) / (a - b)
    points: Array = centre + line[k] * at[:, None]
    return points


def _shading(inside: Array, reach: Array, good: NDArray[np.bool_]) -> Array:
    """(RAYS,) how much brighter the ball is at its outline than further in, `inside` (RAYS, n) at `reach` (n,).

    Light falls from above, and the edge of a ball that grows darker outwards seems to lie too far in. The gradient
    is smooth around the ball: level and slope are each a mean and a first harmonic, fitted to all rays at once.
    """
    turn = np.linspace(0.0, 2.0 * np.pi, len(inside), endpoint=False)
    around = np.stack([np.ones_like(turn), np.cos(turn), np.sin(turn)], axis=1)  # (RAYS, 3)
    outward = reach - 1.0
    terms = np.concatenate([np.repeat(around[:, None], len(reach), 1), around[:, None] * outward[:, None]], axis=2)
    if good.sum() < 6:
        return np.ones(len(inside))
    fit = np.linalg.lstsq(terms[good].reshape(-1, 6), inside[good].ravel(), rcond=None)[0]
    at_edge, within = around @ fit[:3], around @ (fit[:3] + fit[3:] * outward.mean())
    ratio: Array = np.where(within > 0.0, at_edge / np.where(within > 0.0, within, 1.0), 1.0)
    return np.clip(ratio, 0.5, 1.5)


@lru_cache(maxsize=RAYS)
def _triples(count: int) -> NDArray[np.int64]:
    """(TRIALS, 3) of so many points: the same ones each time."""
    return np.random.Generator(np.random.PCG64(SEED)).integers(0, count, (TRIALS, 3))


def _consensus(rays: Array, camera: CameraFit, tolerance_px: float) -> Cone | None:
    """RANSAC over triples, then least squares of m . g = 1 on the rays that agree, twice."""
    draw = _triples(len(rays))
    m1, m2, m3 = rays[draw[:, 0]], rays[draw[:, 1]], rays[draw[:, 2]]
    normal = np.cross(m2 - m1, m3 - m1)  # of the plane through three points of the unit sphere
    offset = (normal * m1).sum(axis=1)
    size = np.sqrt((normal * normal).sum(axis=1))
    usable = np.abs(offset) > 0.2 * size  # theta below 78 deg, and three different points
    usable &= size > 1e-12
    if not usable.any():
        return None
    g = normal[usable] / offset[usable, None]
    theta_tolerance = tolerance_px / camera.f_px
    miss = np.abs(rays @ g.T - 1.0) / np.sqrt(np.maximum((g * g).sum(axis=1) - 1.0, 1e-9))
    best = g[np.argmax((miss < theta_tolerance).sum(axis=0))]
    for _ in range(2):
        cone = _cone(best)
        if cone is None:
            return None
        agree = _agree(rays, cone, camera, tolerance_px)
        if agree.sum() < 6:
            return None
        best = np.linalg.lstsq(rays[agree], np.ones(int(agree.sum())), rcond=None)[0]
    return _cone(best)


def _cone(g: Array) -> Cone | None:
    length = float(np.sqrt((g * g).sum()))
    if not length > 1.0 or g[2] <= 0.0:
        return None
    return Cone(g / length, float(np.arccos(1.0 / length)))


def _agree(rays: Array, cone: Cone, camera: CameraFit, tolerance_px: float) -> NDArray[np.bool_]:
    angle = np.arccos(np.clip(rays @ cone.axis, -1.0, 1.0))
    return np.abs(angle - cone.theta_rad) * camera.f_px < tolerance_px


def _outline(cone: Cone, camera: CameraFit) -> Array:
    """RAYS pixels (RAYS, 2) around the cone."""
    side = np.cross(cone.axis, [0.0, 1.0, 0.0])
    side /= np.sqrt((side * side).sum())
    other = np.cross(cone.axis, side)
    phi = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)[:, None]
    ring = np.cos(phi) * side + np.sin(phi) * other
    return _project(np.cos(cone.theta_rad) * cone.axis + np.sin(cone.theta_rad) * ring, camera)


def _rays(points_px: Array, camera: CameraFit) -> Array:
    """Unit rays (n, 3), camera frame, through pixels (n, 2)."""
    m: Array = np.ones((len(points_px), 3))
    seen = (points_px - (camera.cx_px, camera.cy_px)) / camera.f_px
    m[:, :2] = seen
    for _ in range(UNBEND):
        m[:, :2] = seen / (1.0 + camera.bend * (m[:, :2] ** 2).sum(axis=1, keepdims=True))
    m /= np.sqrt((m * m).sum(axis=1))[:, None]
    return m


def _project(directions: Array, camera: CameraFit) -> Array:
    """Pixels (..., 2) of directions (..., 3) in front of the camera."""
    slope = directions[..., :2] / directions[..., 2:]
    slope = slope * (1.0 + camera.bend * (slope * slope).sum(axis=-1, keepdims=True))
    px: Array = camera.f_px * slope + np.array([camera.cx_px, camera.cy_px])
    return px
