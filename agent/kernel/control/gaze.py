"""A gaze that goes with a target which swims: ahead of where it was last known to be, and to and fro where it is not
seen.

    offset = a(t) tri(t / T + share),  a = min(70, 15 + 25 t) degrees,  tri from 0 over 1 and -1 back to 0

t counts from LOST_NS after the newest frame that showed the target. `share` differs from robot to robot, so that not
all of them look the wrong way at once.
"""

from __future__ import annotations

import math

LOST_NS = 400_000_000  # four frames without it
ELSEWHERE_NS = 200_000_000  # several steps
PERIOD_S = 1.6  # of the triangle
FIRST_DEG, WIDER_DEG_S, WIDEST_DEG = 15.0, 25.0, 70.0  # half of a view; what a target of 0.2 m/s gains in a second


class Gaze:
    """Of one robot. share: of a period, by which its triangle is ahead of others'."""

    def __init__(self, share: float) -> None:
        self._share = share
        self._since_ns: int | None = None  # of the newest frame that showed it, or of the first moment without
        self._asked_ns = 0

    def saw(self, t_ns: int) -> None:
        """A frame exposed then showed the target."""
        self._since_ns = t_ns if self._since_ns is None else max(self._since_ns, t_ns)

    def sees(self, now_ns: int) -> bool:
        return self._since_ns is not None and now_ns - self._since_ns <= LOST_NS

    def offset_deg(self, now_ns: int) -> float:
        """To add to the pan towards the track. Where nobody asked for a while the camera was elsewhere, and how long
        it did not see the target counts anew."""
        if self._since_ns is None or now_ns - self._asked_ns > ELSEWHERE_NS:
            self._since_ns = now_ns
        self._asked_ns = now_ns
        unseen_s = (now_ns - self._since_ns - LOST_NS) * 1e-9
        return 0.0 if unseen_s <= 0.0 else swing_deg(unseen_s, self._share)


def swing_deg(unseen_s: float, share: float) -> float:
    """Of the triangle, so long after the target was lost."""
    return min(WIDEST_DEG, FIRST_DEG + WIDER_DEG_S * unseen_s) * triangle(unseen_s / PERIOD_S + share)


def triangle(periods: float) -> float:
    """Between -1 and 1, with a period of 1: 0 at 0 and 1/2, 1 at 1/4, -1 at 3/4."""
    return 1.0 - 4.0 * abs(math.fmod(periods + 0.25, 1.0) - 0.5)
