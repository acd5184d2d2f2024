"""How wrong the four corners of one tag are seen together, px: V_t, 8x8, and the part of it that a survey made.

    V_t = s_c^2 I8 + s_o^2 (1 1') x I2 + s_s^2 c c' + f^2 G S G'

c: the corners less their mean, px; S: of the survey's six errors; G: how these move the slopes. Corners of one tag
share errors: independent ones of 0.2 px made fixes overconfident, NEES/3 of 5.9 and 9.2. The eight numbers are u, v of
each corner.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.capabilities.swim.layout import Marker
from agent.capabilities.swim.projection import Seen, View, by_survey
from agent.core.config import Landmarks
from agent.core.linear_algebra import cholesky
from agent.core.step_io import SeenTag

# Measured on rendered frames, blurred by 0 to 7 px, of 640x480.
EDGE_PX = 0.08  # s_c of corners where fitted edges meet
FOUND_PX = 0.8  # s_c of corners as a corner finder puts them
OFFSET_PX = 0.04  # s_o in the middle of the picture
BENT_PX = 0.15  # and what the lens's bending leaves of it at the edge, growing with the cube of the distance
EDGE_AT = 0.55  # of the picture's width, that edge
STRETCH = 0.0012  # s_s: blur and threshold make all of a tag larger or smaller
# What a corner finder adds to it: it draws all four inwards alike, so that a small tag seems far away. In what was
# rendered a tag without edges, seen from beyond 0.8 m, was 24 mm wrong (90 %) where it said 8.
INWARDS_PX = 0.8


class TagNoise(NamedTuple):
    """Of one tag, px."""

    L: list[list[float]]  # lower 8 x 8, V_t = L L'
    survey: list[list[float]]  # f G S^(1/2), 8 x 6: the part of V_t that is the same whenever this tag is seen


def tag_noise(of: View, tag: SeenTag, marker: Marker, at: tuple[Seen, ...], landmarks: Landmarks) -> TagNoise | None:
    """V_t of a tag as it should be seen; None where numbers are too large to be of this world."""
    corner_px2 = (EDGE_PX if tag.edges else FOUND_PX) ** 2
    bent = tag.rho_px / (EDGE_AT * of.width_px)
    offset_px2 = (OFFSET_PX + BENT_PX * bent * bent * bent) ** 2
    flat = [of.f_px * s for corner in tag.corners for s in corner]
    means = 0.25 * (flat[0] + flat[2] + flat[4] + flat[6]), 0.25 * (flat[1] + flat[3] + flat[5] + flat[7])
    drawn = 0.0 if tag.edges else INWARDS_PX / (math.sqrt(0.5) * max(tag.size_px, 1.0))  # of half a diagonal
    grown = math.hypot(STRETCH, drawn)
    stretch = [grown * (value - means[i % 2]) for i, value in enumerate(flat)]
    shift, turn = of.f_px * landmarks.sigma_m, of.f_px * math.radians(landmarks.sigma_deg)
    scales = (shift, shift, shift, turn, turn, turn)
    survey = [
        [scale * g for scale, g in zip(scales, row, strict=True)]
        for seen, corner in zip(at, marker.corners_m, strict=True)
        for row in by_survey(seen, marker.middle_m, corner)
    ]
    V: list[list[float]] = []
    for i in range(8):
        row = []
        for j in range(i + 1):
            value = stretch[i] * stretch[j]
            for p, q in zip(survey[i], survey[j], strict=True):
                value += p * q
            if i == j:
                value += corner_px2
            if (i - j) % 2 == 0:
                value += offset_px2
            row.append(value)
        V.append(row)
    L = cholesky(V)
    return None if L is None else TagNoise(L, survey)
