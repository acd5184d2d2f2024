"""Picture files: which there are in a folder, and what they hold as 8 bits, whatever they were written with."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


def picture_files(folder: Path) -> list[Path]:
    """The pictures of a folder in the order of their names. Raises ConfigError if there are none."""
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; give a folder of pictures")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise ConfigError(f"{folder}: no pictures in this folder; it needs files that end in {' '.join(SUFFIXES)}")
    return paths


def read_picture(path: Path, grey: bool = False, stretch: bool = False) -> NDArray[np.uint8]:
    """A picture as (height, width, 3) blue green red, or as (height, width) luminance if it is to be `grey`.

    A grey file becomes three equal colours, an alpha plane is left out. More than 8 bits are scaled by the largest
    value that the type holds (1 for floating point), so that pictures stay comparable: in a focus stack a gain of its
    own for each photograph would move the peaks of clarity. `stretch` scales by the picture's own largest value, for
    what is looked at by itself: many cameras write 12 bits into a file of 16, which would come out nearly black.

    Raises ConfigError for a file that is not there or cannot be read, and for values that are not finite.
    """
    if not path.is_file():
        raise ConfigError(f"{path}: no such file; give a picture")
    raw = cv2.imread(str(path), (cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR) | cv2.IMREAD_ANYDEPTH)
    if raw is None:
        raise ConfigError(f"{path}: not an image that OpenCV can read; replace it or take it away")
    if raw.dtype == np.uint8:
        return np.asarray(raw, np.uint8)
    if not np.isfinite(raw).all():
        raise ConfigError(f"{path}: holds values that are not finite; convert it to 8 or 16 bits")
    if stretch:
        white = max(float(raw.max()), 1e-9)
    else:
        white = 1.0 if raw.dtype.kind == "f" else float(np.iinfo(raw.dtype.str).max)
    return (np.clip(raw, 0, white).astype(np.float64) * (255.0 / white)).round().astype(np.uint8)
