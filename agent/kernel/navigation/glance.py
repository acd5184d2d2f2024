"""Where to turn the camera for landmarks, when it is time to find oneself."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial

from agent.kernel.config import Body, Pose
from agent.kernel.control.attitude import Attitude
from agent.kernel.navigation.tags.facing import facing
from agent.kernel.navigation.tags.layout import Marker
from agent.kernel.ranging.camera_model import look_at

FAR_M = 2.0  # beyond, a tag of 8 cm is 20 px wide or hidden by the water
STEEP = 0.5  # cosine between a tag's normal and the way to it: beyond 60 degrees its corners say little
WAIT_NS = 700_000_000  # for the first frames in a direction, gimbal at rest
NEAR_M = 0.35  # nearer, one fills the picture
SEEN_DEG = 12.0  # from the middle of the picture
SEARCH_DEG = tuple((pan, tilt) for tilt in (-10.0, -35.0) for pan in (0.0, 30.0, -30.0, 60.0, -60.0, 85.0, -85.0))

Way = tuple[float, int, float, float]  # distance, id, pan, tilt of a landmark


class Glance:
    """One look for landmarks after the other, until the pose is sure enough."""

    def __init__(self, markers: Iterable[Marker], body: Body, surface_m: float) -> None:
        self._markers, self._body, self._surface_m = tuple(markers), body, surface_m
        self._step = 0
        self._way: tuple[float, float] | None = None  # of this step: a gimbal that is told another angle never rests
        self._until_ns: int | None = None  # nobody knows while the gimbal is on its way
        self._blind = True  # the pose was not known

    def direction_deg(self, pose: Pose | None, level: Attitude, steady: bool, now_ns: int) -> tuple[float, float]:
        """Pan and tilt to look at: where most landmarks are first, the next if that has not helped. Of a robot that
        knows nothing: all around. steady: whether the gimbal rests where it was told to look before."""
        if (pose is None) != self._blind:  # other ways, from the first on, when this one has had its time
            self._blind, self._step = pose is None, 0 if self._way is None else -1
        if not steady:
            self._until_ns = None
        elif self._until_ns is None:
            self._until_ns = now_ns + WAIT_NS
        elif now_ns >= self._until_ns:
            self._step, self._way, self._until_ns = self._step + 1, None, None
        if self._way is None:
            ways = SEARCH_DEG if pose is None else self._in_reach(pose, level) or SEARCH_DEG
            self._way = ways[self._step % len(ways)]
        return self._way

    def reset(self) -> None:
        self._step, self._way, self._until_ns = 0, None, None

    def _in_reach(self, pose: Pose, level: Attitude) -> tuple[tuple[float, float], ...]:
        """Directions of landmarks that the gimbal can turn to, those first around which there are most."""
        here = pose.x_m, pose.y_m, self._surface_m - level.depth_m
        found: list[Way] = []
        for marker in self._markers:
            pan, tilt = look_at(marker.middle_m, pose, self._body, *level, self._surface_m)
            distance_m = math.dist(here, marker.middle_m)
            free = _within(pan, self._body.pan_limit_deg) and _within(tilt, self._body.tilt_limit_deg)
            if free and NEAR_M < distance_m < FAR_M and facing(marker, here) > STEEP:
                found.append((distance_m, marker.id, pan, tilt))
        ranked = sorted((-sum(map(partial(_beside, way), found)), *way) for way in found)
        return tuple((pan, tilt) for _, _, _, pan, tilt in ranked)


def _beside(way: Way, other: Way) -> bool:
    """Whether a camera that looks at one sees the other as well."""
    return math.hypot(way[2] - other[2], way[3] - other[3]) < SEEN_DEG


def _within(deg: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= deg <= limits[1]
