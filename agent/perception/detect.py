"""Find a red ball in a frame, sharp or defocused, whole or cut off by the edge of the frame.

Colour says where it may be, shape says where it is. The outline of a sphere is a circular cone of rays m around the
direction of the centre: m . g = 1, with g = a / cos(theta), a the axis and theta the apparent angular radius. That is
linear in g and exact off the optical axis, where the image is an ellipse and its centroid is not the centre's image.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.ranging.calibration import CameraFit
from agent.ranging.camera_model import UNBEND

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SHRINK = 4  # the search runs on a picture this much smaller
MIN_REDNESS = 0.10  # see redness(): rendered balls have 0.4 to 0.6 in every kind of water, all else below 0.04
DARK = 24.0  # 8-bit value below which the noise of a pixel counts as no colour
MIN_RADIUS_PX, MAX_RADIUS_PX = 12.0, 400.0  # 0.07 m at f = 1169 px: beyond 5 m, nearer than 0.2 m
RAYS = 96  # points of the outline
BAND = 0.30  # the outline is looked for within this share of the radius inside and outside the first guess
SAMPLES = 49  # along each of them
TRIALS = 60  # RANSAC, three points each: with 60 % good points one of 60 triples is good but for 1 in 10^6
SEED = 1  # the same frame gives the same answer
MIN_INLIERS = 0.6  # share of the visible outline that has to agree
MIN_ARC = 1 / 3  # share of the whole outline: from less than 120 deg the radius is a guess


class Ball(NamedTuple):
    """A ball in the full frame. Pixels from the centre of the upper left pixel, u right, v down."""

    centre_px: tuple[float, float]  # where the ray to the centre meets the image
    radius_px: float  # apparent angular radius times f_px
    score: float  # share of the outline that agrees with the cone, 0 to 1


class Cone(NamedTuple):
    axis: Array  # (3,) unit vector, camera frame
    theta_rad: float


def find_ball(image: Image, camera: CameraFit, origin_px: tuple[int, int] = (0, 0)) -> Ball | None:
    """The most convincing red ball of an image (height, width, 3) blue green red; None if there is none.

    `origin_px` is where the image's upper left pixel lies in the full frame.
    """
    seed = _search(image)
    if seed is None:
        return None
    origin = np.asarray(origin_px, float)
    cone = _consensus(_rays(seed + origin, camera), camera, tolerance_px=1.5 * SHRINK)
    for _ in range(2):  # the second pass starts from an outline within a pixel or two
        if cone is None:
            return None
        points, visible = _edges(image, _outline(cone, camera) - origin, _project(cone.axis, camera) - origin)
        if len(points) < MIN_ARC * RAYS:
            return None
        rays = _rays(points + origin, camera)
        cone = _consensus(rays, camera, tolerance_px=max(2.0, 0.03 * cone.theta_rad * camera.f_px))
    if cone is None:
        return None
    agree = _agree(rays, cone, camera, max(2.0, 0.03 * cone.theta_rad * camera.f_px))
    count, radius = int(agree.sum()), cone.theta_rad * camera.f_px
    if count < MIN_INLIERS * visible or count < MIN_ARC * RAYS or not MIN_RADIUS_PX <= radius <= MAX_RADIUS_PX:
        return None
    u, v = _project(cone.axis, camera)
    return Ball((float(u), float(v)), float(radius), count / RAYS)


def redness(image: Image) -> NDArray[np.uint8]:
    """255 (R - max(G, B)) / (R + G + B + dark) in light, clipped at 0: (height, width).

    In light, not in 8-bit values: the gamma would press a veiled red into grey.
    """
    b, g, r = (plane.astype(np.float32) ** 2 for plane in cv2.split(image))
    score = (r - np.maximum(g, b)) / (r + g + b + DARK**2)
    return (255.0 * np.maximum(score, 0.0)).astype(np.uint8)


def _search(image: Image) -> Array | None:
    """Points (n, 2) on the outline of the largest red spot, without those on the image's own border."""
    height, width = image.shape[0] // SHRINK, image.shape[1] // SHRINK
    if min(height, width) < 8:
        return None
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    score = cv2.medianBlur(redness(small), 3)  # type: ignore[arg-type]
    otsu, _ = cv2.threshold(score, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, mask = cv2.threshold(score, max(otsu, 255 * MIN_REDNESS), 255, cv2.THRESH_BINARY)
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


def _edges(image: Image, outline: Array, centre: Array) -> tuple[Array, int]:
    """Sub-pixel edge near each point of a predicted outline -> points (n, 2), number of outline points in the image.

    Along a line through the centre the ball's light falls from an inner to an outer level; the edge is where it
    passes their mean, which a blur does not move. Squared, 8-bit values are nearly linear in light (gamma 2.2), and
    R^2 - (G^2 + B^2)/2 is nought for every grey.
    """
    height, width = image.shape[:2]
    share = np.linspace(1.0 - BAND, 1.0 + BAND, SAMPLES)
    line = outline - centre  # (RAYS, 2)
    map_x = (centre[0] + line[:, :1] * share).astype(np.float32)
    map_y = (centre[1] + line[:, 1:] * share).astype(np.float32)
    inside = (map_x >= 0) & (map_x <= width - 1) & (map_y >= 0) & (map_y <= height - 1)
    near = slice(SAMPLES // 4, -(SAMPLES // 4))
    visible = inside[:, near].all(axis=1)
    light = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32) ** 2
    profile = light[:, :, 2] - 0.5 * (light[:, :, 0] + light[:, :, 1])
    profile = cv2.GaussianBlur(profile, (5, 1), 1.0)
    quarter = SAMPLES // 4
    inner = np.median(profile[:, :quarter], axis=1)
    outer = np.median(profile[:, -quarter:], axis=1)
    above = profile > (0.5 * (inner + outer))[:, None]
    # The last step down, seen from inside: texture may dip below the level before.
    down = above[:, :-1] & ~above[:, 1:]
    last = down.shape[1] - 1 - np.argmax(down[:, ::-1], axis=1)
    contrast = inner - outer
    typical = np.median(contrast[visible]) if visible.any() else np.inf
    good = visible & down.any(axis=1) & (contrast > max(0.25 * typical, 0.0))  # not where something else is in front
    k = np.nonzero(good)[0]
    a, b = profile[k, last[k]], profile[k, last[k] + 1]
    level = 0.5 * (inner[k] + outer[k])
    at = share[last[k]] + (share[1] - share[0]) * (a - level) / (a - b)
    return centre + line[k] * at[:, None], int(visible.sum())


def _consensus(rays: Array, camera: CameraFit, tolerance_px: float) -> Cone | None:
    """RANSAC over triples, then least squares of m . g = 1 on the rays that agree, twice."""
    draw = np.random.Generator(np.random.PCG64(SEED)).integers(0, len(rays), (TRIALS, 3))
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
