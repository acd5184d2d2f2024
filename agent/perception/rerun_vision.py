"""Vision once more, on frames from a recording: the worker's own `sight`, without its camera and its thread."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from agent.clock.clock import StandingClock
from agent.core.config import Fleet
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import Sighting
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import Vision
from hw.camera.camera import Camera, CameraError, Frame, Roi

Roi4 = tuple[int, int, int, int]  # x, y, width, height in the full frame
See = Callable[[NDArray[np.uint8], Roi4, Sighting, Sighting | None], Sighting]


def rerun_vision(fleet: Fleet, camera: CameraFit) -> See:
    """A function (image, its part of the frame, the sighting of then, the sweep's first with a target) -> that of now.

    What the devices said, time, number and lens position, is taken from then; what the image says is new.
    """
    vision = Vision(_no_camera, fleet, camera, load_detectors(fleet, camera), StandingClock())

    def see(image: NDArray[np.uint8], part: Roi4, then: Sighting, first: Sighting | None) -> Sighting:
        frame = Frame(image=image, t_ns=then.t_ns, seq=then.frame, roi=Roi(*part))
        return vision.sight(frame, then.target, then.focus, then.sweep, then.index, first)

    return see


def _no_camera() -> Camera:
    raise CameraError("a recording has no camera")
