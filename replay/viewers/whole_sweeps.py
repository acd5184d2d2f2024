"""The whole sweeps in a recording, and what a depth map of one says. The function that measures it is handed in:
replay does not know perception.

A robot reads only the part of the picture around its target while it sweeps, so that is the part with a map. A
tracking sweep visits a few positions only, which is too little for blocks that lie at any distance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.codec import decode
from agent.core.ranging.camera_model import Calibration, CameraFit
from agent.core.step_io import Sighting
from replay.files.channels import VISION
from replay.files.frames import Frames, Picture, pixels
from replay.files.log import Record


class SweepFrame(NamedTuple):
    """One frame of a sweep."""

    image: NDArray[np.uint8]  # (height, width, 3), blue green red
    roi: tuple[int, int, int, int]  # x, y, width, height in the full frame
    sighting: Sighting


class SweepDepth(NamedTuple):
    """A depth map of the part of the picture that a sweep read; blocks are squares, row 0 on top."""

    t_ns: int  # of the first frame
    block_px: int
    left_px: int  # upper left corner of the first block in the full frame
    top_px: int
    range_m: NDArray[np.float64]  # (rows, cols) z-depth from the gimbal pivot; NaN: no clear peak
    sharp: NDArray[np.uint8]  # (rows * block_px + rest, cols * block_px + rest, 3), each block from its sharpest frame


MeasureDepth = Callable[[Sequence[SweepFrame], Calibration], SweepDepth | None]


class SweepAssembler:
    """Gathers frames and sightings as they are recorded, until a sweep of `steps` positions is whole."""

    def __init__(self, steps: int) -> None:
        self._steps = steps
        self._frames: list[tuple[Picture, Sighting]] = []

    def take(self, picture: Picture | None, sighting: Sighting) -> list[SweepFrame]:
        """The frames of the sweep that this one completes, or none; a sweep that lost a frame is passed over.

        Raises ConfigError for a frame that does not decode.
        """
        if not sighting.sweep or (self._frames and self._frames[-1][1].sweep != sighting.sweep):
            self._frames = []
        if sighting.sweep and picture is not None:
            self._frames.append((picture, sighting))
        if len(self._frames) < self._steps:
            return []
        whole, self._frames = self._frames, []
        return [SweepFrame(pixels(picture), picture.roi, seen) for picture, seen in whole]


def whole_sweeps(records: Iterable[Record], steps: int) -> Iterator[list[SweepFrame]]:
    """Every sweep of `steps` positions in a recording whose frames are all there."""
    frames, gathered = Frames(), SweepAssembler(steps)
    for record in records:
        frames.take(record.channel, record.sequence, record.data)
        if record.channel == VISION.name:
            sweep = gathered.take(frames.at(record.sequence), decode(record.data, Sighting))
            if sweep:
                yield sweep


def sweep_points(depth: SweepDepth, camera: CameraFit) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """The blocks that have a range: places in the camera frame in metres (n, 3), and colours (n, 3) red green blue."""
    rows, cols = np.nonzero(np.isfinite(depth.range_m))
    u_px, v_px = ((k + 0.5) * depth.block_px - 0.5 for k in (cols, rows))
    z = depth.range_m[rows, cols]
    x = (depth.left_px + u_px - camera.cx_px) / camera.f_px * z
    y = (depth.top_px + v_px - camera.cy_px) / camera.f_px * z
    high, wide, size = *depth.range_m.shape, depth.block_px
    blocks = depth.sharp[: high * size, : wide * size].reshape(high, size, wide, size, 3).mean(axis=(1, 3))
    colours = blocks[rows, cols, ::-1]
    return np.stack([x, y, z], axis=1).astype(np.float32), colours.round().astype(np.uint8)
