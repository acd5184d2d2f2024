"""What a hundred real pairs are made of to stand for all water: their own, other water, and hardly any.

A pair is used in one of three ways. As it is, with another white balance, exposure and contrast of the camera. Its
reference in drawn water (degrade.py), for blue, green and turbid seas that no pair shows. Its reference as good as it
is, so that the network learns to leave a good picture alone. In front of most of them are vivid things (things.py),
seen through the same water. In place of some of them stands a pair of our own making, lest what was learned of other
water and of vivid things be forgotten over the dull ones.

The pair's own water, for things that are put into it, is fitted: raw = gain * reference + veil per colour, in linear
light. A thing that is nearer than the scene has lost less colour and has less veil in front of it.

Pictures are (side, side, 3) uint8 coded, blue green red, unless said otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from agent.tools.degrade import GAMMA, Image, Picture, coded_bytes, draw_sea, pair, photograph, submerge
from agent.tools.landscapes import FAR, landscape, noise
from agent.tools.things import MOST, draw_thing, put_into, with_things

OWN = 0.25  # share of pairs of our own making
OTHER_WATER, AUGMENT_NO_WATER = 0.3, 0.15  # shares of the others; the rest are as they are
WITH_THINGS = 0.7
TINT, EXPOSURE, CONTRAST = 0.12, 0.25, 0.15  # deviations of the logarithms of gain per colour, of light, of gamma
SLIGHT = 0.3  # of these for a picture without water
GAINS = (0.01, 4.0)  # that a fit may give: beyond is no water


class Water(NamedTuple):
    """raw = gain * reference + veil, (3,) each, linear light blue green red."""

    gain: Picture
    veil: Picture


def augmented(raw: Image, reference: Image, rng: np.random.Generator) -> tuple[Image, Image]:
    """A pair that a real one stands for."""
    if rng.random() < OWN:
        picture, z, vivid = with_things(*landscape(raw.shape[0], rng), rng)
        return pair(picture, z, rng, vivid)
    count = int(rng.integers(1, MOST + 1)) if rng.random() < WITH_THINGS else 0
    things = [draw_thing(raw.shape[0], rng) for _ in range(count)]
    clear, way = linear(reference), rng.random()
    seen, water = linear(raw), water_of(raw, reference)
    for thing in things:
        clear = put_into(clear, thing)
        near = through(thing.picture, water, float(rng.random()))
        seen = put_into(seen, thing._replace(picture=near))
    target = coded_bytes(clear) if things else reference
    if way < OTHER_WATER:
        return in_other_water(clear, rng), target
    if way < OTHER_WATER + AUGMENT_NO_WATER:
        return as_taken(clear, SLIGHT, rng), target
    return as_taken(seen, 1.0, rng), target


def water_of(raw: Image, reference: Image) -> Water:
    """Least squares per colour; a colour that does not follow its reference keeps its mean."""
    x, y = linear(reference).reshape(-1, 3), linear(raw).reshape(-1, 3)
    mx, my = x.mean(0), y.mean(0)
    slope = ((x - mx) * (y - my)).mean(0) / np.maximum(((x - mx) ** 2).mean(0), 1e-6)
    gain = np.clip(slope, *GAINS)
    return Water(np.asarray(gain, np.float32), np.asarray(np.maximum(my - gain * mx, 0), np.float32))


def through(picture: Picture, water: Water, share: float) -> Picture:
    """Linear light through a share of the water's path: exposure stays, colour is lost and veil gained."""
    exposure = water.gain.max()
    lost = (water.gain / exposure) ** np.float32(share)
    return np.asarray(exposure * lost * picture + np.float32(share) * water.veil, np.float32)


def in_other_water(clear: Picture, rng: np.random.Generator) -> Image:
    """A picture without water, linear, put into some and photographed; its ranges are invented."""
    side, sea = clear.shape[0], draw_sea(rng)
    slope = np.float32(rng.uniform(0, 1.5)) * np.linspace(1, -0.5, side, dtype=np.float32)[:, None]
    z = np.exp(slope + np.float32(rng.uniform(0, 0.3)) * noise(side, rng, (8, 12)))
    z = np.clip(z / np.median(z), 0.1, FAR) * np.float32(sea.green_depth / sea.direct[1])
    return photograph(submerge(clear, np.asarray(z, np.float32), sea, float(rng.uniform(0.3, 1.0))), rng)


def as_taken(picture: Picture, strength: float, rng: np.random.Generator) -> Image:
    """Linear light as another camera would have taken it: gain per colour, exposure, contrast."""
    gain = np.exp(rng.normal(0, strength * TINT, 3) + rng.normal(-0.1, strength * EXPOSURE)).astype(np.float32)
    bend = np.float32(np.exp(rng.normal(0, strength * CONTRAST)))
    return coded_bytes(np.clip(picture * gain, 0, 1) ** bend)


def linear(image: Image) -> Picture:
    """Coded uint8 -> linear light, 0 to 1."""
    return np.asarray(cv2.LUT(image, _LINEAR), np.float32)


_LINEAR = ((np.arange(256) / 255) ** GAMMA).astype(np.float32)
