"""What tells a robot where it is, in the frames of a vision worker: tags, and points followed since a key frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from threading import Lock

import numpy as np
from msgspec.structs import replace

from agent.core.ranging.camera_model import CameraFit, FocusFit, at_lens_position
from agent.core.ranging.focus import lens_position
from agent.core.step_io import Flow, SeenTags, Sighting
from agent.perception.landmarks.edges import fit_corners, light_of_bytes
from agent.perception.landmarks.flow import Box, Tracked, begin, flow, follow
from agent.perception.landmarks.tags import seen_tags
from hw.camera.camera import Frame

QUEUE = 64  # frames that nobody has fetched: 6 s
WIDER = 1.2  # than a target, what points shall keep away from
REST_M = 0.9  # where the lens is sharp between sweeps
NEAR_M = 0.5  # and from where on a tag of 8 cm can be read then; a lens as far from rest as that is still sharp enough


class LandmarkWatch:
    """Filled by the worker's thread, drained by any other."""

    def __init__(self, camera: CameraFit, focus: FocusFit, hz: float) -> None:
        """hz: at most so many frames a second are searched; between sweeps the worker reads as many."""
        self._camera, self.period_s = camera, 1.0 / hz
        self.sharp = round(lens_position(focus, REST_M))  # where landmarks are
        self._reach = abs(lens_position(focus, NEAR_M) - self.sharp)
        self._wanted = self._rests = self.sharp  # what the lens is to be told between sweeps, and was told
        self.rest: int | None = self.sharp  # what the device says that it did; None: its lens does not move
        self._lock = Lock()  # guards the next two
        self._tags: deque[SeenTags] = deque(maxlen=QUEUE)
        self._flows: deque[Flow] = deque(maxlen=QUEUE)
        self._tracked: Tracked | None = None
        self._newest_ns: int | None = None

    def prepare(self) -> None:
        """Load the compiled code now, and not while somebody waits for what a first frame shows."""
        square = np.full((64, 64), 255, np.uint8)
        square[16:48, 16:48] = 0
        rough = np.array([[15.5, 15.5], [47.5, 15.5], [47.5, 47.5], [15.5, 47.5]])
        fit_corners(square, light_of_bytes(self._camera.gamma), rough, self._camera)

    def wait_s(self, now_ns: int) -> float:
        """How long until the next whole frame is due; now_ns by the agent's clock."""
        if self._newest_ns is None:
            return 0.0
        return max(0.0, self.period_s - (now_ns - self._newest_ns) * 1e-9)

    def rest_at(self, lens_position: int | None) -> None:
        """Where the lens shall be between sweeps, as near as landmarks can be read from there; None: `sharp`."""
        wanted = self.sharp if lens_position is None else lens_position
        self._wanted = round(min(max(wanted, self.sharp - self._reach), self.sharp + self._reach))

    def due(self, lens_position: int | None) -> int | None:
        """What to tell a lens at that position now, between sweeps; None: it is where it shall be."""
        wanted = self._wanted
        return None if lens_position == self.rest and wanted == self._rests else wanted

    def rested(self, told: int, lens_position: int | None) -> None:
        """It was told that, and says that it is there."""
        self._rests, self.rest = told, lens_position

    def see(self, frame: Frame, lens_position: int | None, offset_ns: int, targets: Sequence[Sighting] = ()) -> None:
        """Search a whole frame; `offset_ns` from the camera's clock to the agent's. targets: that were found in it."""
        t_ns = frame.t_ns + offset_ns
        found = seen_tags(frame.image, self._camera, lens_position, t_ns, frame.seq)
        if lens_position != self.rest or self._rests != self.sharp:
            found = replace(found, tags=tuple(tag for tag in found.tags if tag.edges))  # blur draws corners inwards
        camera = at_lens_position(self._camera, lens_position)
        moved, due, moved_ns = None, True, 0
        if self._tracked is not None:
            now = follow(self._tracked, frame.image, t_ns)
            moved, due, moved_ns = flow(now, camera), now.due, self._tracked.moved_ns
            if lens_position == self.rest:
                due, moved_ns = due or now.settled, now.moved_ns
                self._tracked = now  # what a blur hides for a while is not lost
        if due and self._shows_points(lens_position):
            around = [box for box in map(_around, targets) if box]
            self._tracked = begin(frame.image, camera, t_ns, around, moved_ns)
        self._newest_ns = t_ns
        with self._lock:
            self._tags.append(found)
            if moved is not None and moved.pairs:
                self._flows.append(moved)

    def _shows_points(self, lens_position: int | None) -> bool:
        """Whether a key frame may begin there: at rest, and where sweep follows sweep, at positions near it. The kernel
        does not remember where it was longer than a key frame should last."""
        if lens_position is None or self.rest is None:
            return lens_position == self.rest
        return abs(lens_position - self.rest) <= self._reach

    def drain(self) -> tuple[tuple[SeenTags, ...], tuple[Flow, ...]]:
        """All that was seen since the last call, oldest first."""
        with self._lock:
            tags, flows = tuple(self._tags), tuple(self._flows)
            self._tags.clear()
            self._flows.clear()
        return tags, flows


def _around(target: Sighting) -> Box | None:
    """A found target with the blur around it."""
    side_px = 2.0 * (target.radius_px or 0.0)
    size_px = target.size_px or (side_px, side_px)
    if not target.found or target.centre_px is None:
        return None
    return target.centre_px, (WIDER * size_px[0], WIDER * size_px[1])
