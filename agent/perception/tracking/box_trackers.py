"""What follows a box from frame to frame: NanoTrack where its two ONNX files are given, else a correlation filter.

NanoTrack is a small siamese network that OpenCV runs (cv2.TrackerNano). Version 2 of it, as published in
HonglinChu/SiamTrackers (NanoTrack/models/nanotrackv2, Apache-2.0); version 3 has another head, on which OpenCV 5.0
fails in its first update. The filter of correlation.py needs no file.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Protocol

import cv2

from agent.core.config import ConfigError
from agent.perception.tracking.box import Box, Image
from agent.perception.tracking.correlation import CorrelationTracker

# SHA-256 of the published files; thresholds of follow.py were measured with them.
BACKBONE = ("nanotrack_backbone_sim.onnx", "530bdd0cd00f19afab79a863e71ba71e3312395a5dc9151af675082bdaaa2fc4")
NECK = ("nanotrack_head_sim.onnx", "0d8c0637be849f092cc7236cae02e55c8b9455ebe37ba50601d6115db4247cd9")


class BoxTracker(Protocol):
    """Follows whatever it was started on, and never says that it is gone."""

    def start(self, image: Image, box: Box) -> None: ...

    def follow(self, image: Image) -> Box:
        """Where it is now, or whatever is taken for it. Call start() first."""

    def learn(self, image: Image, box: Box) -> None:
        """This is the thing, beyond doubt."""


class Nano:
    """See load_nano."""

    def __init__(self, tracker: cv2.TrackerNano) -> None:
        self._tracker = tracker

    def start(self, image: Image, box: Box) -> None:
        self._tracker.init(image, whole_pixels(image, box))

    def follow(self, image: Image) -> Box:
        _, box = self._tracker.update(image)  # its flag is always true, and its score is high without a target too
        return Box(*(float(side) for side in box))

    def learn(self, image: Image, box: Box) -> None:
        """It keeps to the picture with which it was started."""


def whole_pixels(image: Image, box: Box) -> tuple[int, int, int, int]:
    """What of a box lies in the picture, at least two pixels each way."""
    height, width = image.shape[:2]
    left, top = min(max(round(box.x), 0), width - 2), min(max(round(box.y), 0), height - 2)
    right, bottom = min(round(box.x + box.width), width), min(round(box.y + box.height), height)
    return left, top, max(right - left, 2), max(bottom - top, 2)


def model_files(folder: Path) -> tuple[Path, Path]:
    """Backbone and neck by the names under which they are published."""
    return folder / BACKBONE[0], folder / NECK[0]


def load_box_tracker(backbone: Path | None, neckhead: Path | None) -> BoxTracker:
    """NanoTrack from two files, a correlation filter from none.

    Raises ConfigError for one of two, and as load_nano does.
    """
    if backbone is None and neckhead is None:
        return CorrelationTracker()
    if backbone is None or neckhead is None:
        raise ConfigError("NanoTrack consists of two files; give both --backbone and --neck, or neither")
    return load_nano(backbone, neckhead)


def load_nano(backbone: Path, neckhead: Path) -> Nano:
    """Raises ConfigError for files that are not the published ones of NanoTrack V2."""
    for path, (name, digest) in ((backbone, BACKBONE), (neckhead, NECK)):
        if not path.is_file():
            raise ConfigError(f"{path}: no such file; give the two ONNX files of NanoTrack V2 as backbone and neck")
        if hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            raise ConfigError(f"{path}: is not {name} of NanoTrack V2 (its SHA-256 differs); take it from its authors")
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # it warns of targets that nobody asked for
    try:
        parameters = cv2.TrackerNano.Params()
        parameters.backbone, parameters.neckhead = str(backbone), str(neckhead)
        return Nano(cv2.TrackerNano.create(parameters))
    finally:
        cv2.utils.logging.setLogLevel(level)
