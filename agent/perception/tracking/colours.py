"""Which colours a thing has that its surroundings have not, and how much of a box shows them.

A histogram of colours inside the box that was drawn, and one of all around it, give for each colour the chance that it
belongs to the thing (Bayes, with even odds). Colours are taken relative to the mean of the whole frame, channel by
channel, so that neither the lamp nor the tint of the water counts. Pose does not count either: a fish that turns keeps
its colours.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.perception.tracking.box import Box, Image, cut

BINS = 16  # of each channel
BLUR_BINS = 1.0  # colours one bin apart are nearly one: exposure and distance move them by as much
SURROUNDINGS = 3.0  # boxes: what is compared with
LEVEL = 96.0  # to which a frame's mean is brought in each channel
LARGEST_GAIN = 3.0  # of a channel: water takes red away nearly wholly, and what is left is noise
RARE = 2e-4  # share of pixels below which a colour says nothing
SIDE_PX = 32  # of the pictures whose colours are counted


class Colours(NamedTuple):
    """What tells a thing from the rest of its first picture."""

    chances: NDArray[np.float32]  # (BINS, BINS, BINS), that a pixel of this colour belongs to the thing
    mixture: NDArray[np.float32]  # the same shape: how much of each colour it has, each weighted by that chance; sum 1
    weight: float  # the sum before: which part of it has colours of its own
    contrast: float  # by how much the chance is higher over the thing than over its surroundings, 0 to 1


def learn(image: Image, box: Box) -> Colours:
    """What tells the thing in this box from the rest of the picture."""
    gains = gains_of(image)
    side = round(SIDE_PX * SURROUNDINGS)
    around = balanced(cut(image, box.grown(SURROUNDINGS), (side, side)), gains)
    inside = _ellipse(side, 1.0 / SURROUNDINGS) > 0
    beyond = _ellipse(side, 1.25 / SURROUNDINGS) == 0  # the edge between is either
    its, others = _counts(around[inside]), _counts(around[beyond])
    whole = balanced(np.asarray(cv2.resize(image, (96, 72), interpolation=cv2.INTER_AREA), np.uint8), gains)
    others = np.maximum(others, 0.5 * _counts(whole.reshape(-1, 3)))
    chances = (its / (its + others + RARE)).astype(np.float32)
    weighted = chances * its
    weight = max(float(weighted.sum()), 1e-6)
    contrast = weight - float((chances * _counts(around[beyond])).sum())
    return Colours(chances, np.asarray(weighted / weight, np.float32), weight, contrast)


def gains_of(image: Image) -> NDArray[np.float32]:
    """(3,) by which a frame's channels are multiplied before its colours are compared."""
    means = np.asarray(cv2.mean(image)[:3], np.float32)
    return np.asarray(np.minimum(LEVEL / np.maximum(means, 1.0), LARGEST_GAIN), np.float32)


def balanced(image: Image, gains: NDArray[np.float32]) -> Image:
    return np.asarray(np.minimum(image * gains, 255.0), np.uint8)


def agreement(colours: Colours, image: Image, box: Box, gains: NDArray[np.float32]) -> float:
    """How much of its own colours, in their mixture, an ellipse in the box shows.

    Bhattacharyya's coefficient of the two weighted histograms: 1 for the box that was drawn, 0 where none of its
    colours is.
    """
    here = balanced(cut(image, box, (SIDE_PX, SIDE_PX)), gains)
    weighted = colours.chances * _counts(here[_ellipse(SIDE_PX, 1.0) > 0])
    return min(float(np.sqrt(weighted * colours.mixture / colours.weight).sum()), 1.0)


def chance_of(colours: Colours, image: Image) -> NDArray[np.float32]:
    """For each pixel of a balanced picture the chance that it belongs to the thing."""
    b, g, r = (image[..., channel] // (256 // BINS) for channel in range(3))
    return np.asarray(colours.chances[b, g, r], np.float32)


def _counts(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(BINS, BINS, BINS) share of the pixels (n, 3) in each bin, blurred."""
    bins = (pixels // (256 // BINS)).astype(np.int64)
    index = (bins[:, 0] * BINS + bins[:, 1]) * BINS + bins[:, 2]
    counts = np.bincount(index, minlength=BINS**3).reshape(BINS, BINS, BINS).astype(np.float32)
    counts /= max(len(pixels), 1)
    kernel = np.exp(-0.5 * (np.arange(-2, 3) / BLUR_BINS) ** 2).astype(np.float32)
    kernel /= kernel.sum()
    for axis in range(3):
        lines = np.moveaxis(counts, axis, 0).reshape(BINS, -1)
        blurred = cv2.sepFilter2D(lines, -1, np.ones(1, np.float32), kernel, borderType=cv2.BORDER_REPLICATE)
        counts = np.asarray(np.moveaxis(blurred.reshape(BINS, BINS, BINS), 0, axis), np.float32)
    return counts


def _ellipse(side: int, share_of_side: float) -> NDArray[np.uint8]:
    """(side, side) mask of an ellipse in the middle."""
    mask, middle = np.zeros((side, side), np.uint8), (side // 2, side // 2)
    radius = max(round(0.5 * share_of_side * side), 1)
    return np.asarray(cv2.circle(mask, middle, radius, 255, -1), np.uint8)
