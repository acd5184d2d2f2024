"""Pairs of pictures from two folders that use the same file names, and which of them show the same scene.

The layouts in use: LSUI has input/ and GT/, UIEB raw-890/ and reference-890/, EUVP Paired/<subset>/trainA/ and trainB/.
Suffixes may differ between the two folders.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.config import ConfigError
from agent.enhancement.dataset import Pairs
from agent.enhancement.degrade import Image

SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")
HASH_SIDE = 16  # 256 bits
SAME_BITS = 75  # of 256: frames of one clip; unrelated pictures differ in about 128
THUMBNAIL, SAME_COLOUR = 8, 7.0  # px a side; rms CIELAB difference below which two views are of one place


def read_pairs(
    raw: Path, reference: Path, side: int, show: Callable[[int, int], None] = lambda done, total: None
) -> Pairs:
    """All pairs, scaled to side x side. Raises ConfigError: no pairs, a broken picture, sizes that differ."""
    both = paired(raw, reference)
    images: tuple[list[Image], list[Image]] = ([], [])
    for done, files in enumerate(both, 1):
        whole = [_read(file) for file in files]
        if whole[0].shape != whole[1].shape:
            sizes = " and ".join(f"{image.shape[1]}x{image.shape[0]}" for image in whole)
            raise ConfigError(f"{files[0]}, {files[1]}: sizes {sizes} differ; a pair must show the same pixels")
        for kept, image in zip(images, whole, strict=True):
            kept.append(np.asarray(cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA), np.uint8))
        show(done, len(both))
    stacks = np.stack(images[0]), np.stack(images[1])
    return Pairs(*stacks, np.array([f"scene-{number}" for number in scenes(stacks[0])]))


def paired(raw: Path, reference: Path) -> list[tuple[Path, Path]]:
    """The files of the same name in both folders, suffixes aside. Raises ConfigError if there are none."""
    for folder in (raw, reference):
        if not folder.is_dir():
            raise ConfigError(f"{folder}: no such folder; give the folder of raw pictures, then that of references")
    theirs = {file.stem: file for file in _pictures(reference)}
    both = [(file, theirs[file.stem]) for file in _pictures(raw) if file.stem in theirs]
    if not both:
        raise ConfigError(f"{raw}, {reference}: no pairs; the same picture must have the same file name in both")
    return both


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
        raise ConfigError(f"{len(names)} scenes cannot make {count} folds; give more pairs or fewer folds")
    order = np.random.default_rng(seed).permutation(len(names))
    filled, place = [0] * count, {}
    for i in sorted(order, key=lambda k: -int(sizes[k])):  # the largest first, into the emptiest
        fold = filled.index(min(filled))
        place[names[i]] = fold
        filled[fold] += int(sizes[i])
    return np.array([place[name] for name in scene])


def _pictures(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES)


def _read(file: Path) -> Image:
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if image is None:
        raise ConfigError(f"{file}: not a picture that OpenCV reads; mend it or take it out of the folder")
    return np.asarray(image, np.uint8)
