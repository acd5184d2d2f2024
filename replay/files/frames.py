"""Camera frames and what vision made of them, as they stand in a black box: enough to run vision once more.

The picture is a JPEG, or a PNG where every bit counts. Frames of one camera are in the order in which vision saw them,
and that order matters: where vision looks next depends on the frame before.
"""

from __future__ import annotations

import contextlib
from typing import Annotated, Literal

import cv2
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from agent.kernel.codec import encode
from agent.kernel.config import ConfigError
from agent.kernel.messages import Message
from agent.kernel.picture_head import stated_size
from agent.kernel.step_io import Sighting

# Of a JPEG: 60 kB for a full frame of 640x480 with sensor noise, 1.1 ms; PNG: 520 kB, 16 ms. Colour is kept at full
# resolution, unlike a JPEG's habit: it is by their colour that balls are found. That costs a quarter more bytes, and
# vision sees a centre 0.06 px from where it was, not 0.2 px (median), and 0.3 px at worst, not 2 px.
JPEG = [
    *(cv2.IMWRITE_JPEG_QUALITY, 90),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
]
PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
MAX_PIXELS = 32 * 10**6  # of an image that is decoded: twice the largest sensor of a small camera
MAX_FRAME = 16 * 1024 * 1024  # bytes of a Picture: for `codec.decode`

Format = Literal["jpeg", "png"]


class Picture(Message, frozen=True, kw_only=True):
    """One frame as vision got it, on the channel FRAME. The Sighting on VISION has the same sequence."""

    t_ns: int  # middle of the exposure
    frame: int  # as the camera counts
    roi: tuple[int, int, int, int]  # x, y, width, height in the full frame
    sweep: int = 0  # the plan it belongs to; 0: none
    index: int = -1  # which position of that plan
    focus: int | None = None
    format: Format
    data: Annotated[bytes, Meta(max_length=MAX_FRAME)]


def picture(image: NDArray[np.uint8], roi: tuple[int, int, int, int], sighting: Sighting, lossless: bool) -> bytes:
    """The record for FRAME; `image` is (height, width, 3), blue green red."""
    format_: Format = "png" if lossless else "jpeg"
    _, data = cv2.imencode(".png" if lossless else ".jpg", image, PNG if lossless else JPEG)
    return encode(
        Picture(
            t_ns=sighting.t_ns,
            frame=sighting.frame,
            roi=roi,
            sweep=sighting.sweep,
            index=sighting.index,
            focus=sighting.focus,
            format=format_,
            data=data.tobytes(),
        )
    )


def pixels(of: Picture) -> NDArray[np.uint8]:
    """The image of a record, (height, width, 3), blue green red. Raises ConfigError where it does not decode."""
    size = stated_size(of.data)
    image = None
    if size is not None and 0 < size[0] * size[1] <= MAX_PIXELS:  # before memory is taken for it
        with contextlib.suppress(cv2.error):
            image = cv2.imdecode(np.frombuffer(of.data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ConfigError(f"frame {of.frame}: its {of.format} is broken; run `aucamp replay recover` on the file")
    return image.astype(np.uint8, copy=False)
