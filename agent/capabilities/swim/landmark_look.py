"""Where to turn the camera for landmarks, when the robot is due to find out where it is."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from agent.capabilities.swim.landmarks import Marker, facing
from agent.core.attitude import Attitude
from agent.core.config import Body, Pose
from agent.core.ranging.camera_model import CameraFit, look_at
from agent.core.step_transaction import Revertible

FAR_M = 2.0  # beyond, a tag of 8 cm is 20 px wide or hidden by the water
CLEAR_M = 1.0  # in which murky water takes two thirds of the contrast; how murky it is, is not known
STEEP = 0.35  # cosine between a tag's normal and the way to it: beyond 70 degrees it is hardly found
WAIT_NS = 700_000_000  # for fixes from the frames in a direction, gimbal at rest
ENOUGH, TURN_DEG = 1.0, 60.0  # landmarks' worth for one fix; and so much of it is a turn by that angle, half a second
EMPTY = 2  # frames without a landmark, though the gimbal has all but come there, and the next look is due
# Of a camera that watches a target: what of a landmark's worth the farthest tilt aside costs, and a tilt unlike before.
ASIDE, UNLIKE = 0.1, 0.1
INSIDE_DEG = 1.0  # from the edge of the picture, where a landmark is whole for certain
SEARCH_DEG = tuple((pan, tilt) for tilt in (-10.0, -35.0) for pan in (0.0, 30.0, -30.0, 60.0, -60.0, 85.0, -85.0))


class Sure(NamedTuple):
    """How well a robot knows its pose: one sigma."""

    place_m: float
    yaw_deg: float


class Way(NamedTuple):
    """To one landmark, from where the robot is believed to be."""

    pan_deg: float
    tilt_deg: float
    distance_m: float
    marker: int
    worth: float  # share of its contrast that is left: less the more aslant, and the more water there is before it
    room_deg: float  # how far from the middle of the picture its own may be: all of it is in there
    sigma_deg: float  # of its direction, for all that is known of the pose


class LandmarkLook(Revertible):
    """One look for landmarks after the other, until the pose is sure enough."""

    def __init__(self, markers: Iterable[Marker], body: Body, surface_m: float, half_deg: tuple[float, float]) -> None:
        """half_deg: from the middle of the picture to its side, and to its upper edge."""
        self._markers, self._body, self._surface_m, self._half_deg = tuple(markers), body, surface_m, half_deg
        self._step = 0
        self._way: tuple[float, float] | None = None  # of this step: a gimbal that is told another angle never rests
        self._until_ns: int | None = None  # None while the gimbal is on its way
        self._blind = True  # the pose was not known
        self._looked_at: set[int] = set()  # landmarks that were in the pictures before
        self._empty, self._glimpsed = 0, False  # frames of this look without a landmark; one showed some

    def direction_deg(
        self,
        pose: Pose | None,
        sure: Sure,
        level: Attitude,
        steady: bool,
        now_ns: int,
        from_deg: tuple[float, float] | None = None,
    ) -> tuple[float, float]:
        """Pan and tilt to look at: where most landmarks are first; if that has not helped, where most others are. Of a
        robot that knows too little for that: all around. Where frames show none, not for long: a lost robot drifts
        meanwhile. steady: whether the gimbal rests where it was told to look before. from_deg: where it looks, of one
        in a hurry: some landmarks near there are better than many elsewhere."""
        if (pose is None) != self._blind:  # other ways, from the first on, when this one has had its time
            self._blind, self._step = pose is None, 0 if self._way is None else -1
        if not steady:
            self._until_ns = None
        elif self._until_ns is None:
            self._until_ns = now_ns + WAIT_NS
        over = self._until_ns is not None and now_ns >= self._until_ns
        if over or (self._empty >= EMPTY and not self._glimpsed):
            self._step, self._way, self._until_ns = self._step + 1, None, None
        if self._way is None:
            self._empty, self._glimpsed = 0, False
            known = None if pose is None else self._best(pose, sure, level, from_deg)
            self._way = known or SEARCH_DEG[self._step % len(SEARCH_DEG)]
        return self._way

    def add_frame(self, shows: bool) -> None:
        """One that was exposed when the gimbal had all but come to where it was told to look; shows: landmarks."""
        self._empty, self._glimpsed = self._empty + 1, self._glimpsed or shows

    def reset(self) -> None:
        self._step, self._way, self._until_ns = 0, None, None
        self._looked_at.clear()

    def tilt_aside_deg(
        self, way: tuple[float, float], most_deg: float, before_deg: float, pose: Pose, level: Attitude
    ) -> float:
        """How far above a target to look, by most_deg at most either way, so that its picture shows landmarks too.

        way: pan and tilt to the target; before_deg: what this said last.
        """
        if most_deg <= 0.0:
            return 0.0
        pan, tilt = way
        shown = []  # from which tilt to which a landmark is whole, and its worth
        for mark in self._in_reach(pose, Sure(0.0, 0.0), level):
            cut_deg = min(self._half_deg) - mark.room_deg + INSIDE_DEG
            if abs(mark.pan_deg - pan) < self._half_deg[0] - cut_deg:
                room_deg = self._half_deg[1] - cut_deg
                shown.append((mark.tilt_deg - tilt - room_deg, mark.tilt_deg - tilt + room_deg, mark.worth))
        low, high = (limit - tilt for limit in self._body.tilt_limit_deg)
        ways = {0.0, before_deg, *(edge for low_deg, high_deg, _ in shown for edge in (low_deg, high_deg))}
        within = [aside for aside in ways if abs(aside) <= most_deg and low <= aside <= high]

        def worth(aside: float) -> float:
            seen = sum(worth for low_deg, high_deg, worth in shown if low_deg <= aside <= high_deg)
            costs = ASIDE * abs(aside) + UNLIKE * abs(aside - before_deg)
            return min(seen, ENOUGH) - costs / most_deg

        return max(within, key=lambda aside: (worth(aside), -abs(aside)), default=0.0)

    def _best(
        self, pose: Pose, sure: Sure, level: Attitude, from_deg: tuple[float, float] | None
    ) -> tuple[float, float] | None:
        """Towards the landmark around which there are most that no look has shown yet, seen as square as may be; of
        several alike the nearest one. Then these have been looked at."""
        ways = self._in_reach(pose, sure, level)
        if all(way.marker in self._looked_at for way in ways):
            self._looked_at.clear()
        ways = [way for way in ways if way.marker not in self._looked_at]
        if not ways:
            return None
        worths = (sum(other.worth * _chance(way, other) for other in ways) for way in ways)
        if from_deg is not None:
            worths = (min(w, ENOUGH) - _away_deg(way, from_deg) / TURN_DEG for w, way in zip(worths, ways, strict=True))
        *_, best = min((-worth, way.distance_m, k) for k, (worth, way) in enumerate(zip(worths, ways, strict=True)))
        way = ways[best]
        self._looked_at.update(
            other.marker for other in ways if other is way or _apart_deg(way, other) < other.room_deg
        )
        return way.pan_deg, way.tilt_deg

    def _in_reach(self, pose: Pose, sure: Sure, level: Attitude) -> list[Way]:
        """Landmarks that the gimbal can turn to, and that can be read from there."""
        x, y, z = self._body.camera_m
        c, s = math.cos(math.radians(pose.yaw_deg)), math.sin(math.radians(pose.yaw_deg))
        here = pose.x_m + c * x - s * y, pose.y_m + s * x + c * y, self._surface_m - level.depth_m + z
        found: list[Way] = []
        for marker in self._markers:
            distance_m, square = math.dist(here, marker.middle_m), facing(marker, here)
            pan, tilt = look_at(marker.middle_m, pose, self._body, *level, self._surface_m)
            free = _within(pan, self._body.pan_limit_deg) and _within(tilt, self._body.tilt_limit_deg)
            half_m = math.dist(marker.middle_m, marker.corners_m[0])
            room_deg = min(self._half_deg) - math.degrees(math.atan2(half_m, distance_m))
            if free and distance_m < FAR_M and square > STEEP and room_deg > 0.0:
                sigma_deg = math.hypot(sure.yaw_deg, math.degrees(math.atan2(sure.place_m, distance_m)))
                worth = square * math.exp(-distance_m / CLEAR_M)
                found.append(Way(pan, tilt, distance_m, marker.id, worth, room_deg, sigma_deg))
        return found


def _chance(way: Way, other: Way) -> float:
    """That a camera which looks at one has the whole of the other in the picture as well; the picture has soft edges,
    so that it is a product of Gaussians."""
    soft2, sigma2 = 0.5 * other.room_deg**2, other.sigma_deg**2
    apart_deg = _apart_deg(way, other)
    return soft2 / (soft2 + sigma2) * math.exp(-0.5 * apart_deg * apart_deg / (soft2 + sigma2))


def _apart_deg(way: Way, other: Way) -> float:
    return math.hypot(way.pan_deg - other.pan_deg, way.tilt_deg - other.tilt_deg)


def _away_deg(way: Way, from_deg: tuple[float, float]) -> float:
    return max(abs(way.pan_deg - from_deg[0]), abs(way.tilt_deg - from_deg[1]))  # the servos turn at once


def _within(deg: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= deg <= limits[1]


def half_picture_deg(camera: CameraFit) -> tuple[float, float]:
    """From the middle of the picture to its side, and to its upper edge."""
    wide, high = (math.degrees(math.atan(0.5 * px / camera.f_px)) for px in (camera.width_px, camera.height_px))
    return wide, high
