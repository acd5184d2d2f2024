"""A gaze that goes round all that the gimbal reaches, without rest: for a target that swims, and may be anywhere.

Looks with rests between them (roam.py) take longer for one round than a fish stays where it is. This one passes at a
rate at which neighbouring frames overlap, to and fro at one tilt after the other: every other time at the middle one,
where most swims.
"""

from __future__ import annotations

import math

from agent.capabilities.swim.gaze import SWIFTEST_DEG_S, triangle
from agent.core.config import Body
from agent.core.control.search_pattern import rows_deg
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_transaction import Revertible

AWAY_NS = 200_000_000  # several steps
SCAN_ELSEWHERE_NS = 2_000_000_000  # longer than a glance: it begins anew


class Scan(Revertible):
    """Of one robot. share: of a round, by which it is ahead of others'."""

    def __init__(self, share: float) -> None:
        self._share = self._turn = share
        self._asked_ns = 0

    def way_deg(
        self, camera: CameraFit, body: Body, depth_m: float, surface_m: float, rests: bool, now_ns: int
    ) -> tuple[float, float]:
        """Pan and tilt of now. Asked in each step; while it is not, its time stands still. rests: where it is, for the
        target has just come into view."""
        low, high = body.pan_limit_deg
        rows = rows_deg(camera, body, depth_m, surface_m)
        since_ns, self._asked_ns = now_ns - self._asked_ns, now_ns
        if since_ns > SCAN_ELSEWHERE_NS:
            self._turn = self._share
        elif since_ns < AWAY_NS and not rests:
            self._turn += since_ns * 1e-9 * SWIFTEST_DEG_S / (2.0 * (high - low))
        swing = math.floor(2.0 * self._turn + 0.5)  # each from one end of the pan to the other
        middle = len(rows) // 2
        row = middle if swing % 2 == 0 else (swing // 2) % len(rows)
        return 0.5 * (low + high) + 0.5 * (high - low) * triangle(self._turn), rows[row]
