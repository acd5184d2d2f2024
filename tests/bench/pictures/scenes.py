"""Focus stacks with a known edge in depth: one textured plane before another, through a lens with a real aperture.

The nearer plane blurs over the farther one and hides part of it: what is seen is B(f a) + (1 - B(a)) B'(b), with the
planes' pictures f and b, the nearer one's cover a, and the blur B of each plane at this lens position. That is exact
where either plane is in focus. Blur is done in the frequency domain, where what is drawn goes on beyond its border as
it begins at the opposite one: a margin is drawn that no picture shows, wider than blur reaches.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

SIZE, FRAMES = 400, 30
MARGIN = 24  # pixels beyond each border
DRAWN = SIZE + 2 * MARGIN
BLUR_PX = 0.8  # diameter of the blur that a step of the sweep adds: a small camera's in water
NOISE = (0.7, 1.5)  # grey levels, in turn
GAPS = (2.5, 5.0, 10.0, 18.0)  # steps between the two depths: about 1, 2, 4 and 8 half widths of a peak

Array = np.ndarray


class Stack(NamedTuple):
    images: list[Array]  # (SIZE, SIZE) grey, sharp at lens positions 0, 1, ...
    truth: Array  # (SIZE, SIZE) lens position


def stacks(farther: str, nearer: str, seed: int) -> Iterator[Stack]:
    """One for each gap, each with another outline, wherever the seed puts it."""
    for number, gap in enumerate(GAPS):
        outline = OUTLINES[(seed + number) % len(OUTLINES)]
        yield render(farther, nearer, outline, gap, 100 * seed + number, NOISE[number % 2])


def render(farther: str, nearer: str, outline: str, gap: float, seed: int, noise: float) -> Stack:
    rng = np.random.default_rng(seed)
    level, contrast = rng.uniform(90, 150, 2), rng.uniform(18, 35, 2)
    back, front = (m + c * texture(kind, rng) for m, c, kind in zip(level, contrast, (farther, nearer), strict=True))
    cover, shown = np.clip(inside(outline, rng) + 0.5, 0, 1), (slice(MARGIN, -MARGIN),) * 2
    middle = rng.uniform(12, 18)
    far, near = middle - gap / 2, middle + gap / 2
    spectra = [np.fft.rfft2(plane) for plane in (front * cover, cover, back)]
    images = []
    for position in range(FRAMES):
        b_near, b_far = (blur(BLUR_PX * abs(position - depth)) for depth in (near, far))
        light, share, behind = (np.fft.irfft2(b * s) for b, s in zip((b_near, b_near, b_far), spectra, strict=True))
        seen = (light + (1 - share) * behind)[shown] + rng.normal(0, noise, (SIZE, SIZE))
        images.append(np.clip(np.rint(seen), 0, 255).astype(np.uint8))
    return Stack(images, np.where(cover[shown] > 0.5, near, far))


def texture(kind: str, rng: np.random.Generator) -> Array:
    """(DRAWN, DRAWN) of mean 0 and standard deviation 1."""
    made = leaves(rng) if kind == "leaves" else noise(rng, POWERS[kind])
    return (made - made.mean()) / max(made.std(), 1e-3)


POWERS = {"fine": 0.6, "pink": 1.0, "coarse": 1.5}  # of 1 / frequency, in amplitude


def noise(rng: np.random.Generator, power: float) -> Array:
    frequency = np.hypot(np.fft.fftfreq(DRAWN)[:, None], np.fft.rfftfreq(DRAWN)[None])
    frequency[0, 0] = np.inf
    return np.fft.irfft2(np.fft.rfft2(rng.normal(size=(DRAWN, DRAWN))) * frequency**-power)


def leaves(rng: np.random.Generator) -> Array:
    """Plain discs of all sizes on one another, as in the statistics of natural pictures: edges, and plain parts."""
    wide = np.zeros((2 * DRAWN, 2 * DRAWN), np.float32)
    for _ in range(5000):
        radius = min(3 / np.sqrt(rng.uniform(0.0006, 1)), 90)
        centre = rng.uniform(0, 2 * DRAWN, 2).round().astype(int)
        cv2.circle(wide, centre.tolist(), round(radius), float(rng.normal()), -1)
    part = cv2.GaussianBlur(wide, (0, 0), 0.6)[DRAWN // 2 : -DRAWN // 2, DRAWN // 2 : -DRAWN // 2]
    return part.astype(float)


OUTLINES = ("straight", "slanted", "round", "bars")


def inside(outline: str, rng: np.random.Generator) -> Array:
    """Pixels (DRAWN, DRAWN) to the nearer plane's outline, positive within it."""
    y, x = np.mgrid[:DRAWN, :DRAWN] - DRAWN / 2.0
    offset = rng.uniform(-25, 25)
    match outline:
        case "straight":
            return x - offset
        case "slanted":
            angle = rng.uniform(0.3, 1.2)
            return x * np.cos(angle) + y * np.sin(angle) - offset
        case "round":
            return 0.3 * SIZE + offset - np.hypot(x, y)
        case _:  # slanted bars, as wide as what is between them
            period = rng.uniform(60, 110)
            return period / 4 - np.abs((0.9 * x + 0.43 * y + offset) % period - period / 2)


def blur(diameter_px: float) -> Array:
    """Transfer function (DRAWN, DRAWN / 2 + 1) of a disc."""
    if diameter_px < 0.6:
        return np.ones((DRAWN, DRAWN // 2 + 1))
    fine, reach = 8, int(np.ceil(diameter_px / 2)) + 1  # samples a pixel, pixels
    side = 2 * reach + 1
    at = (np.arange(side * fine) + 0.5) / fine - side / 2
    disc = (at[:, None] ** 2 + at**2 <= diameter_px**2 / 4).reshape(side, fine, side, fine).mean(axis=(1, 3))
    kernel = np.zeros((DRAWN, DRAWN))
    kernel[:side, :side] = disc / disc.sum()
    return np.fft.rfft2(np.roll(kernel, (-reach, -reach), (0, 1))).real
