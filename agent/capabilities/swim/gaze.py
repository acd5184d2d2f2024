"""A gaze that goes with a target which swims: ahead of where it was last known to be, and, where it is not seen, to and
fro over all places where it may be.

With x and C where it is believed to be and how well, u the level direction across the line of sight, and sigma^2 =
u'Cu, the places to look at are

    p(s) = x + s C u / sigma,   -2 <= s <= 2

the mean of where it is, given how far beside x it is: for a target that one other robot sees, that robot's line of
sight. Where all have lost it each takes those that are nearer to itself than to any other, and looks from end to end of
them but for what its picture shows anyway. As long as the view is wider than all that, the gaze rests: who turned aside
would miss what comes out from behind a stone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from agent.core.messages import Symmetric, Vector
from agent.core.step_transaction import Revertible

LOST_NS = 400_000_000  # four frames without it
ELSEWHERE_NS = 200_000_000  # several steps
PERIOD_S = 1.6  # of the triangle, at least
SWIFTEST_DEG_S = 60.0  # of the gaze: neighbouring frames overlap by three quarters; faster, no tag says where it looks
SIGMAS = 2.0  # to either side
SHOWN_DEG = 7.0  # to either side of the gaze, of a view of 30 degrees and a target that is whole in it


class Gaze(Revertible):
    """Of one robot. share: of a period, by which its triangle is ahead of others'."""

    def __init__(self, share: float) -> None:
        self._share = self._phase = share
        self._since_ns: int | None = None  # of the newest frame that showed it, or of the first moment without
        self._asked_ns = 0

    def saw(self, t_ns: int) -> None:
        """A frame exposed then showed the target."""
        self._since_ns = t_ns if self._since_ns is None else max(self._since_ns, t_ns)

    def sees(self, now_ns: int) -> bool:
        return self._since_ns is not None and now_ns - self._since_ns <= LOST_NS

    def unseen_s(self, now_ns: int) -> float:
        """Since when it is lost; 0: it is not. Where nobody asked for a while the camera was elsewhere, and how long it
        did not see the target counts anew."""
        if self._since_ns is None or now_ns - self._asked_ns > ELSEWHERE_NS:
            self._since_ns, self._asked_ns = now_ns, now_ns
        return max((now_ns - self._since_ns - LOST_NS) * 1e-9, 0.0)

    def swing(self, half_deg: float, now_ns: int) -> float:
        """Between -1 and 1: to and fro over so much to either side, in the time that this takes. Asked in each step
        after `unseen_s`."""
        if self.sees(now_ns):
            self._phase = self._share
        else:
            period_s = max(PERIOD_S, 4.0 * half_deg / SWIFTEST_DEG_S)
            self._phase = math.fmod(self._phase + (now_ns - self._asked_ns) * 1e-9 / period_s, 1.0)
        self._asked_ns = now_ns
        return triangle(self._phase)


def triangle(periods: float) -> float:
    """Between -1 and 1, with a period of 1: 0 at 0 and 1/2, 1 at 1/4, -1 at 3/4."""
    return 1.0 - 4.0 * abs(math.fmod(periods + 0.25, 1.0) - 0.5)


def across(at_m: Vector, cov_m2: Symmetric, from_m: Vector) -> tuple[Vector, float]:
    """C u / sigma, m, u to the left as seen from there; and sigma as an angle, degrees."""
    x, y = at_m[0] - from_m[0], at_m[1] - from_m[1]
    far_m = max(math.hypot(x, y), 0.1)
    u, v = -y / far_m, x / far_m
    xx, xy, xz, yy, yz, _ = cov_m2
    way = xx * u + xy * v, xy * u + yy * v, xz * u + yz * v
    sigma_m = math.sqrt(max(u * way[0] + v * way[1], 1e-12))
    return (way[0] / sigma_m, way[1] / sigma_m, way[2] / sigma_m), math.degrees(math.atan2(sigma_m, far_m))


def own_part(
    at_m: Vector, step_m: Vector, here_m: Sequence[float], others_m: Sequence[Sequence[float]]
) -> tuple[float, float]:
    """From which s to which places are nearer to this robot than to any other, of at_m + s step_m; all of them where
    none is."""
    low, high = -SIGMAS, SIGMAS
    for x_m, y_m in others_m:
        dx, dy = x_m - here_m[0], y_m - here_m[1]
        slope = 2.0 * (step_m[0] * dx + step_m[1] * dy)
        room = x_m * x_m + y_m * y_m - here_m[0] * here_m[0] - here_m[1] * here_m[1]
        room -= 2.0 * (at_m[0] * dx + at_m[1] * dy)  # slope * s <= room
        if slope > 0.0:
            high = min(high, room / slope)
        elif slope < 0.0:
            low = max(low, room / slope)
        elif room < 0.0:
            high = low
    return (low, high) if low < high else (-SIGMAS, SIGMAS)
