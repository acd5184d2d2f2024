"""The edge of a ball to a fraction of a pixel, along lines through its centre.

A profile is one number of a pixel's light, blue green red. It falls from an inner to an outer level; the edge is where
it passes their mean, which a blur does not move.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.perception.detection.cone import RAYS, Array
from agent.perception.detection.picture import LIGHT, Light, Picture

Mask = NDArray[np.bool_]

SAMPLES = 49  # along each line
QUARTER = SAMPLES // 4  # of them for each of the two levels
TURN = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
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
