"""Where a camera looks for a target that no robot knows: outwards from where it was last, then all that the gimbal
reaches, row by row, again and again.

Neighbouring looks overlap, so that a target on the seam is whole in one of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.core.config import Body
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_transaction import Revertible

Ways = tuple[tuple[float, float], ...]  # pan and tilt, degrees

FRAMES = 2  # without the target, after which the next look is due
BACK = 2  # looks, so that the next is the one before
OVERLAP_DEG = 8.0  # of neighbouring looks: as wide as a ball of 14 cm is at 1 m
NEAR_M = 0.8  # floor and surface are searched from there on; what is nearer was farther away before
PITCH = 0.8  # of the spiral, in views: from one turn to the next, and from look to look
WIDEST_DEG = 90.0  # of the spiral


class SearchPlan(NamedTuple):
    """The looks of one search."""

    target: str
    spiral: Ways  # offsets from where the target was last
    around: Ways  # by the gimbal's own angles


class SearchPattern(Revertible):
    """How far the looks of one search have come. `TargetSearch` (target_search.py) moves it on."""

    def __init__(self, target: str, spiral: Ways, around: Ways) -> None:
        self.target = target
        self._spiral, self._around = spiral, around
        self._step, self._empty = -1, FRAMES
        self.found = False  # in the newest frame of the newest look
        self._glimpse = False  # in any frame of it
        self._glimpsed = -1  # the last look for which it went back

    @property
    def spirals(self) -> bool:
        """It has not looked everywhere around the last place yet."""
        return max(self._step, 0) < len(self._spiral)

    @property
    def empty(self) -> bool:
        """Whether the newest frames of the newest look have shown that there is nothing."""
        return self._empty >= FRAMES

    def add_frame(self, found: bool) -> None:
        """Take note of a frame of the newest look."""
        self.found, self._empty = found, 0 if found else self._empty + 1
        self._glimpse |= found

    def advance(self) -> None:
        """On to the next look. After one that showed something and then no more, once back to the one before: the
        robot was turning, and has stopped."""
        back = BACK if self._glimpse and self._step > self._glimpsed else 0
        self._glimpsed = max(self._glimpsed, self._step) if self._glimpse else self._glimpsed
        self._step, self._empty, self.found, self._glimpse = max(self._step - back, -1) + 1, 0, False, False

    @property
    def offset_deg(self) -> tuple[float, float] | None:
        """To add to the direction of the last place; None: the spiral is over."""
        return self._spiral[max(self._step, 0)] if self._step < len(self._spiral) else None

    @property
    def way_deg(self) -> tuple[float, float]:
        """Pan and tilt after the spiral."""
        return self._around[max(self._step - len(self._spiral), 0) % len(self._around)]


def spiral(camera: CameraFit, reach_deg: float) -> Ways:
    """Offsets that grow to `reach_deg` of pan, as many views of tilt; one turn at least."""
    wide_deg, high_deg = view_deg(camera)
    most = max(min(reach_deg, WIDEST_DEG) / wide_deg, PITCH)  # views
    found, turn = [(0.0, 0.0)], 2.0 * math.pi
    while (r := PITCH * turn / (2.0 * math.pi)) <= most + 0.5 * PITCH:
        found.append((r * wide_deg * math.cos(turn), r * high_deg * math.sin(turn)))
        turn += PITCH / r
    return tuple(found)


def all_around(camera: CameraFit, body: Body, depth_m: float, surface_m: float) -> Ways:
    """The gimbal's whole pan, at as many tilts as it takes to see floor and surface; every other row backwards."""
    pans = _middles(*body.pan_limit_deg, _step_deg(view_deg(camera)[0]))
    rows = rows_deg(camera, body, depth_m, surface_m)
    return tuple((pan, tilt) for k, tilt in enumerate(rows) for pan in (pans if k % 2 == 0 else pans[::-1]))


def rows_deg(camera: CameraFit, body: Body, depth_m: float, surface_m: float) -> tuple[float, ...]:
    """Tilts, lowest first, at which looks show floor and surface and what is between them."""
    lowest = max(-math.degrees(math.atan2(surface_m - depth_m, NEAR_M)), body.tilt_limit_deg[0])
    highest = min(math.degrees(math.atan2(depth_m, NEAR_M)), body.tilt_limit_deg[1])
    return _middles(lowest, max(highest, lowest), _step_deg(view_deg(camera)[1]))


def view_deg(camera: CameraFit) -> tuple[float, float]:
    """How wide and how high the camera's view is, degrees."""
    wide, high = (2.0 * math.degrees(math.atan2(0.5 * px, camera.f_px)) for px in (camera.width_px, camera.height_px))
    return wide, high


def _step_deg(view: float) -> float:
    return max(view - OVERLAP_DEG, 0.5 * view)


def _middles(low: float, high: float, step: float) -> tuple[float, ...]:
    """Of as few equal parts from low to high as are no longer than a step."""
    count = max(math.ceil((high - low) / step), 1)
    return tuple(low + (k + 0.5) * (high - low) / count for k in range(count))
