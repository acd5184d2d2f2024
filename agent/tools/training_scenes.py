"""Scenes to put water in, with the range of every pixel: landscapes of noise, vivid things and photographs; and the
water.

What matters to the enhancement is not what things are, but that colours, contrasts, ranges and textures come in every
combination that a sea floor offers: sand and rock in dull colours, here and there something vivid, open water behind.
"""

from __future__ import annotations

import colorsys
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError, to_install

# --- water put into a picture ---
# Water put into a picture, and the picture that the enhancement shall make of it.
#
# I = J exp(-bD z) + B (1 - exp(-bB z))        (Akkaynak and Treibitz, CVPR 2018), per colour, in linear light
#
# J is the scene under the light that is left at its depth, z the range, B the veil. Around it, in the order in which
# they happen: uneven light, forward scatter, drifting particles, the camera's exposure and white balance, noise,
# eight bits, JPEG. Every number is drawn anew for each picture, wider than any one sea: the network shall not know
# its water.
#
# The target is not J itself. What lies far away cannot be brought back, so a share of the veil stays, without its
# colour; and the picture is white-balanced, stretched and brought to a common brightness, as a person would hand it
# on.
#
# Pictures are (h, w, 3) float32, blue green red, 0 to 1; linear light unless a name says `coded`.

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


# --- landscapes ---

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


# --- vivid things ---
# Vivid things for the training pictures: buoys, fish, starfish, growth, most of them red, orange or yellow.
#
# Sea floors are dull, and a network that sees nothing else learns that warm colours are an error of the water. Green
# and blue things are among them, so that it does not learn to paint every buoy yellow either.

WARM_SHARE = 0.75  # of the things; the others have any other hue
WARM_HUES = ((-0.04, 0.02), (0.04, 0.1), (0.12, 0.175))  # turns of HSV: red, orange, yellow
OTHER_HUES = (0.28, 0.92)  # green to violet; what looks like yellow-green is a yellow thing in green water
RADII = (0.012, 0.3)  # of the picture's side; as many small ones as large ones, by octave
MOST, NEAR = 3, (0.1, 1.2)  # things in a picture; their range, in units of the scene's median
BURNT = 0.3  # of the things have a sunlit top without colour


class Thing(NamedTuple):
    """`mask` (h, w) 0 to 1; `picture` (h, w, 3) linear light blue green red, of use where the mask is."""

    mask: Plane
    picture: Picture


def draw_thing(side: int, rng: np.random.Generator) -> Thing:
    """One thing somewhere in a picture of side x side pixels."""
    radius = float(np.exp(rng.uniform(*np.log(RADII)))) * side
    kind = int(rng.integers(0, 4))  # ball, fish, starfish, growth
    slender = float(rng.uniform(0.35, 0.7)) if kind == 1 else 1.0
    u, v, rho, angle = _coordinates(side, radius, slender, rng)
    edge = np.ones_like(rho)
    if kind == 2:
        edge = np.float32(0.6) + np.float32(0.4) * np.cos(5 * angle)
    elif kind == 3:
        edge = np.clip(np.float32(0.8) + np.float32(0.3) * noise(side, rng, (3, 9)), 0.2, 1.5)
    mask = np.clip((edge - rho) * np.float32(radius * slender) + np.float32(0.5), 0, 1)
    body = _paint(u, side, kind, rng)
    return Thing(np.asarray(mask, np.float32), _lit(body, u, v, rho, rng))


def put_into(picture: Picture, thing: Thing) -> Picture:
    """A picture with the thing in front of it, both in linear light."""
    return np.asarray(picture + thing.mask[:, :, None] * (thing.picture - picture), np.float32)


def with_things(picture: Picture, z: Plane, rng: np.random.Generator) -> tuple[Picture, Plane, Plane]:
    """A scene and its ranges with some things in it, nearer than most of the scene; third, where they are."""
    vivid = np.zeros_like(z)
    for _ in range(int(rng.integers(1, MOST + 1))):
        thing, near = draw_thing(z.shape[0], rng), np.float32(rng.uniform(*NEAR))
        picture = put_into(picture, thing)
        z = z + thing.mask * (near - z)
        vivid = np.maximum(vivid, thing.mask)
    return picture, np.asarray(z, np.float32), vivid


def vivid_colour(rng: np.random.Generator) -> Picture:
    """(3,) blue green red, linear."""
    hues = WARM_HUES[int(rng.integers(0, len(WARM_HUES)))] if rng.random() < WARM_SHARE else OTHER_HUES
    hue = rng.uniform(*hues) % 1
    coded = colorsys.hsv_to_rgb(hue, rng.uniform(0.55, 1.0), rng.uniform(0.4, 1.0))[::-1]
    return np.array(coded, np.float32) ** np.float32(GAMMA)


def _coordinates(side: int, radius: float, slender: float, rng: np.random.Generator) -> tuple[Plane, ...]:
    """u and v in the thing's own axes, 1 at its rim; distance from its middle and angle there."""
    y, x = np.mgrid[0:side, 0:side].astype(np.float32)
    cx, cy, turn = rng.uniform(0, side), rng.uniform(0, side), rng.uniform(0, 2 * np.pi)
    c, s = np.float32(np.cos(turn) / radius), np.float32(np.sin(turn) / radius)
    u = (x - np.float32(cx)) * c + (y - np.float32(cy)) * s
    v = ((y - np.float32(cy)) * c - (x - np.float32(cx)) * s) / np.float32(slender)
    return u, v, np.hypot(u, v), np.arctan2(v, u)


def _paint(u: Plane, side: int, kind: int, rng: np.random.Generator) -> Picture:
    """Albedo: one colour, or a second one in stripes or patches."""
    body = np.broadcast_to(vivid_colour(rng), (side, side, 3)).astype(np.float32)
    if kind == 0 or rng.random() < 0.4:
        return body
    wave = np.sin(u * np.float32(rng.uniform(3, 12))) if kind == 1 else noise(side, rng, (3, 9))
    share = np.clip(wave - np.float32(rng.uniform(-0.3, 1.0)), 0, 1)[:, :, None]
    other = vivid_colour(rng) if rng.random() < 0.5 else np.full(3, rng.uniform(0.02, 0.8), np.float32)
    return np.asarray(body + share * (other - body), np.float32)


def _lit(body: Picture, u: Plane, v: Plane, rho: Plane, rng: np.random.Generator) -> Picture:
    """Shaded as a ball is, by a light from anywhere in front; now and then burnt out on the side of the light."""
    height = np.sqrt(np.clip(1 - rho * rho, 0, 1))
    light = rng.normal(size=3) * (1, 1, 0.5)
    light[2] = abs(light[2]) + 0.3
    light /= np.linalg.norm(light)
    facing = np.clip(u * light[0] + v * light[1] + height * light[2], 0, 1).astype(np.float32)
    ambient = np.float32(rng.uniform(0.15, 0.7))
    shaded = body * (ambient + (1 - ambient) * facing)[:, :, None]
    if rng.random() < BURNT:
        glare = np.clip((facing - np.float32(rng.uniform(0.75, 0.95))) * 8, 0, 1)[:, :, None]
        shaded = shaded + glare * (np.float32(rng.uniform(0.7, 1.1)) - shaded)
    return np.asarray(cv2.GaussianBlur(shaded, (0, 0), 0.5), np.float32)


# --- photographs ---
# Photographs that anybody may use, as scenes to put water in: their ranges are invented.
#
# They come with scikit-image and matplotlib, so nothing is fetched: astronaut, rocket and grace_hopper are in the
# public domain (NASA, US Navy), coffee, chelsea, brick, gravel and grass are CC0 (the packages' README files say so).

COLOURED = ("astronaut.png", "coffee.png", "chelsea.png", "rocket.jpg", "grace_hopper.jpg")
TEXTURES = ("brick.png", "gravel.png", "grass.png")  # grey: they are given two colours
HELD_OUT = ("chelsea.png", "gravel.png")  # for validation


def photograph_files() -> list[Path]:
    """All of them. Raises ConfigError if scikit-image is not installed."""
    folders = [Path(spec.origin).parent for spec in map(find_spec, ("skimage", "matplotlib")) if spec and spec.origin]
    places = [folder / "data" for folder in folders] + [folder / "mpl-data" / "sample_data" for folder in folders]
    found = [place / name for name in COLOURED + TEXTURES for place in places if (place / name).is_file()]
    if len(found) < len(COLOURED + TEXTURES):
        raise ConfigError(f"the training photographs come with scikit-image: {to_install('train')}")
    return found


def photograph_scene(image: Image, grey: bool, side: int, rng: np.random.Generator) -> tuple[Picture, Plane]:
    """A part of a photograph (coded) -> (side, side, 3) linear light and (side, side) range, median 1."""
    share = min(image.shape[:2]) * rng.uniform(0.4, 1.0)
    size = max(int(share), 2)
    y, x = (int(rng.integers(0, length - size + 1)) for length in image.shape[:2])
    part = cv2.resize(image[y : y + size, x : x + size], (side, side), interpolation=cv2.INTER_AREA)
    part = np.rot90(part, int(rng.integers(0, 4)))[:, :: int(rng.choice((-1, 1)))]
    linear = (part.astype(np.float32) / np.float32(255)) ** np.float32(GAMMA)
    if grey:
        dark, light = colour(rng, 0.1) * np.float32(0.2), colour(rng, 0.1)
        linear = dark + linear * (light - dark)
    elif rng.random() < 0.3:
        linear = linear[:, :, rng.permutation(3)]
    slope = np.float32(rng.uniform(0, 1.5)) * np.linspace(1, -0.5, side, dtype=np.float32)[:, None]
    z = np.exp(slope + np.float32(rng.uniform(0, 0.2)) * noise(side, rng, (10, 12)))
    return np.ascontiguousarray(linear), np.clip(z / np.median(z), 0.1, FAR).astype(np.float32)
