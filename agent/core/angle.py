"""Angles go round."""

from __future__ import annotations

import math


def wrap(angle: float) -> float:
    """The same angle within -pi to pi, rad."""
    return math.remainder(angle, 2.0 * math.pi)
