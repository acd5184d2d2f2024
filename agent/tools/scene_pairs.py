"""Pairs of pictures from two folders, and which of them show the same scene."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError
from agent.process.command import Progress
from agent.tools.dataset import Pairs
from agent.tools.degrade import Image
from agent.tools.pairs import paired, read_pair

HASH_SIDE = 16  # 256 bits
SAME_BITS = 75  # of 256: frames of one clip; unrelated pictures differ in about 128
THUMBNAIL, SAME_COLOUR = 8, 7.0  # px a side; rms CIELAB difference below which two views are of one place


def read_pairs(raw: Path, reference: Path, side: int, show: Progress = lambda done, total: None) -> Pairs:
    """All pairs, scaled to side x side. Raises ConfigError: no pairs, a broken picture, sizes that differ."""
    files, _ = paired(raw, reference)
    images: tuple[list[Image], list[Image]] = ([], [])
    for done, pair in enumerate(files, 1):
        for kept, image in zip(images, read_pair(*pair, (side, side)), strict=True):
            kept.append(image)
        show(done, len(files))
    stacks = np.stack(images[0]), np.stack(images[1])
    return Pairs(*stacks, np.array([f"scene-{number}" for number in scenes(stacks[0])]))


def scenes(images: NDArray[np.uint8]) -> list[int]:
    """Number of the scene that each of (n, h, w, 3) pictures shows: those alike in outline or in colours are one.

    Likeness is passed on: a clip's first and last frame share a scene if those between link them. Errs towards too
    few scenes, for what is split over training and validation makes the figures too good.
    """
    hashes = np.array([outline(image) for image in images])
    small = np.array([cv2.resize(image, (THUMBNAIL, THUMBNAIL), interpolation=cv2.INTER_AREA) for image in images])
    lab = np.array([cv2.cvtColor(s.astype(np.float32) / 255, cv2.COLOR_BGR2LAB) for s in small])
    number = list(range(len(images)))
    for i in range(len(images)):
        bits = (hashes[:i] != hashes[i]).sum(1)
        apart = np.sqrt(((lab[:i] - lab[i]) ** 2).mean((1, 2, 3)))
        for j in np.flatnonzero((bits <= SAME_BITS) | (apart <= SAME_COLOUR)):
            old, new = max(number[i], number[j]), min(number[i], number[j])
            number = [new if n == old else n for n in number]
    return number


def outline(image: Image) -> NDArray[np.bool_]:
    """(256,) is each of 16x16 patches brighter than its right-hand neighbour: blind to colour and contrast."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    patches = cv2.resize(grey, (HASH_SIDE + 1, HASH_SIDE), interpolation=cv2.INTER_AREA)
    return np.asarray(patches[:, :-1] > patches[:, 1:]).ravel()


def folds(scene: NDArray[np.str_], count: int, seed: int) -> NDArray[np.intp]:
    """(n,) fold of each pair: scenes stay whole, folds are about equally large.

    Raises ConfigError if there are fewer scenes than folds.
    """
    names, sizes = np.unique(scene, return_counts=True)
    if len(names) < count:
        raise ConfigError(f"{len(names)} scenes cannot make {count} folds; give pairs of more scenes, or fewer folds")
    order = np.random.default_rng(seed).permutation(len(names))
    filled, place = [0] * count, {}
    for i in sorted(order, key=lambda k: -int(sizes[k])):  # the largest first, into the emptiest
        fold = filled.index(min(filled))
        place[names[i]] = fold
        filled[fold] += int(sizes[i])
    return np.array([place[name] for name in scene])
