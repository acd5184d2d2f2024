"""What a focus sweep is worth in the light of a set of lamps: J, by which the range's variance falls.

The exposure is that which this set gets: a lamp too near to a target burns it out, and is paid for by all others. The
camera's figures are those of its data sheet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.capabilities.light.model import INNER, Pair

ELECTRONS = 3.4e5  # of a pixel for each W/m2/sr in a colour, exposed as long as a frame takes
WELL = 4000.0  # electrons
READ_NOISE = 16.0  # electrons, at gain 1
MAX_GAIN = 8.0
LEVEL = 0.8  # of full scale: what the exposure gives to the brightest 2 % of the disc
BRIGHTEST = 0.98
SIGMA = 1000.0  # lens positions at J = 1: of the twin's sweeps in harbour and bay water, world 0
# Direct light in all light, of a grey target, below which half of the sweeps and more show no peak; world 0, too.
LEAST_CONTRAST = 0.05
WORST_MM = 60.0
LEAST_J = 1e-9


class Worth(NamedTuple):
    log_j: float  # rounded to 1e-6: exp differs between processors in its last bit, a decision must not
    contrast: float  # mean of the direct light over that of all light
    sigma_mm: float
    usable: bool


def worth(pairs: Sequence[Pair], depth_m: float, radius_m: float, focal_px: float, slope_mm: float) -> Worth:
    """Of one sweep with all these lamps on. slope_mm: millimetres of range for a lens position.

    J = n mean(D^2 / (D + B + r^2)) mean(D)^2 / mean(D^2), in electrons, over n pixels of the inner disc. The last
    factor counts a disc less that lies half in the dark.
    """
    points = len(pairs[0].direct)
    veil = sum(sum(pair.veil) for pair in pairs) / 3.0 * ELECTRONS
    direct = [sum(sum(pair.direct[i]) for pair in pairs) / 3.0 * ELECTRONS for i in range(points)]
    top = sorted(direct)[min(int(BRIGHTEST * points), points - 1)] + veil
    share = min(LEVEL * WELL / max(top, 1e-12), 1.0)
    gain = min(max(LEVEL * WELL / max(top * share, 1e-12), 1.0), MAX_GAIN)
    read = READ_NOISE * READ_NOISE / gain
    mean = mean_square = signal = 0.0
    for d in direct:
        d *= share
        mean += d / points
        mean_square += d * d / points
        signal += d * d / (d + veil * share + read) / points
    pixels = math.pi * (focal_px * INNER * radius_m / depth_m) ** 2
    even = mean * mean / mean_square if mean_square > 0.0 else 0.0
    log_j = round(math.log(max(pixels * signal * even, LEAST_J)), 6)
    contrast = mean / (mean + veil * share) if mean > 0.0 else 0.0
    sigma_mm = SIGMA * slope_mm * math.exp(-0.5 * log_j)
    return Worth(log_j, contrast, sigma_mm, contrast > LEAST_CONTRAST and sigma_mm < WORST_MM)
