"""The network's colours at a small fraction of its cost: estimate them small, carry them to the full picture.

The network sees the picture shrunk to SMALL_PX pixels. What it does to each colour there is written as an affine
function of the three colours, one for each pixel, by a guided filter (He, Sun and Tang 2013, with colour as the guide)
at the small size (He and Sun 2015). Edges stay where they are in the frame itself: only coefficients, which are smooth,
are enlarged.

What a window says nothing of, such as a red that only one pixel of it has, the network's white balance of the whole
picture says: the filter is fitted to what the network does beyond a gain per colour. So a small vivid thing is not
painted in the colours of its surroundings.

What is brightest is the light itself, or nearest to it: glitter, white sand. Where it was bluish or greenish and would
come out red, the picture is mostly open water, whose colour the balance takes for a tint: red is given less for all.

The coefficients outlive their frame: while camera and scene stand still, as in a focus sweep, the same ones serve
every frame and every part of one, for a few milliseconds each.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.perception.enhancement.grey_world import Image
from hw.compiled import compiled

Floats = NDArray[np.float32]

SMALL_PX = 160 * 120  # that the network sees: near what it was trained on (PSNR falls above), and cheap
RADIUS = 32  # of the windows, small pixels; smaller ones smear the outline of a vivid thing over its surroundings. At
# 16 it is 0.3 dB farther from real references; pairs of our own making, whose veil grows with range, tell no difference
EPSILON = 1e-3  # variance of a colour (full scale 1) below which a window says little of it, and the balance stands
MAX_BALANCE = 4.0  # gain: a colour that is weaker in the whole picture is noise
BRIGHTEST = 0.02  # share of the pixels that tell the light; from 0.01 to 0.1 it makes no difference to real pairs
MANY = 0.5  # share of the brightest that have red as their weakest colour; 0.25 to 0.75 makes no difference to them


class Colours(NamedTuple):
    """What to do with every colour, for a frame of `size`."""

    affine: Floats  # (h, w, 3, 4): output blue green red from input blue green red and one, full scale 1
    size: tuple[int, int]  # width, height of the full frame, pixels


def estimate_colours(image: Image, network: Callable[[Image], Floats], small_px: int = SMALL_PX) -> Colours:
    """`network` maps a picture (h, w, 3) uint8 to one of float32, full scale 1, both blue green red."""
    height, width = image.shape[:2]
    shrink = max(1.0, math.sqrt(height * width / small_px))
    size = max(1, round(width / shrink)), max(1, round(height / shrink))
    small = image if size == (width, height) else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    guide = np.asarray(small, np.float32) / np.float32(255)
    wanted = network(np.ascontiguousarray(small, np.uint8))
    gain = balance(guide, wanted)
    affine = guided_filter(guide, np.asarray(wanted - gain * guide, np.float32))
    for c in range(3):
        affine[:, :, c, c] += gain[c]
    affine[:, :, 2] *= red_share(guide, affine)
    return Colours(affine, (width, height))


def balance(guide: Floats, wanted: Floats) -> Floats:
    """(3,) gain per colour that takes the mean of one picture to that of the other."""
    means = wanted.mean((0, 1)) / np.maximum(guide.mean((0, 1)), 1e-3)
    return np.asarray(np.clip(means, 0, MAX_BALANCE), np.float32)


def red_share(guide: Floats, affine: Floats) -> np.float32:
    """Share of the red at which the brightest pixels, if red is their weakest colour before, are not red after."""
    blue, green, red = cv2.split(guide)
    bright = cv2.max(cv2.max(blue, green), red).ravel()
    top = np.argpartition(bright, -(count := math.ceil(BRIGHTEST * bright.size)))[-count:]
    cold = top[(red < cv2.min(blue, green)).ravel()[top]]
    if len(cold) < MANY * len(top):
        return np.float32(1)
    light = np.insert(guide.reshape(-1, 3)[cold], 3, 1, axis=1)
    after = np.einsum("nij,nj->ni", affine.reshape(-1, 3, 4)[cold], light).mean(axis=0)
    return np.float32(min(1.0, after[:2].max() / max(after[2], 1e-3)))


def apply_colours(colours: Colours, image: Image, origin: tuple[int, int] = (0, 0)) -> Image:
    """A frame, or the part of one whose upper left pixel is `origin` (x, y), with its colours restored."""
    out = np.empty_like(image)
    _apply(colours.affine, colours.size[0], colours.size[1], np.ascontiguousarray(image), origin[0], origin[1], out)
    return out


def guided_filter(guide: Floats, wanted: Floats, radius: int = RADIUS, epsilon: float = EPSILON) -> Floats:
    """(h, w, 3) and (h, w, 3) -> (h, w, 3, 4): in each window the affine map with the least squared error, averaged
    over the windows that hold a pixel."""
    window = (2 * radius + 1, 2 * radius + 1)

    def mean(x: Floats) -> Floats:
        return np.asarray(cv2.blur(x, window, borderType=cv2.BORDER_REFLECT_101), np.float32).reshape(x.shape)

    i, j = np.triu_indices(3)
    around, target = mean(guide), mean(wanted)
    upper = mean(guide[..., i[:3]] * guide[..., j[:3]]), mean(guide[..., i[3:]] * guide[..., j[3:]])
    covariance = np.concatenate(upper, axis=2) - around[..., i] * around[..., j]
    cross = np.stack([mean(guide * wanted[..., c : c + 1]) - around * target[..., c : c + 1] for c in range(3)], axis=2)
    affine = np.empty((*guide.shape, 4), np.float32)
    _solve(covariance, cross, around, target, epsilon, affine)
    return np.stack([mean(np.ascontiguousarray(affine[:, :, c])) for c in range(3)], axis=2)


@compiled()
def _solve(covariance: Floats, cross: Floats, around: Floats, target: Floats, epsilon: float, affine: Floats) -> None:
    """slope = (covariance + epsilon)^-1 cross by cofactors, offset = target - slope around; in float64."""
    for y in range(affine.shape[0]):
        for x in range(affine.shape[1]):
            v = covariance[y, x]
            a, b, c = v[0] + epsilon, np.float64(v[1]), np.float64(v[2])
            d, e, f = v[3] + epsilon, np.float64(v[4]), v[5] + epsilon
            aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
            dd, de, ff = a * f - c * c, b * c - a * e, a * d - b * b
            scale = 1.0 / (a * aa + b * ab + c * ac)
            for o in range(3):
                p, q, r = cross[y, x, o]
                first = scale * (aa * p + ab * q + ac * r)
                second = scale * (ab * p + dd * q + de * r)
                third = scale * (ac * p + de * q + ff * r)
                affine[y, x, o, 0], affine[y, x, o, 1], affine[y, x, o, 2] = first, second, third
                mean = around[y, x]
                affine[y, x, o, 3] = target[y, x, o] - (first * mean[0] + second * mean[1] + third * mean[2])


@compiled(fastmath=True)
def _apply(affine: Floats, width: int, height: int, image: Image, x0: int, y0: int, out: Image) -> None:
    """Coefficients between the centres of small pixels are linear in x and y; beyond the outermost they stay."""
    rows, cols = affine.shape[:2]
    left = np.empty(image.shape[1], np.int64)
    share = np.empty(image.shape[1], np.float32)
    for u in range(image.shape[1]):
        x = min(max((x0 + u + 0.5) * cols / width - 0.5, 0.0), cols - 1.0)
        left[u] = min(int(x), max(cols - 2, 0))
        share[u] = x - left[u]
    row = np.empty((cols + 1, 12), np.float32)
    for v in range(image.shape[0]):
        y = min(max((y0 + v + 0.5) * rows / height - 0.5, 0.0), rows - 1.0)
        top = min(int(y), max(rows - 2, 0))
        below, s = min(top + 1, rows - 1), np.float32(y - top)
        for k in range(cols):
            for c in range(3):
                for d in range(4):
                    a = affine[top, k, c, d]
                    row[k, 4 * c + d] = a + s * (affine[below, k, c, d] - a)
        row[cols] = row[cols - 1]
        for u in range(image.shape[1]):
            near, far, t = row[left[u]], row[left[u] + 1], share[u]
            b, g, r = np.float32(image[v, u, 0]), np.float32(image[v, u, 1]), np.float32(image[v, u, 2])
            for c in range(3):
                k = 4 * c
                first = near[k] * b + near[k + 1] * g + near[k + 2] * r + near[k + 3] * np.float32(255)
                second = far[k] * b + far[k + 1] * g + far[k + 2] * r + far[k + 3] * np.float32(255)
                value = first + t * (second - first)
                out[v, u, c] = np.uint8(min(max(value, np.float32(0)), np.float32(255)) + np.float32(0.5))
