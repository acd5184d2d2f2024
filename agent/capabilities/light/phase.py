"""Into which directions particles scatter light: Fournier and Forand, Proc. SPIE 2258 (1994), 194-201.

With the index and the slope of sizes below 0.018 of it goes backwards, the mean of Petzold's measurements.
"""

from __future__ import annotations

import math

INDEX, SLOPE = 1.10, 3.5835  # of the particles, relative to water; of the power law of their sizes
NU = (3.0 - SLOPE) / 2.0
AT_180 = 4.0 / (3.0 * (INDEX - 1.0) ** 2)  # d of the paper at 180 degrees
FORWARD_RAD = 1e-6  # nearer to straight on is as good as straight on, where the formula has no limit
NEAR_ONE = 1e-5  # of d, where the formula is 0/0; its neighbours stand for it


def phase(angle_rad: float) -> float:
    """Share of scattered light per steradian at `angle_rad` from its way; 1 in the integral over the sphere."""
    half = math.sin(0.5 * max(angle_rad, FORWARD_RAD))
    square = half * half
    d = AT_180 * square
    if abs(d - 1.0) < NEAR_ONE:
        d = 1.0 + NEAR_ONE
    power = math.pow(d, NU)
    front = NU * (1.0 - d) - (1.0 - power) + (d * (1.0 - power) - NU * (1.0 - d)) / square
    far = math.pow(AT_180, NU)
    cosine = 1.0 - 2.0 * square
    back = (1.0 - far) / (16.0 * math.pi * (AT_180 - 1.0) * far) * (3.0 * cosine * cosine - 1.0)
    return front / (4.0 * math.pi * (1.0 - d) ** 2 * power) + back
