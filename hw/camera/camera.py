"""A focusable camera, whatever is behind it: one protocol and the table from URL scheme to backend."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]  # (height, width, 3), blue green red

# Who measures without hurry (a bench, a depth map) would lose a whole sweep to one late frame, and on a machine with a
# load above ten, frames of the twin came more than 1 s late. An agent, whose robot drifts, sets a limit of its own.
PATIENCE_S = 5.0

GRID = 8  # pixels; regions start and end on multiples, as JPEG cells and colour mosaics of real sensors demand


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

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = PATIENCE_S) -> Frame:
        """The first frame exposed after this call and at least `settle_s` after the last set_focus.

        A region comes as `deliverable` says. Raises CameraGone when no frame comes within `timeout_s`.
        """

    def close(self) -> None: ...


def open_camera(url: str, twin_dir: Path, size: tuple[int, int] | None) -> Camera:
    """Open what `url` names: SCHEME:PLACE, see SCHEMES. The caller closes it.

    size: (width, height) that the calibration is for, in pixels; None takes what comes.
    Raises CameraError for a wrong address or another size, CameraGone if nothing answers there now.
    """
    scheme, place = known_scheme(url)
    camera = _open(scheme, place, twin_dir, size)
    if size is not None and camera.size != size:
        camera.close()
        raise CameraError(
            f"camera '{url}': delivers {camera.size[0]}x{camera.size[1]} pixels, not {size[0]}x{size[1]}; "
            "correct width_px and height_px under [camera]"
        )
    return camera


def known_scheme(url: str) -> tuple[str, str]:
    """SCHEME and PLACE of an address. Raises CameraError for one that no backend serves."""
    scheme, _, place = url.partition(":")
    if scheme not in SCHEMES or not place:
        known = ", ".join(f"{name}:{what}" for name, what in SCHEMES.items())
        raise CameraError(f"camera '{url}': no such kind of camera; write one of {known}")
    return scheme, place


SCHEMES = {"twin": "ROBOT", "stack": "DIR", "video": "FILE", "v4l2": "/dev/video0 or NAME"}  # scheme -> what follows it


def _open(scheme: str, place: str, twin_dir: Path, size: tuple[int, int] | None) -> Camera:
    # Imported when asked for: nobody needs the libraries of a camera that is not there.
    if scheme == "twin":
        from hw.camera_twin import open_twin

        return open_twin(Path(place) if "/" in place else twin_dir / f"{place}.camera")
    if scheme == "v4l2":
        from hw.camera_v4l2 import open_v4l2

        return open_v4l2(place, size)
    from hw.camera_files import open_stack, open_video

    return open_stack(Path(place)) if scheme == "stack" else open_video(Path(place))


def nearest(position: int, focus: FocusRange) -> int:
    """The position that the lens can take which is nearest to the one wanted."""
    steps = round((min(max(position, focus.lowest), focus.highest) - focus.lowest) / focus.step)
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
