"""What another camera, or another light, would have made of 8-bit pixels: gamma, white balance and exposure."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from agent.perception.detection.picture import ENCODED, Image

Change = Callable[[Image], Image]  # pixels (..., 3), blue green red


def gamma(power: float) -> Change:
    """Values to a power: brighter below 1, darker above."""
    curve = np.rint(255.0 * (np.arange(256) / 255.0) ** power).astype(np.uint8)
    return lambda image: np.asarray(curve[image], np.uint8)


def gains(blue: float, green: float, red: float) -> Change:
    """Factors of light, for 8-bit values encoded with a power of 1 / ENCODED."""
    factors = np.array([blue, green, red]) ** (1.0 / ENCODED)
    return lambda image: np.rint(np.minimum(image * factors, 255.0)).astype(np.uint8)


LIGHTS: Mapping[str, Change] = {
    "as it is": lambda image: image,
    "gamma 0.7": gamma(0.7),
    "gamma 1.4": gamma(1.4),
    "warmer light": gains(0.85, 1.0, 1.15),
    "colder light": gains(1.15, 1.0, 0.85),
    "less light": gains(0.7, 0.7, 0.7),
    "more light": gains(1.3, 1.3, 1.3),
}
