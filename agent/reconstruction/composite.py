"""One picture that is sharp everywhere, in linear light, on the scale of the largest frame of a sweep.

A picture grows about the optical axis as its lens moves. Every frame that is sharpest anywhere is brought to the
largest one's scale and made smaller, and each part of the picture is taken from its sharpest frame, with seams blended
over a part.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.focus import Array
from hw.camera.camera import Image

Picture = NDArray[np.float32]


def linear(image: Image, gamma: float) -> Picture:
    """Bytes (height, width, 3) blue green red -> light, red green blue, 1 at the sensor's limit."""
    curve = ((np.arange(256) / 255.0) ** gamma).astype(np.float32)
    return curve[image[..., ::-1]]


def composite(
    images: Sequence[Image],
    size: Array,
    centre_px: tuple[float, float],
    clarity: Array,
    side_px: float,
    times: int,
    gamma: float,
) -> Picture:
    """(height / times, width / times, 3) of pictures `size` (n,) times as large as the largest (1 is the largest).

    clarity (n, rows, cols) of squares of side_px in the largest picture; centre_px: where the axis meets the picture.
    """
    height, width = images[0].shape[:2]
    small = (width // times, height // times)
    around = np.array([cv2.blur(one, (3, 3), borderType=cv2.BORDER_REPLICATE) for one in clarity])
    best = around.argmax(axis=0)
    total = np.zeros((small[1], small[0], 3), np.float32)
    weights = np.zeros((small[1], small[0]), np.float32)
    for n in np.unique(best):
        weight = _shares((best == n).astype(np.float32), side_px, times, small)
        frame = shrunk_frame(images[n], float(size[n]), centre_px, times, gamma)
        total += weight[..., None] * frame
        weights += weight
    return np.asarray(total / np.maximum(weights, 1e-6)[..., None], np.float32)


def shrunk_frame(image: Image, scale: float, centre_px: tuple[float, float], times: int, gamma: float) -> Picture:
    """A frame in linear light, magnified by 1 / scale about the centre, then made `times` smaller by means."""
    light = linear(image, gamma)
    if scale != 1.0:
        x, y = ((1.0 - scale) * c for c in centre_px)
        there = np.array([[scale, 0.0, x], [0.0, scale, y]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = light.shape[1], light.shape[0]
        warped = cv2.warpAffine(light, there, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        light = np.asarray(warped, np.float32)
    height, width = (length // times for length in light.shape[:2])
    tiles = light[: height * times, : width * times].reshape(height, times, width, times, 3)
    return np.asarray(tiles.mean(axis=(1, 3)), np.float32)


def _shares(squares: Picture, side_px: float, times: int, small: tuple[int, int]) -> Picture:
    """Squares (rows, cols) -> a weight of each small pixel (height, width), bilinear between the squares' centres."""
    scale = times / side_px
    shift = ((times - 1) / 2.0 - (side_px - 1) / 2.0) / side_px
    there = np.array([[scale, 0.0, shift], [0.0, scale, shift]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(squares, there, small, flags=flags, borderMode=cv2.BORDER_REPLICATE), np.float32)
