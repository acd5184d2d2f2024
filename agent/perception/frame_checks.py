"""Whether what a camera delivers is a frame at all, and whether its pictures move."""

from __future__ import annotations

import zlib
from collections import OrderedDict
from pathlib import Path
from traceback import extract_tb

import numpy as np

from hw.camera.camera import CameraError, Frame, Roi

FROZEN_NS = 2_000_000_000  # for so long the same picture: eight looks at the idle rate
FROZEN_FRAMES = 4  # and in so many frames: a machine that stood still saw few
EVERY_ROW = 16  # of the rows compared; the noise of a sensor is in each of them
MAX_FAULT = 200  # characters
KEPT = 8  # parts of the frame whose last picture is remembered; a sweep looks at one, the search at another


def check(frame: Frame, size: tuple[int, int]) -> None:
    """Raise CameraError, one line, for what is no picture of `roi`, or of no part of a full frame of `size`."""
    image, roi = frame.image, frame.roi
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        kind = f"{image.dtype} of shape {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise CameraError(f"the camera sent {kind}, not three bytes a pixel; choose another format or camera")
    height, width = image.shape[:2]
    if not height or not width or (width, height) != (roi.width, roi.height):
        raise CameraError(f"the camera sent {width}x{height} pixels for {roi.width}x{roi.height}; plug it in again")
    if roi.x < 0 or roi.y < 0 or roi.x + width > size[0] or roi.y + height > size[1]:
        raise CameraError(f"the camera sent region {tuple(roi)}, outside its {size[0]}x{size[1]}; plug it in again")


class FrozenWatch:
    """Looks whether pictures of a live camera change: two frames of a sensor never have the same noise.

    It compares a frame with the last one of the same part, and knows nothing from the first of each.
    """

    def __init__(self) -> None:
        self._prints: OrderedDict[Roi, int] = OrderedDict()
        self._newest = (-1, -1)  # time and number of the frame before
        self._moved_ns: int | None = None  # when a frame last was another than the one before
        self._repeats = 0  # frames since then that were not

    def see(self, frame: Frame, now_ns: int) -> str | None:
        """Take a frame that came at now_ns; why the pictures are taken for frozen, or None."""
        if frame.still:
            return None
        seen_print = zlib.crc32(frame.image[::EVERY_ROW].tobytes())
        before = self._prints.pop(frame.roi, None)
        self._prints[frame.roi] = seen_print
        if len(self._prints) > KEPT:
            self._prints.popitem(last=False)
        again = (frame.t_ns, frame.seq) == self._newest
        self._newest = frame.t_ns, frame.seq
        if self._moved_ns is None:
            self._moved_ns = now_ns
        elif again or seen_print == before:
            self._repeats += 1
        elif before is not None:
            self._moved_ns, self._repeats = now_ns, 0
        if self._repeats < FROZEN_FRAMES or now_ns - self._moved_ns < FROZEN_NS:
            return None
        what = "the same frame again and again" if again else "the same picture in every frame"
        return f"{what}; plug the camera in again, or give it light"


def broke_off(error: BaseException) -> str:
    """What went wrong and where, in one line."""
    where = [f"{Path(step.filename).name}:{step.lineno}" for step in extract_tb(error.__traceback__)]
    return f"{type(error).__name__} in {where[-1] if where else 'vision'}: {' '.join(str(error).split())}"[:MAX_FAULT]
