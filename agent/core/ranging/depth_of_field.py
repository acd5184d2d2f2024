"""The ranges over which a picture is as sharp as its pixels can show.

The paper adds this width to the range of the peak. It is no error of the peak, which is found from the flanks and an
order of magnitude finer, so here it is a bound: what a single look at one frame could tell.
"""

from __future__ import annotations

import math


def depth_of_field_m(u_m: float, focal_m: float, f_number: float, spot_m: float) -> float:
    """L = f^2 u / (f^2 - G D (u - f)) - f^2 u / (f^2 + G D (u - f)) in air, metres (paper, section 3).

    u from the lens, G the f-number, D the largest blur on the sensor that cannot be told from a point: one pixel in the
    paper, 2 to 2.5 of them behind a colour filter. Infinite where the far limit is.
    """
    f2, reach = focal_m * focal_m, f_number * spot_m * (u_m - focal_m)
    if reach >= f2:
        return math.inf
    return f2 * u_m / (f2 - reach) - f2 * u_m / (f2 + reach)


def depth_of_field_in_water_m(
    u_m: float, focal_m: float, f_number: float, spot_m: float, index: float, port_m: float
) -> float:
    """The same behind a flat port `port_m` ahead of the lens: what lies at u seems to be at port + (u - port) / n."""
    return index * depth_of_field_m(port_m + (u_m - port_m) / index, focal_m, f_number, spot_m)
