"""Water put into a picture, and the picture that the enhancement shall make of it.

    I = J exp(-bD z) + B (1 - exp(-bB z))        (Akkaynak and Treibitz, CVPR 2018), per colour, in linear light

J is the scene under the light that is left at its depth, z the range, B the veil. Around it, in the order in which
they happen: uneven light, forward scatter, drifting particles, the camera's exposure and white balance, noise, eight
bits, JPEG. Every number is drawn anew for each picture, wider than any one sea: the network shall not know its water.

The target is not J itself. What lies far away cannot be brought back, so a share of the veil stays, without its
colour; and the picture is white-balanced, stretched and brought to a common brightness, as a person would hand it on.

Pictures are (h, w, 3) float32, blue green red, 0 to 1; linear light unless a name says `coded`.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.float32]
Plane = NDArray[np.float32]
Image = NDArray[np.uint8]

GAMMA = 2.2
# Diffuse attenuation 1/m in bands around 460, 535 and 610 nm, Jerlov's types I, IA, IB, II, III, 1C, 3C, 5C, 7C, 9C
# (Jerlov 1976, table XXVII; types I to 1C as revised by Austin and Petzold; integrated over the bands).
JERLOV_PER_M = np.array(
    [
        (0.020, 0.063, 0.251), (0.028, 0.067, 0.254), (0.037, 0.072, 0.258), (0.070, 0.090, 0.272),
        (0.131, 0.123, 0.298), (0.192, 0.157, 0.324), (0.367, 0.215, 0.348), (0.536, 0.332, 0.433),
        (0.846, 0.507, 0.521), (1.432, 0.761, 0.642),
    ]
)  # fmt: skip
COASTAL = 5  # from this row on water is green
KEPT = 0.25  # share of the optical depth that the target keeps: far things stay hazy, as they look natural
LEVEL, BALANCED = 0.46, 0.85  # of the target: mean coded brightness; share of the way to grey-world balance
LOW, HIGH = 0.5, 99.5  # percentiles of the target that become black and white
FORWARD = 0.35  # share of the direct light that is scattered forward (as in the twin's design)


class Sea(NamedTuple):
    """Coefficients 1/m per colour, and light: `down` of the day at the scene, `veil` at infinite range."""

    direct: Picture
    scatter: Picture
    veil: Picture
    down: Picture
    green_depth: float  # optical depth in green at the median range


def draw_sea(rng: np.random.Generator) -> Sea:
    """Some water: six in ten are coastal and green, the others oceanic and blue; ranges as the ocean optics allow."""
    row = rng.uniform(COASTAL, 9) if rng.random() < 0.6 else rng.uniform(0, COASTAL)
    low = int(row)
    kd = JERLOV_PER_M[low] + (row - low) * (JERLOV_PER_M[min(low + 1, 9)] - JERLOV_PER_M[low])
    kd = kd * rng.uniform(0.8, 1.25, 3)
    direct, scatter = kd * rng.uniform(1, 1.8), kd * rng.uniform(0.6, 2.0) + rng.uniform(0, 0.35) * kd.mean()
    # At working depth: how far the light has come down, up to four optical depths of the weakest colour.
    down = np.exp(-kd * rng.uniform(0, 4.0) / kd.max())
    veil = down * np.exp(-kd * rng.uniform(0, 2.0) / kd.max()) * rng.uniform(0.05, 0.5)
    return Sea(_colour(direct), _colour(scatter), _colour(veil), _colour(down), float(rng.uniform(0.05, 1.0)))


def pair(
    picture: Picture, range_share: Plane, rng: np.random.Generator, vivid: Plane | None = None
) -> tuple[Image, Image]:
    """(raw, target), both (h, w, 3) uint8 coded: a scene in linear light seen through some water, and without.

    `range_share` (h, w) is the range in units of its median: how far that is in metres depends on the water. `vivid`
    (h, w) 0 to 1 marks what the target's white balance shall not look at.
    """
    sea = draw_sea(rng)
    z = range_share * np.float32(sea.green_depth / sea.direct[1])
    if rng.random() < 0.5:
        light = _uneven(picture.shape[0], picture.shape[1], rng)
        picture, lit = picture * np.sqrt(light), picture * light
    else:
        lit = picture
    seen = submerge(lit, z, sea, float(rng.uniform(0.4, 2.5)))
    if rng.random() < 0.3:
        seen = seen + _snow(seen.shape[0], seen.shape[1], rng)[:, :, None] * sea.veil
    return photograph(seen, rng), target(picture, z, sea, vivid)


def submerge(lit: Picture, z: Plane, sea: Sea, reach_px: float) -> Picture:
    """What arrives from a scene under the day's light, `z` (h, w) metres away; forward scatter blurs by `reach_px`."""
    direct = lit * sea.down * np.exp(-sea.direct * z[:, :, None])
    scattered = cv2.GaussianBlur(direct, (0, 0), reach_px)
    weight = (FORWARD * (1 - np.exp(-z * sea.direct[1])))[:, :, None]
    veil = sea.veil * -np.expm1(-sea.scatter * z[:, :, None])
    return np.asarray(direct + weight * (scattered - direct) + veil, np.float32)


def target(picture: Picture, z: Plane, sea: Sea, vivid: Plane | None = None) -> Image:
    """The scene with a thin grey veil in the distance, balanced and stretched."""
    grey = float(sea.direct.mean()) * KEPT
    left = np.exp(-grey * z)[:, :, None]
    tint = sea.veil / sea.veil.max()
    veil = np.float32(0.6) * (np.float32(0.8) + np.float32(0.2) * tint)
    return finish(picture * left + veil * (1 - left), vivid)


def finish(picture: Picture, vivid: Plane | None = None) -> Image:
    """White balance, full contrast, common brightness: (h, w, 3) linear -> uint8 coded.

    What lies under `vivid` (h, w) 0 to 1 does not vote in the balance: a red buoy is no tint of the light.
    """
    coded = np.power(np.maximum(picture, 0), np.float32(1 / GAMMA))
    votes = np.ones(picture.shape[:2]) if vivid is None else np.maximum(1 - vivid, 1e-3)
    mean = np.maximum(np.average(coded, axis=(0, 1), weights=np.repeat(votes[:, :, None], 3, 2)), 1e-3)
    coded = coded * np.clip(mean.mean() / mean, 0.5, 2.0) ** BALANCED
    low, high = np.percentile(coded, (LOW, HIGH))
    coded = np.clip((coded - low) / max(high - low, 0.05), 0, 1)
    # Half of the way to the common brightness: a night picture stays darker than a white sand.
    bend = np.log(LEVEL) / np.log(np.clip(coded.mean(), 0.1, 0.9))
    return _bytes(coded ** np.float32(np.sqrt(bend)))


def photograph(seen: Picture, rng: np.random.Generator) -> Image:
    """What a cheap camera makes of linear light: exposure, some white balance, gamma, noise, eight bits, JPEG."""
    mean = np.maximum(seen.mean((0, 1)), 1e-4)
    seen = seen * (mean.max() / mean) ** np.float32(0.7 * rng.random() ** 2)  # automatic balance goes part of the way
    bright = max(float(np.percentile(seen.max(axis=2), 95)), 1e-4)
    coded = np.power(np.maximum(seen * np.float32(rng.uniform(0.12, 1.0) / bright), 0), np.float32(1 / GAMMA))
    if rng.random() < 0.5:
        coded = cv2.GaussianBlur(coded, (0, 0), rng.uniform(0.3, 0.9))
    noise = rng.standard_normal(coded.shape, np.float32) * np.float32(rng.uniform(0, 0.02))
    image = _bytes(coded + noise)
    if rng.random() < 0.6:
        _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 96))])
        image = np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), np.uint8)
    return image


def coded_bytes(picture: Picture) -> Image:
    """Linear light -> uint8 coded."""
    return _bytes(np.power(np.maximum(picture, 0), np.float32(1 / GAMMA)))


def _uneven(height: int, width: int, rng: np.random.Generator) -> Picture:
    """(h, w, 1) light of a lamp or a low sun: a broad spot and a slope, 0.15 to 1."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    cx, cy = rng.uniform(-0.2, 1.2) * width, rng.uniform(-0.2, 1.2) * height
    size = rng.uniform(0.4, 1.2) * max(height, width)
    spot = np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * size**2))
    low = rng.uniform(0.15, 0.6)
    return np.asarray((low + (1 - low) * spot)[:, :, None], np.float32)


def _snow(height: int, width: int, rng: np.random.Generator) -> Plane:
    """(h, w) brightness of drifting particles: a few dozen soft dots."""
    flakes = np.zeros((height, width), np.float32)
    for x, y, brightness in zip(
        *rng.uniform((0, 0, 1), (width, height, 12), (int(rng.integers(5, 80)), 3)).T, strict=True
    ):
        flakes[int(y), int(x)] = brightness
    return np.asarray(cv2.GaussianBlur(flakes, (0, 0), rng.uniform(0.6, 1.6)), np.float32)


def _colour(values: NDArray[np.float64]) -> Picture:
    return values.astype(np.float32)


def _bytes(coded: Picture) -> Image:
    return (np.clip(coded, 0, 1) * 255 + 0.5).astype(np.uint8)
