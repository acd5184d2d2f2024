"""Where points of a key frame are in the frames after it: what odometry on the tank's planes lives on.

Each frame is compared with the key frame itself, never with the one before: small steps would add up their errors. The
frame before only says where to begin to look, so that the way from the key frame may be long.

Look in half size first, which is fast and reaches far, then in full size, which is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import Flow
from agent.perception.landmarks.edge_line import Plane
from agent.perception.landmarks.slopes import Array, to_slopes
from agent.perception.landmarks.tags import green
from hw.camera.camera import Image

Points = NDArray[np.float32]  # (n, 2) pixels of the full size
Mask = NDArray[np.bool_]
Box = tuple[tuple[float, float], tuple[float, float]]  # middle and size, pixels of the full size

POINTS, QUALITY, APART_PX = 150, 0.01, 12.0
WINDOW_PX = 15  # in either size
COARSE_LEVELS, FINE_LEVELS = 3, 1  # of pyramids above half and full size: 48 and 6 px from where one begins to look
STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
AGREE_PX = 2.0  # between the two sizes; what slid to another point does not
MOST = 64  # pairs in a message, the clearest points first
KEPT, OLDEST_NS = 0.6, 4_000_000_000  # a new key frame where fewer of the points are left, or it is older
STILL_PX = 4.0  # from frame to frame: a robot that holds turns by less than 2 degrees a second
# After a turn: for longer than the kernel thinks that a servo may still be on its way (navigation/gimbal_log.py), for
# it makes nothing of a key frame in which it does not know where the camera points.
STILL_NS = 200_000_000


class KeyFrame(NamedTuple):
    t_ns: int  # middle of its exposure
    full: Plane
    half: Plane
    points_px: Points  # clearest first
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
    """Whether it is time for another key frame than that of then, of whose points these are left. (How far the robot
    went since then is not seen in a picture.)"""
    return now_ns - begun_ns > OLDEST_NS or bool(left.sum() < max(KEPT * len(left), 1))


def has_settled(begun_ns: int, now_ns: int, moved_ns: int) -> bool:
    """Whether the picture moved, at moved_ns, since the key frame of begun_ns, and has been still for a while."""
    return begun_ns <= moved_ns <= now_ns - STILL_NS


def begin(image: Image, camera: CameraFit, t_ns: int, around: Sequence[Box] = (), moved_ns: int = 0) -> Tracked:
    """A key frame: a whole frame (height, width, 3), with the camera at its lens position. No points on what is found
    in it: that is neither floor nor wall, and may swim. moved_ns: when the picture was last seen to move."""
    full = green(image)
    half = _halved(full)
    free = np.full(half.shape, 255, np.uint8)
    for (x, y), (width, height) in around:
        left, right, top, bottom = (
            max(0, round(0.5 * edge)) for edge in (x - width / 2, x + width / 2, y - height / 2, y + height / 2)
        )
        free[top : bottom + 1, left : right + 1] = 0
    corners = cv2.goodFeaturesToTrack(half, POINTS, QUALITY, 0.5 * APART_PX, mask=free)
    found = (
        np.zeros((0, 2), np.float32) if corners is None else _from_half(np.asarray(corners, np.float32).reshape(-1, 2))
    )
    key = KeyFrame(t_ns, full, half, found, to_slopes(camera, found.astype(np.float64)))
    return Tracked(key, t_ns, found, np.ones(len(found), bool), moved_ns)


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
    """What the kernel is told. camera: at the lens position of the newest frame."""
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
