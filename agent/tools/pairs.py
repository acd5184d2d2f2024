"""Pairs of pictures from two folders: one that is to be enhanced, and a reference of how it should look.

The layouts in use: LSUI has input/ and GT/, UIEB raw-890/ and reference-890/, EUVP Paired/<subset>/trainA/ and trainB/.
Suffixes may differ between the two folders.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from agent.core.config import ConfigError
from hw.camera.camera import Image
from hw.picture_files import picture_files, read_picture

NAMED = 5  # pictures without a partner; more are counted

Size = tuple[int, int]  # width, height


def paired(raw: Path, reference: Path) -> tuple[list[tuple[Path, Path]], list[str]]:
    """Files of the two folders with the same name, and a line for each folder with names that the other lacks.

    Raises ConfigError if there are no pairs.
    """
    ours, theirs = ({path.stem: path for path in picture_files(folder)} for folder in (raw, reference))
    pairs = [(path, theirs[stem]) for stem, path in ours.items() if stem in theirs]
    if not pairs:
        raise ConfigError(f"{raw} and {reference}: no two pictures of the same name; give folders that belong together")
    alone = []
    for folder, here, there in ((raw, ours, theirs), (reference, theirs, ours)):
        names = [path.name for stem, path in here.items() if stem not in there]
        if names:
            more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
            alone.append(f"{folder}: without a partner in the other folder: {', '.join(names[:NAMED])}{more}")
    return pairs, alone


def read_pair(raw: Path, reference: Path, size: Size | None) -> tuple[Image, Image]:
    """Both pictures of a pair, scaled to `size`; None: as they are. Raises ConfigError, also where their sizes differ.

    They are stretched as `aucamp enhance` stretches what it is given, so that training sees and figures judge what
    users get.
    """
    image, target = read_picture(raw, stretch=True), read_picture(reference, stretch=True)
    if image.shape != target.shape:
        ours, theirs = (f"{one.shape[1]}x{one.shape[0]}" for one in (image, target))
        raise ConfigError(f"{raw}: {ours}, but its reference {theirs} pixels; a pair must show the same pixels")
    if size is None:
        return image, target
    small = [np.asarray(cv2.resize(one, size, interpolation=cv2.INTER_AREA), np.uint8) for one in (image, target)]
    return small[0], small[1]
