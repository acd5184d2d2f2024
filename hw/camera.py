"""A focusable camera, whatever is behind it: one protocol and the table from URL scheme to backend."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]  # (height, width, 3), blue green red


class Roi(NamedTuple):
    """A part of the full frame, pixels from its upper left corner."""

    x: int
    y: int
    width: int
    height: int


class FocusRange(NamedTuple):
    """Lens positions as the driver numbers them; which end is near is for calibration to find out."""

    lowest: int
    highest: int
    step: int


class Frame(NamedTuple):
    t_ns: int  # middle of the exposure, CLOCK_MONOTONIC where the source has a clock
    seq: int
    image: Image
    roi: Roi  # where the image lies in the full frame


class CameraError(RuntimeError):
    """The camera cannot be opened or used; one line that says what to change."""


class CameraGone(CameraError):
    """No frame came in time, or the device went away; opening it again may help."""


class Camera(Protocol):
    """What every backend offers. One thread uses a camera at a time."""

    size: tuple[int, int]  # width, height of the full frame

    def focus_range(self) -> FocusRange | None:
        """None: the focus cannot be set, sweeps are refused."""

    def set_focus(self, position: int) -> int:
        """Move the lens; returns the position that the device reports afterwards."""

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = 1.0) -> Frame:
        """The first frame exposed after this call and at least `settle_s` after the last set_focus.

        Raises CameraGone when none comes within `timeout_s`.
        """

    def close(self) -> None: ...


def open_camera(url: str, twin_dir: Path, size: tuple[int, int]) -> Camera:
    raise NotImplementedError
