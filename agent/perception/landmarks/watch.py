"""Landmarks in the frames of a vision worker: which frames are searched for them, and what is kept until it is fetched."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from threading import Lock

from agent.kernel.ranging.calibration import CameraFit
from agent.kernel.step_io import SeenTags
from agent.perception.landmarks.tags import seen_tags
from hw.camera.camera import Frame

QUEUE = 64  # frames that nobody has fetched: 6 s


class LandmarkWatch:
    """Filled by the worker's thread, drained by any other."""

    def __init__(self, camera: CameraFit, hz: float) -> None:
        """hz: at most so many frames a second are searched; between sweeps the worker reads as many."""
        self._camera, self.period_s = camera, 1.0 / hz
        self._lock = Lock()  # guards the next
        self._out: deque[SeenTags] = deque(maxlen=QUEUE)
        self._newest_ns: int | None = None

    def due(self, now_ns: int) -> bool:
        """Whether the next frame shall be a whole one, to be searched."""
        return self._newest_ns is None or now_ns - self._newest_ns >= 0.9e9 * self.period_s

    def see(self, frame: Frame, lens_position: int | None, offset_ns: int) -> None:
        """Search a whole frame; `offset_ns` from the camera's clock to the agent's."""
        found = seen_tags(frame.image, self._camera, lens_position, frame.t_ns + offset_ns, frame.seq)
        self._newest_ns = found.t_ns
        with self._lock:
            self._out.append(found)

    def drain(self) -> Sequence[SeenTags]:
        """All that was seen since the last call, oldest first."""
        with self._lock:
            out = tuple(self._out)
            self._out.clear()
        return out
