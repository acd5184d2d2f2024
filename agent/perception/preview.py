"""What a robot's camera sees, small enough to be sent to whoever looks: for people, never for a measurement.

Previews are dropped, never delayed: those of frames that come too soon, and of parts of frames, are not made at all.
With `[camera] enhance` they show what vision would look at: the enhanced frame, or the raw one where no colours are
young enough.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import count

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.messages import MAX_JPEG, Image
from agent.core.step_io import Sighting
from agent.perception.enhancement.on_demand import OnDemandEnhancer
from hw.camera.camera import Frame

KEPT_BYTES = 32 * 1024 * 1024  # of frames that were shown: 640x480, twice a second, a quarter of a minute
WIDTH_PX = 640  # at most: a panel on a screen, and what a frame of the usual cameras has
QUALITIES = (80, 60, 40, 20)  # of JPEG: with the first a frame of the twin, 640x480, is 26 kB; the last is coarse


class Preview:
    """Makes the previews of one camera, at most `hz` a second; 0: none. Used by vision's thread.

    `whole`: (width, height) of a full frame, pixels. `enhancer`: what enhances the frames; None: nothing does.
    `keep`: the frames that were shown, for a while, for whoever draws a box in one.
    """

    def __init__(
        self,
        robot: str,
        whole: tuple[int, int],
        hz: float,
        enhancer: OnDemandEnhancer | None = None,
        keep: bool = False,
    ) -> None:
        self._robot, self._whole, self._enhancer = robot, whole, enhancer
        self._numbers = count()
        self._keep = keep
        self._shown: deque[tuple[int, NDArray[np.uint8]]] = deque()  # number of the frame, and it
        self.set_rate(hz)

    def set_rate(self, hz: float) -> None:
        """At most so many from now on. From any thread."""
        self._period_ns = 1e9 / hz if hz else math.inf
        self._due_ns = 0.0 if hz else math.inf

    def frame(self, number: int) -> NDArray[np.uint8] | None:
        """A frame that was shown, as the camera gave it; None: it was not, or long ago. From any thread."""
        return next((image for shown, image in tuple(self._shown) if shown == number), None)

    def of(self, frame: Frame, sighting: Sighting, now_ns: int) -> Image | None:
        """The preview of a frame, of which `sighting` says time and lens position; None: not of this one.

        `now_ns`: when it is asked for, Unix time.
        """
        if now_ns < self._due_ns or (frame.roi.width, frame.roi.height) != self._whole:
            return None
        self._due_ns = now_ns + self._period_ns
        shown = frame.image if self._enhancer is None else self._enhancer.view(frame, self._whole)
        if self._keep:
            self._shown.append((frame.seq, frame.image))
            while len(self._shown) * frame.image.nbytes > KEPT_BYTES:
                self._shown.popleft()
        small, jpeg = compressed(shown)
        return Image(
            robot=self._robot,
            seq=next(self._numbers),
            sent_ns=now_ns,
            t_ns=sighting.t_ns,
            frame=frame.seq,
            width_px=small.shape[1],
            height_px=small.shape[0],
            enhanced=shown is not frame.image,
            focus=sighting.focus,
            jpeg=jpeg,
        )


def compressed(image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], bytes]:
    """The image, (height, width, 3) blue green red, at most 640 wide, and its JPEG of at most MAX_JPEG bytes.

    Quality gives way first, then size.
    """
    small = reduced(image, min(1.0, WIDTH_PX / image.shape[1]))
    while True:
        for quality in QUALITIES:
            jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            if jpeg.size <= MAX_JPEG:
                return small, jpeg.tobytes()
        small = reduced(small, 0.5)


def reduced(image: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    """The image `scale` times as large, which is at most 1."""
    if scale == 1.0:
        return image
    height, width = (max(1, round(scale * side)) for side in image.shape[:2])
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
