"""A disc in a picture against the ring around it: its tone, and how clearly the one ends where the other begins."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.perception.detection.colour import BURNT, Tone, hue_and_strength, weights
from agent.perception.detection.cone import Array
from agent.perception.detection.picture import LIGHT, Light, Picture

Pixels = NDArray[np.uint8]  # (n, 3)

EVERY = 3  # of the outline's rays one is enough
FEWEST = 6  # of these
INNER = np.array([0.15, 0.30, 0.45, 0.58, 0.70, 0.80])  # of the radius, samples of the disc
NEAR_RIM = 4  # the first of these that are seen on a ball of which something hides a half
BEYOND = np.array([0.30, 0.45, 0.60, 0.80])  # of the radius, samples of the ring outside the outline
CLEAR_PX, FAR_PX = 2.0, 64.0  # there it is at least so far from the outline, for blur and JPEG, and ends before that


class Patch(NamedTuple):
    """Light (3,) of the ring, and the disc against it."""

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
    hue_rad, strength = hue_and_strength(own - around)
    along = weights(hue_rad)
    inner, outer = picture.log_light[disc] @ along, picture.log_light[ring] @ along
    level = 0.5 * float(np.median(inner) + np.median(outer))
    return Patch(
        ring=np.asarray(np.exp(around) - picture.dark, np.float32),
        tone=Tone(hue_rad, strength, float(own[2] - 0.5 * (own[0] + own[1])), float(own[2] - own[1]), burnt),
        dark=-float((own - around).max()),
        bright=float((own - around).min()),
        full=float((inner > level).mean()),
        clear=float((outer < level).mean()),
        unrest=float(inner.std() + outer.std()) / max(strength, 1e-6),
    )
