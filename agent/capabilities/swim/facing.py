"""Which way a landmark faces."""

from __future__ import annotations

import math

from agent.capabilities.swim.layout import Marker
from agent.core.linear_algebra import cross, difference
from agent.core.messages import Vector


def normal(marker: Marker) -> Vector:
    """Into the water, as long as its area, m^2."""
    a, b, _, d = marker.corners_m
    return cross(difference(b, a), difference(a, d))


def facing(marker: Marker, from_m: Vector) -> float:
    """Cosine between a landmark's normal and the way from it to a point."""
    out, way = normal(marker), difference(from_m, marker.middle_m)
    along = out[0] * way[0] + out[1] * way[1] + out[2] * way[2]
    return along / max(math.hypot(*out) * math.hypot(*way), 1e-9)
