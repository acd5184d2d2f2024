"""Corners of pictures: what can be found again in others, in both directions."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Floats
from agent.reconstruction.stack import Stack

MOST, APART_PX, LEAST_QUALITY = 150, 8, 0.005  # of a view; between two; of the strongest one's strength
RIM_PX = 6
BLUR_PX = 0.7  # at half as much, noise has corners
GAMMA = 1.0 / 2.2


class Corners(NamedTuple):
    """c corners, in the order of their views."""

    owner: NDArray[np.int64]  # (c,) its view
    pixel: Floats  # (c, 2) u, v
    depth_m: Floats  # (c,) by focus
    sigma_m: Floats  # (c,) of that


def corners(stack: Stack) -> Corners:
    """Corners of all pictures (Shi and Tomasi 1994), where a depth is known."""
    found = [_of_one(stack, n) for n in range(len(stack.cameras))]
    view = np.repeat(np.arange(len(found)), [len(pixels) for pixels in found])
    pixel = np.concatenate([*found, np.zeros((0, 2), np.int64)])
    where = view, pixel[:, 1], pixel[:, 0]
    return Corners(view, pixel.astype(float), stack.depth_m[where].astype(float), stack.sigma_m[where].astype(float))


def tones(stack: Stack, n: int, blur_px: float) -> NDArray[np.float32]:
    """Grey of one picture (height, width) as an eye has it, blurred."""
    grey = np.maximum(stack.pictures[n].mean(axis=-1), 0.0) ** np.float32(GAMMA)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), blur_px), np.float32)


def _of_one(stack: Stack, n: int) -> NDArray[np.int64]:
    width, height = stack.sizes[n]
    inside = np.zeros(stack.depth_m.shape[1:], np.uint8)
    inside[RIM_PX : height - RIM_PX, RIM_PX : width - RIM_PX] = 1
    mask = inside * np.isfinite(stack.depth_m[n]).astype(np.uint8)
    at = cv2.goodFeaturesToTrack(tones(stack, n, BLUR_PX), MOST, LEAST_QUALITY, APART_PX, mask=mask)
    return np.zeros((0, 2), np.int64) if at is None else np.rint(at.reshape(-1, 2)).astype(np.int64)
