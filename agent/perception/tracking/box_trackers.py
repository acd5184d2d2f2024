"""What follows a box from frame to frame: NanoTrack where its two ONNX files are given, else OpenCV's MIL.

NanoTrack is a small siamese network that OpenCV runs (cv2.TrackerNano). Version 2 of it, as published in
HonglinChu/SiamTrackers (NanoTrack/models/nanotrackv2, Apache-2.0); version 3 has another head, on which OpenCV 5.0
fails in its first update. MIL needs no file; it is slower, keeps the size of its box, and has no score of its own.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from agent.kernel.config import ConfigError
from agent.perception.tracking.appearance import Box, Image

MIL_SIDE_PX = 64  # longer side of its box: half the time of a full picture, and no worse
MIL_REACH_PX = 12  # how far it looks around where the box was: a fifth of the box from frame to frame
LOOK_PX = 24  # how far from its answer the thing itself is looked for: a gimbal that turns moves it by a quarter
PLAIN_LIKE = 0.75  # correlation of the thing itself, beyond doubt
CREPT_PX = 3  # MIL trembles by as much; what is farther from the thing begins anew there

# SHA-256 of the published files; thresholds of follow.py were measured with them.
BACKBONE = ("nanotrack_backbone_sim.onnx", "530bdd0cd00f19afab79a863e71ba71e3312395a5dc9151af675082bdaaa2fc4")
NECK = ("nanotrack_head_sim.onnx", "0d8c0637be849f092cc7236cae02e55c8b9455ebe37ba50601d6115db4247cd9")


class BoxTracker(Protocol):
    """Follows whatever it was started on, and never says that it is gone."""

    def start(self, image: Image, box: Box) -> None: ...

    def follow(self, image: Image) -> tuple[Box, float]:
        """Where it is now, and how sure that is, 0 to 1. Call start() first."""


class Nano:
    """See load_nano."""

    def __init__(self, tracker: cv2.TrackerNano) -> None:
        self._tracker = tracker

    def start(self, image: Image, box: Box) -> None:
        self._tracker.init(image, whole_pixels(image, box))

    def follow(self, image: Image) -> tuple[Box, float]:
        _, box = self._tracker.update(image)  # its flag is always true
        return Box(*(float(side) for side in box)), float(self._tracker.getTrackingScore())


class Mil:
    """cv2.TrackerMIL, on a picture in which the box is small; every start is a new one.

    MIL learns what its box shows, so a box that once lags behind a thing, when the gimbal turns, stays behind for good,
    by up to a quarter of its side. So where the thing can plainly be seen as it was at the start, there the box is put.
    """

    def __init__(self) -> None:
        self._tracker: cv2.TrackerMIL | None = None
        self._box, self._shrink = Box(0, 0, 0, 0), 1.0
        self._margin = 0  # pixels by which the small picture is widened on every side
        self._first: Image | None = None  # what the box showed at the start

    def start(self, image: Image, box: Box) -> None:
        least = 2 / min(image.shape[:2])  # of a picture that is one long strip two lines are left
        self._box, self._shrink = box, min(1.0, max(MIL_SIDE_PX / max(box.width, box.height), least))
        self._margin = 0
        small = self._small(image)
        room = small.shape[1] - self._size()[0], small.shape[0] - self._size()[1]
        if min(room) < 2 * MIL_REACH_PX:  # it learns from what lies around the box, and asserts that there is some
            self._margin = MIL_REACH_PX
            small = self._small(image)
        self._first = _part(small, *self._corner(box), *self._size())
        self._begin(small, box)

    def follow(self, image: Image) -> tuple[Box, float]:
        assert self._tracker is not None  # start() comes first
        small = self._small(image)
        _, (x, y, _, _) = self._tracker.update(small)
        box = self._box._replace(x=(x - self._margin) / self._shrink, y=(y - self._margin) / self._shrink)
        if (plain := self._plainly(small, box)) is None:
            return box, 1.0
        if max(abs(plain.x - box.x), abs(plain.y - box.y)) * self._shrink > CREPT_PX:
            self._begin(small, plain)
        return plain, 1.0

    def _begin(self, small: Image, box: Box) -> None:
        parameters = cv2.TrackerMIL.Params()
        parameters.samplerSearchWinSize = MIL_REACH_PX
        self._tracker = cv2.TrackerMIL.create(parameters)
        x, y, width, height = (side * self._shrink for side in box)
        self._tracker.init(small, whole_pixels(small, Box(x + self._margin, y + self._margin, width, height)))

    def _plainly(self, small: Image, near: Box) -> Box | None:
        """Where the thing looks as it did at the start; None if nowhere near this box, or not much like it."""
        assert self._first is not None  # start() comes first
        if not np.ptp(self._first):
            return None  # OpenCV calls everything like a plain area
        x, y = self._corner(near)
        width, height = self._size()
        around = _part(small, x - LOOK_PX, y - LOOK_PX, width + 2 * LOOK_PX, height + 2 * LOOK_PX)
        _, alike, _, (right, down) = cv2.minMaxLoc(cv2.matchTemplate(around, self._first, cv2.TM_CCOEFF_NORMED))
        if alike < PLAIN_LIKE:
            return None
        start_x, start_y = self._corner(self._box)  # the box's corner lies a part of a pixel from this one
        right, down = x + right - LOOK_PX - start_x, y + down - LOOK_PX - start_y
        return self._box._replace(x=self._box.x + right / self._shrink, y=self._box.y + down / self._shrink)

    def _corner(self, box: Box) -> tuple[int, int]:
        return round(box.x * self._shrink) + self._margin, round(box.y * self._shrink) + self._margin

    def _size(self) -> tuple[int, int]:
        return max(2, round(self._box.width * self._shrink)), max(2, round(self._box.height * self._shrink))

    def _small(self, image: Image) -> Image:
        if self._shrink < 1.0:
            resized = cv2.resize(image, None, fx=self._shrink, fy=self._shrink, interpolation=cv2.INTER_AREA)
            image = np.asarray(resized, np.uint8)
        return np.pad(image, [(self._margin,) * 2] * 2 + [(0, 0)], "edge") if self._margin else image


def _part(image: Image, x: int, y: int, width: int, height: int) -> Image:
    """A part of a picture, which may lie beyond it in part: there its border goes on."""
    rows = np.clip(np.arange(y, y + height), 0, image.shape[0] - 1)
    columns = np.clip(np.arange(x, x + width), 0, image.shape[1] - 1)
    return image[rows[:, None], columns[None, :]]


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
    """NanoTrack from two files, MIL from none. Raises ConfigError for one of two, and as load_nano does."""
    if backbone is None and neckhead is None:
        return Mil()
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
