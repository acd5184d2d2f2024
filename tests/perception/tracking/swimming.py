"""A clip with known truth: something that swims, bends and turns before a still, cluttered background."""

from __future__ import annotations

import cv2
import numpy as np

WIDTH, HEIGHT = 480, 360
LONG, SHORT = 90, 50  # of the body, pixels


def clip(frames: int, gone: range = range(0), seed: int = 0):
    """Yields (image, box x y width height or None while it is away); behind `gone` it comes back on another course."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(60, 170, (HEIGHT // 12, WIDTH // 12, 3)).astype(np.uint8)
    background = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    skin = cv2.resize(rng.integers(0, 255, (8, 12, 3)).astype(np.uint8), (LONG, SHORT), interpolation=cv2.INTER_CUBIC)
    for k in range(frames):
        image, box = background.copy(), None
        if k not in gone:
            back = gone and k >= gone.stop
            x, y = (330 - 2.0 * (k - gone.stop), 60 + k % 7) if back else (40 + 2.2 * k, 160 + 50 * np.sin(k / 18))
            box = draw(image, skin, x, y, 12 * np.sin(k / 9), 1.0 + 0.15 * np.sin(k / 25))
        noisy = image + rng.normal(0, 4, image.shape)
        yield np.clip(noisy, 0, 255).astype(np.uint8), box


def draw(image, skin, x, y, angle_deg, scale):
    """The body with its centre at (x, y) + half its size; returns the upright box around it."""
    centre = (x + LONG / 2, y + SHORT / 2)
    turn = cv2.getRotationMatrix2D((LONG / 2, SHORT / 2), angle_deg, scale)
    turn[:, 2] += (x, y)
    size = (image.shape[1], image.shape[0])
    body = cv2.warpAffine(skin, turn, size)
    mask = np.zeros(image.shape[:2], np.uint8)
    axes = (scale * LONG / 2 - 1, scale * SHORT / 2 - 1)
    cv2.ellipse(mask, tuple(map(round, centre)), tuple(map(round, axes)), -angle_deg, 0, 360, 255, -1)
    image[mask > 0] = body[mask > 0]
    rows, columns = np.nonzero(mask)
    left, top = int(columns.min()), int(rows.min())
    return left, top, int(columns.max()) + 1 - left, int(rows.max()) + 1 - top


def overlap(a, b) -> float:
    """Intersection over union of two boxes x, y, width, height."""
    width = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    height = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    both = max(width, 0) * max(height, 0)
    return both / (a[2] * a[3] + b[2] * b[3] - both)
