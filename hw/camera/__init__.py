"""Cameras: one protocol (camera.py), a backend for each kind of address, and here the table from address to backend."""

from __future__ import annotations

from pathlib import Path

from agent.clock.clock import Clock, SystemClock
from agent.core.config import MainsHz
from hw.camera.camera import Camera, CameraError, Found

SCHEMES = {  # scheme -> what follows it
    "twin": "ROBOT",
    "stack": "DIR",
    "video": "FILE",
    "v4l2": "/dev/video0 or NAME",
    "libcamera": "0",
}


def open_camera(
    url: str, twin_dir: Path, size: tuple[int, int] | None, clock: Clock | None = None, mains_hz: MainsHz = 50
) -> Camera:
    """Open what `url` names: SCHEME:PLACE, see SCHEMES. The caller closes it.

    size: (width, height) that the calibration is for, in pixels; None takes what comes. clock: by which a camera of
    the twin is waited for, the system's if not given. mains_hz: what lamps flicker by, where a real camera is.
    Raises CameraError for a wrong address or another size, CameraGone if nothing answers there now.
    """
    scheme, place = known_scheme(url)
    camera = _open(scheme, place, twin_dir, size, clock or SystemClock(), mains_hz)
    if size is not None and camera.size != size:
        camera.close()
        raise CameraError(
            f"camera '{url}': delivers {camera.size[0]}x{camera.size[1]} pixels, not {size[0]}x{size[1]}; "
            "correct width_px and height_px under [camera]"
        )
    return camera


def plugged_in() -> list[Found]:
    """The cameras of this computer, each opened for a moment, so that none may be in use."""
    from hw.camera import libcamera, v4l2

    return [*v4l2.plugged_in(), *libcamera.plugged_in()]


def known_scheme(url: str) -> tuple[str, str]:
    """SCHEME and PLACE of an address. Raises CameraError for one that no backend serves."""
    scheme, _, place = url.partition(":")
    if scheme not in SCHEMES or not place:
        known = ", ".join(f"{name}:{what}" for name, what in SCHEMES.items())
        raise CameraError(f"camera '{url}': no such kind of camera; write one of {known}")
    return scheme, place


def _open(
    scheme: str, place: str, twin_dir: Path, size: tuple[int, int] | None, clock: Clock, mains_hz: MainsHz
) -> Camera:
    # Imported when asked for: a robot needs no libraries of a camera that it does not have.
    if scheme == "twin":
        from hw.camera.frame_socket import open_twin

        return open_twin(Path(place) if "/" in place else twin_dir / f"{place}.camera", clock)
    if scheme == "v4l2":
        from hw.camera.v4l2 import open_v4l2

        return open_v4l2(place, size, mains_hz)
    if scheme == "libcamera":
        from hw.camera.libcamera import open_libcamera

        return open_libcamera(place, size, mains_hz)
    from hw.camera.files import open_stack, open_video

    return open_stack(Path(place)) if scheme == "stack" else open_video(Path(place))
