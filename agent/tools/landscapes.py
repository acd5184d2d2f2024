"""Places that never were: terrain, boulders, growth and open water from noise, with the range of every pixel.

What matters to the enhancement is not what things are, but that colours, contrasts, ranges and textures come in every
combination that a sea floor offers: sand and rock in dull colours, here and there something vivid, open water behind.
"""

from __future__ import annotations

import colorsys
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.tools.degrade import Picture, Plane

BANK, SHEETS = 512, 12  # px a side; how many sheets of noise are kept to cut from
FAR = 8.0  # range of open water, in units of the terrain's


@lru_cache(maxsize=1)
def bank() -> NDArray[np.float32]:
    """(SHEETS, BANK, BANK) periodic noise, zero mean and unit deviation, from rough to smooth."""
    rng = np.random.default_rng(0)
    f = np.hypot(np.fft.fftfreq(BANK)[:, None], np.fft.rfftfreq(BANK)[None, :]) * BANK
    f[0, 0] = np.inf
    sheets = []
    for slope in np.linspace(0.7, 2.0, SHEETS):
        sheet = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((BANK, BANK))) * np.maximum(f, 2.0) ** -slope)
        sheets.append(sheet / sheet.std())
    return np.asarray(sheets, np.float32)


def noise(side: int, rng: np.random.Generator, smooth: tuple[int, int] = (0, SHEETS)) -> Plane:
    """(side, side) cut from the bank at a random place, angle and size."""
    sheet = bank()[rng.integers(*smooth)]
    angle, scale = rng.uniform(0, 2 * np.pi), BANK / side * rng.uniform(0.3, 1.0)
    c, s = np.cos(angle) * scale, np.sin(angle) * scale
    x, y = rng.uniform(0, BANK, 2)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    cut = cv2.warpAffine(
        sheet, np.array([(c, -s, x), (s, c, y)]), (side, side), flags=flags, borderMode=cv2.BORDER_WRAP
    )
    return np.asarray(cut, np.float32)


def paint(side: int, rng: np.random.Generator, vivid: float) -> Picture:
    """(side, side, 3) albedo: two or three colours mixed by noise, grain on top, lit from one side."""
    picture = np.broadcast_to(colour(rng, vivid), (side, side, 3)).astype(np.float32)
    for _ in range(int(rng.integers(1, 4))):
        share = _step(noise(side, rng, (5, SHEETS)) - np.float32(rng.uniform(-0.5, 1.2)), rng.uniform(0.05, 1.5))
        picture = picture + share[:, :, None] * (colour(rng, vivid) - picture)
    relief = noise(side, rng, (0, 9))
    tilt = cv2.Sobel(relief, cv2.CV_32F, 1, 0) * np.float32(rng.normal()) + cv2.Sobel(relief, cv2.CV_32F, 0, 1)
    light = np.exp(np.float32(rng.uniform(0.1, 0.6)) * tilt / max(float(tilt.std()), 1e-3))
    light = light * np.exp(noise(side, rng, (0, 4)) * np.float32(rng.uniform(0, 0.25)))
    return np.asarray(np.clip(picture * light[:, :, None], 0, 1.5), np.float32)


def colour(rng: np.random.Generator, vivid: float) -> Picture:
    """(3,) blue green red, linear; dull and warm as sand and rock are, or with probability `vivid` anything."""
    if rng.random() < vivid:
        hue, saturation, value = rng.random(), rng.uniform(0.3, 0.9), rng.uniform(0.2, 1.0)
    else:
        hue, saturation, value = rng.normal(0.09, 0.07) % 1, rng.uniform(0.0, 0.4), rng.uniform(0.15, 0.95)
    return np.array(colorsys.hsv_to_rgb(hue, saturation, value)[::-1], np.float32) ** np.float32(2.2)


def landscape(side: int, rng: np.random.Generator) -> tuple[Picture, Plane]:
    """One place: (side, side, 3) linear light, and (side, side) range in units of its median."""
    y = np.linspace(0, 1, side, dtype=np.float32)[:, None]
    x = np.linspace(-0.5, 0.5, side, dtype=np.float32)[None, :]
    relief = noise(side, rng, (5, SHEETS))
    picture = paint(side, rng, 0.06)
    if rng.random() < 0.45:  # a wall or the floor from above
        bumps, tilt = np.float32(rng.uniform(0, 0.25)), np.float32(rng.uniform(-0.8, 0.8))
        z = np.asarray(1 + bumps * relief + tilt * (0.5 - y), np.float32)
    else:  # the floor to the horizon, open water above it
        horizon = np.float32(rng.uniform(-0.2, 0.55)) + np.float32(rng.normal(0, 0.2)) * x + np.float32(0.04) * relief
        slant = y - horizon
        away = np.where(slant > 0, np.minimum(0.5 / np.maximum(slant, 1e-3), FAR), FAR)
        z = np.asarray(away + 0.1 * relief, np.float32)
    for _ in range(int(rng.integers(0, 7))):
        mask, bulge = _boulder(side, rng)
        distance = np.float32(rng.uniform(0.35, 1.5))
        front = np.asarray(mask * (z > distance), np.float32)
        thing = paint(side, rng, 0.25) * (np.float32(0.45) + np.float32(0.55) * bulge)[:, :, None]
        picture = np.asarray(picture + front[:, :, None] * (thing - picture), np.float32)
        z = np.asarray(z + front * (distance * (np.float32(1.1) - np.float32(0.2) * bulge) - z), np.float32)
    if rng.random() < 0.4:  # holes and crevices
        hole = _step(noise(side, rng, (4, 10)) - np.float32(rng.uniform(1.2, 2.2)), 0.15)
        picture = picture * (1 - np.float32(0.9) * hole)[:, :, None]
    z = np.asarray(np.clip(z, 0.15, FAR), np.float32)
    return np.asarray(picture, np.float32), z / np.float32(np.median(z))


def _boulder(side: int, rng: np.random.Generator) -> tuple[Plane, Plane]:
    """(side, side) mask and height 0 to 1 of something roundish with a ragged rim."""
    y, x = np.mgrid[0:side, 0:side].astype(np.float32) / side
    cx, cy, angle = rng.uniform(0, 1), rng.uniform(0, 1), rng.uniform(0, np.pi)
    a, b = rng.uniform(0.03, 0.35, 2)
    u = ((x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)) / a
    v = ((y - cy) * np.cos(angle) - (x - cx) * np.sin(angle)) / b
    rise = 1 - u * u - v * v + np.float32(rng.uniform(0, 0.4)) * noise(side, rng, (4, 10))
    mask = _step(rise.astype(np.float32), 0.06)
    return mask, np.sqrt(np.clip(rise, 0, 1)).astype(np.float32)


def _step(value: Plane, softness: float) -> Plane:
    """0 to 1 where `value` goes through zero."""
    return np.asarray(1 / (1 + np.exp(np.clip(-value / np.float32(softness), -30, 30))), np.float32)
