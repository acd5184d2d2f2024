"""A focusable camera, whatever is behind it: the protocol that every backend keeps, its values and its errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]  # (height, width, 3), blue green red

# A bench or a depth map has time, and would lose a whole sweep to one late frame: on a machine with a load above ten,
# frames of the twin come more than 1 s late. An agent, whose robot drifts, sets a limit of its own.
PATIENCE_S = 5.0

GRID = 8  # pixels; regions start and end on multiples, as JPEG cells and colour mosaics of real sensors demand


class Roi(NamedTuple):
    """A part of the full frame, pixels from its upper left corner."""

    x: int
    y: int
    width: int
    height: int


# What the source stamps. From "exposure-start" the time of a frame follows; from "arrival" it is an estimate, which is
# right but for a lag that stays the same while size and rate do, and that a calibration can measure.
Stamp = Literal["exposure-start", "arrival"]


class FocusRange(NamedTuple):
    """Lens positions as the driver numbers them; calibration finds out which end is near."""

    lowest: int
    highest: int
    step: int


class Frame(NamedTuple):
    t_ns: int  # middle of the exposure, CLOCK_MONOTONIC where the source has a clock
    seq: int
    image: Image
    roi: Roi  # where the image lies in the full frame
    still: bool = False  # a recorded picture, which may come again and again; a sensor never sends one twice


NO_FOCUS = "its focus cannot be set: distances come from the target's size alone"  # said when it is opened


class CameraError(RuntimeError):
    """The camera cannot be opened or used; one line that says what to change."""


class CameraGone(CameraError):
    """No frame came in time, or the device went away; opening it again may help."""


class Found(NamedTuple):
    """A camera that is plugged in, and what came of opening it."""

    name: str  # its own
    address: str  # for `camera =` of the fleet file; empty: it cannot be used
    facts: tuple[tuple[str, str], ...]  # what is known of it: what, and one line
    shortcomings: tuple[str, ...]  # what it cannot do that a good camera can, a line each
    refused: str = ""  # why it cannot be used


def focus_fact(focus: FocusRange | None) -> tuple[str, str]:
    return "focus", "fixed" if focus is None else f"{focus.lowest} to {focus.highest} in steps of {focus.step}"


def exposure_fact(exposure_ns: int) -> tuple[str, str]:
    """exposure_ns: for how long frames are exposed; 0: nobody can set it."""
    return "exposure", f"can be set, {exposure_ns * 1e-6:g} ms now" if exposure_ns else "cannot be set"


class Camera(Protocol):
    """What every backend offers. One thread uses a camera at a time."""

    size: tuple[int, int]  # width, height of the full frame

    @property
    def stamp(self) -> Stamp:
        """What stands behind the times of its frames; of recorded pictures, which have no lag, "exposure-start"."""

    def focus_range(self) -> FocusRange | None:
        """The range of lens positions; None where the focus cannot be set, and sweeps are refused."""

    def set_focus(self, lens_position: int) -> int:
        """Move the lens; returns the lens position that the device reports afterwards."""

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = PATIENCE_S) -> Frame:
        """The first frame exposed after this call and at least `settle_s` after the last set_focus.

        A region comes as `deliverable` says. Raises CameraGone when no frame comes within `timeout_s`.
        """

    def close(self) -> None: ...


def no_control(missing: Sequence[str]) -> str:
    """What is said of a camera that cannot hold these things."""
    return f"it has no control of {', '.join(missing)}; what changes by itself in a sweep spoils its peak"


def nearest(lens_position: int, focus: FocusRange) -> int:
    """The lens position nearest to the one wanted among those that the lens can take."""
    steps = round((min(max(lens_position, focus.lowest), focus.highest) - focus.lowest) / focus.step)
    return min(focus.lowest + steps * focus.step, focus.highest)


def deliverable(roi: Roi | None, size: tuple[int, int]) -> Roi:
    """The part of a frame of `size` that is delivered when `roi` is asked for: what of it lies in the frame,
    grown to whole cells of GRID pixels. None asks for the full frame. Raises CameraError if nothing is left.
    """
    width, height = size
    if roi is None:
        return Roi(0, 0, width, height)
    left, top = max(roi.x, 0), max(roi.y, 0)
    right, bottom = min(roi.x + roi.width, width), min(roi.y + roi.height, height)
    if left >= right or top >= bottom:
        raise CameraError(f"region {tuple(roi)} (x, y, width, height) has no part in {width}x{height} pixels")
    left, top = left // GRID * GRID, top // GRID * GRID
    right, bottom = min(-(-right // GRID) * GRID, width), min(-(-bottom // GRID) * GRID, height)
    return Roi(left, top, right - left, bottom - top)
