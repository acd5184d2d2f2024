"""Landmarks in a robot's frames: points followed since a key frame, and tags.

Odometry on the tank's planes lives on where the points of a key frame are in the frames after it. Each frame is
compared with the key frame itself, never with the one before: small steps would add up their errors. The frame before
only says where to begin to look, so that the way from the key frame may be long. Points are looked for in half size
first, which is fast and reaches far, then in full size, which is exact.

`LandmarkWatch` does this, and reads the tags, in the frames of a vision worker.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from threading import Lock
from typing import NamedTuple

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.core.ranging.camera_model import CameraFit, FocusFit, at_lens_position
from agent.core.ranging.focus import lens_position
from agent.core.step_io import Flow, SeenTags, Sighting
from agent.perception.tags import Array, Plane, fit_corners, green, light_of_bytes, seen_tags, to_slopes
from hw.camera.camera import Frame, Image

Points = NDArray[np.float32]  # (n, 2) pixels of the full size
Mask = NDArray[np.bool_]
Box = tuple[tuple[float, float], tuple[float, float]]  # middle and size, pixels of the full size

CANDIDATES, POINTS, QUALITY, APART_PX = 600, 150, 0.002, 12.0
CELLS = 6, 5  # across and down: points are spread, or a stone with a clear grain has them all
WINDOW_PX = 15  # in either size
COARSE_LEVELS, FINE_LEVELS = 3, 1  # of pyramids above half and full size: 48 and 6 px from where one begins to look
STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
AGREE_PX = 2.0  # between the two sizes; what slid to another point does not
MOST = 64  # pairs in a message, those that `_spread` has first
KEPT, OLDEST_NS = 0.6, 4_000_000_000  # a new key frame where fewer of the points are left, or it is older
STILL_PX = 4.0  # from frame to frame: a robot that holds turns by less than 2 degrees a second
# After a turn: longer than a servo may still be on its way by the gimbal's commanded history (`GimbalHistory`), for the
# kernel makes nothing of a key frame in which it does not know where the camera points.
STILL_NS = 200_000_000


class KeyFrame(NamedTuple):
    t_ns: int  # middle of its exposure
    full: Plane
    half: Plane
    points_px: Points  # of each part of the picture the clearest first
    slopes: Array  # (n, 2)


class Tracked(NamedTuple):
    """The points of a key frame, some time later."""

    key: KeyFrame
    t_ns: int
    points_px: Points  # where each was last seen
    left: Mask  # (n,) which are still followed
    moved_ns: int = 0  # of the newest frame in which half of them and more were elsewhere than in the one before

    @property
    def due(self) -> bool:
        """Whether it is time for a new key frame, whatever the gimbal does."""
        return is_due(self.key.t_ns, self.t_ns, self.left)

    @property
    def settled(self) -> bool:
        """Whether it is time for one because the gimbal has turned."""
        return has_settled(self.key.t_ns, self.t_ns, self.moved_ns)


def is_due(begun_ns: int, now_ns: int, left: Mask) -> bool:
    """Whether it is time for another key frame than that of begun_ns, of whose points these are `left`.

    How far the robot went since then is not seen in a picture.
    """
    return now_ns - begun_ns > OLDEST_NS or bool(left.sum() < max(KEPT * len(left), 1))


def has_settled(begun_ns: int, now_ns: int, moved_ns: int) -> bool:
    """Whether the picture moved, at moved_ns, since the key frame of begun_ns, and has been still for a while."""
    return begun_ns <= moved_ns <= now_ns - STILL_NS


def begin(image: Image, camera: CameraFit, t_ns: int, around: Sequence[Box] = (), moved_ns: int = 0) -> Tracked:
    """A key frame: a whole frame (height, width, 3), with the camera at its lens position.

    around: boxes of targets that are found in it, which get no points: they are neither floor nor wall, and may swim.
    moved_ns: when the picture was last seen to move.
    """
    full = green(image)
    half = _halved(full)
    free = np.full(half.shape, 255, np.uint8)
    for (x, y), (width, height) in around:
        left, right, top, bottom = (
            max(0, round(0.5 * edge)) for edge in (x - width / 2, x + width / 2, y - height / 2, y + height / 2)
        )
        free[top : bottom + 1, left : right + 1] = 0
    corners = cv2.goodFeaturesToTrack(half, CANDIDATES, QUALITY, 0.5 * APART_PX, mask=free)
    clearest = np.zeros((0, 2), np.float32) if corners is None else np.asarray(corners, np.float32).reshape(-1, 2)
    found = _from_half(clearest[_spread(clearest, half.shape)][:POINTS])
    key = KeyFrame(t_ns, full, half, found, to_slopes(camera, found.astype(np.float64)))
    return Tracked(key, t_ns, found, np.ones(len(found), bool), moved_ns)


def _spread(points: Points, shape: tuple[int, ...]) -> NDArray[np.intp]:
    """The order of points in which each cell of the picture gives its next one in turn."""
    cells = (points * CELLS // (shape[1], shape[0])).astype(int) @ (1, CELLS[0])
    by_cell = np.argsort(cells, kind="stable")
    begins = np.searchsorted(cells[by_cell], cells[by_cell])
    turn = np.empty(len(points), int)
    turn[by_cell] = np.arange(len(points)) - begins
    return np.argsort(turn, kind="stable")


def follow(tracked: Tracked, image: Image, t_ns: int) -> Tracked:
    """The same points in the next whole frame. A point that is lost stays lost."""
    key, full = tracked.key, green(image)
    (k,) = np.nonzero(tracked.left)
    left, points = np.zeros(len(tracked.left), bool), tracked.points_px.copy()
    if len(k):
        then, guess = key.points_px[k], tracked.points_px[k]
        coarse, seen = _look(key.half, _halved(full), _to_half(then), _to_half(guess), COARSE_LEVELS)
        coarse = _from_half(coarse)
        fine, seen_too = _look(key.full, full, then, coarse, FINE_LEVELS)
        inside = ((fine >= 0.0) & (fine <= (full.shape[1] - 1, full.shape[0] - 1))).all(axis=1)
        agree = np.hypot(*(fine - coarse).T) <= AGREE_PX
        left[k], points[k] = seen & seen_too & inside & agree, fine
    went = np.hypot(*(points - tracked.points_px)[left].T)
    still = len(went) > 0 and np.median(went) <= STILL_PX
    return Tracked(key, t_ns, points, left, tracked.moved_ns if still else t_ns)


def flow(tracked: Tracked, camera: CameraFit) -> Flow:
    """What the kernel gets of it. camera: at the lens position of the newest frame."""
    (k,) = np.nonzero(tracked.left)
    k = k[:MOST]
    pairs = np.hstack([tracked.key.slopes[k], to_slopes(camera, tracked.points_px[k].astype(np.float64))])
    return Flow(
        t_ns=tracked.t_ns, since_ns=tracked.key.t_ns, pairs=tuple((a, b, c, d) for a, b, c, d in pairs.tolist())
    )


def _look(then: Plane, now: Plane, points: Points, guess: Points, levels: int) -> tuple[Points, Mask]:
    out, status, _ = cv2.calcOpticalFlowPyrLK(
        then,
        now,
        points,
        guess.copy(),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=levels,
        criteria=STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(out, np.float32), np.asarray(status.ravel() > 0, np.bool_)


def _halved(plane: Plane) -> Plane:
    height, width = plane.shape
    return np.asarray(cv2.resize(plane, (width // 2, height // 2), interpolation=cv2.INTER_AREA), np.uint8)


def _to_half(points: Points) -> Points:
    """A pixel of half size covers two by two of the full one."""
    return np.asarray((points - 0.5) / 2.0, np.float32)


def _from_half(points: Points) -> Points:
    return np.asarray(2.0 * points + 0.5, np.float32)


# --- landmarks in the frames of a vision worker ---

QUEUE = 64  # frames that are not fetched yet: 6 s
WIDER = 1.2  # times a target: points keep away from so much
REST_M = 0.9  # where the lens is sharp between sweeps
NEAR_M = 0.5  # from here on a tag of 8 cm can be read then; a lens as far from rest as that is still sharp enough
OPENS_S = 0.02  # the exposure of a frame begins so long before its middle at most, and the one before has begun earlier


class LandmarkWatch:
    """Tags and followed points of one camera's frames. The worker's thread fills it, any other drains it."""

    def __init__(self, camera: CameraFit, focus: FocusFit | None, hz: float) -> None:
        """hz: at most so many frames a second are searched; between sweeps the worker reads as many. focus: None where
        it is fixed."""
        self._camera, self.period_s = camera, 1.0 / hz
        self.sharp = 0 if focus is None else round(lens_position(focus, REST_M))  # where landmarks are
        self._reach = 0.0 if focus is None else abs(lens_position(focus, NEAR_M) - self.sharp)
        self._wanted = self._rests = self.sharp  # what the lens is to be told between sweeps, and was told
        # what the device says that it did; None: its lens does not move
        self.rest: int | None = None if focus is None else self.sharp
        self._lock = Lock()  # guards the next two
        self._tags: deque[SeenTags] = deque(maxlen=QUEUE)
        self._flows: deque[Flow] = deque(maxlen=QUEUE)
        self._tracked: Tracked | None = None
        self._newest_ns: int | None = None

    def prepare(self) -> None:
        """Load the compiled code now, so that the first frame is not late for it."""
        square = np.full((64, 64), 255, np.uint8)
        square[16:48, 16:48] = 0
        rough = np.array([[15.5, 15.5], [47.5, 15.5], [47.5, 47.5], [15.5, 47.5]])
        fit_corners(square, light_of_bytes(self._camera.gamma), rough, self._camera)

    def wait_s(self, now_ns: int) -> float:
        """How long until the next whole frame is to be asked for; now_ns by the agent's clock.

        A camera gives the next frame whose exposure begins, so that one is asked for a little before it is due.
        """
        if self._newest_ns is None:
            return 0.0
        return max(0.0, self.period_s - OPENS_S - (now_ns - self._newest_ns) * 1e-9)

    def rest_at(self, lens_position: int | None) -> None:
        """Where the lens shall be between sweeps, as near as landmarks can be read from there; None: `sharp`."""
        wanted = self.sharp if lens_position is None else lens_position
        self._wanted = round(min(max(wanted, self.sharp - self._reach), self.sharp + self._reach))

    def due(self, lens_position: int | None) -> int | None:
        """What to tell a lens at that position now, between sweeps; None: it is where it shall be."""
        wanted = self._wanted
        return None if lens_position == self.rest and wanted == self._rests else wanted

    def rested(self, told: int, lens_position: int | None) -> None:
        """The lens was told this position, and reports lens_position."""
        self._rests, self.rest = told, lens_position

    def see(self, frame: Frame, lens_position: int | None, offset_ns: int, targets: Sequence[Sighting] = ()) -> None:
        """Search a whole frame; offset_ns: from the camera's clock to the agent's. targets: those found in it."""
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
        """Whether a key frame may begin there: at rest, and where sweep follows sweep, at positions near it.

        The kernel does not remember where it was longer than a key frame should last.
        """
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
