"""What colour a thing has beside what is around it, under whatever light and water.

Water and lamp scale each plane of a picture, and a camera's gamma raises them all to a power. In logarithms of light
the first is a sum and the second a factor: the difference between a thing and its surroundings keeps its direction
in the plane of chromaticity under both. That direction is the hue here, 0 for red, 60 deg for yellow, 120 for green.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.perception.detection.picture import Light, exposed

AXES_RAD = np.radians([240.0, 120.0, 0.0])  # hues of blue, green, red

MIN_STRENGTH = 0.12  # of a tone, logarithm of light: noise and caustics stay below
SAMPLE_TURN_RAD = math.radians(25.0)  # one ball's hue from 1 to 4 m in the twin's waters, and in runs of real pictures
BURNT = 0.03  # share of a disc: from there on its colour is taken where least light falls
GLARE = 0.5  # and from there on it glows
LEFT = 0.05  # of its light a thing keeps at least when the veil is taken away: what is less is noise


class Tone(NamedTuple):
    """The colour of a thing as a picture shows it."""

    hue_rad: float  # against its surroundings, -pi to pi
    strength: float  # how far from their colour, logarithm of light
    redder: float  # its red light against its green, the veil of the water taken away, logarithm
    burnt: float  # share of it that is too bright to have a colour


class ColourModel(NamedTuple):
    """A colour that is looked for."""

    hue_rad: float  # at which spots are looked for
    low_rad: float  # hues that may be of it
    high_rad: float
    log_odds: Callable[[Tone], float] = lambda tone: math.inf  # for it, against the other colours that have such a hue
    rare: float = 0.0  # doubt that it takes from a thing's shape, for little else in the water has it

    def fits(self, tone: Tone, slack_rad: float) -> bool:
        """Whether a thing of this tone is of this colour; `slack_rad`: where its outline is not known well yet."""
        near = self.low_rad - slack_rad <= tone.hue_rad <= self.high_rad + slack_rad
        return near and (slack_rad > 0.0 or self.log_odds(tone) > 0.0)

    def probability(self, tone: Tone) -> float:
        """That a thing of such a hue is of this colour."""
        return 1.0 / (1.0 + math.exp(-max(self.log_odds(tone), -50.0)))


def redder(own: Light, around: Light) -> float:
    """Red light of a thing against its green once the veil is taken away; logarithms of light (3,), as the answer.

    Light from a thing is what comes through the water and a share of the water's own light. That share is at most the
    smallest ratio, over the planes, of thing to surroundings: paint of any colour takes one plane nearly whole (the
    dark channel of He, Sun and Tang, 2009). What remains is paint times lamp times water, whatever the distance in
    thin water, and of one paint alike before a dark wall and a bright view.
    """
    veil = min(1.0, math.exp(float((own - around).min())))
    seen = np.exp(own)
    left = np.maximum(seen - veil * np.exp(around), LEFT * seen)
    return float(np.log(left[2] / left[1]))


def sampled(sample: NDArray[np.uint8], around: NDArray[np.uint8]) -> ColourModel | None:
    """The colour of pixels (n, 3) of a thing against others (m, 3) around it; None where it is as grey as these."""
    log_light = exposed(np.concatenate([sample, around])[:, None]).log_light
    contrast = np.median(log_light[sample], axis=0) - np.median(log_light[around], axis=0)
    hue_rad, strength = hue_and_strength(np.asarray(contrast, np.float32))
    if strength < MIN_STRENGTH:
        return None
    return ColourModel(hue_rad, hue_rad - SAMPLE_TURN_RAD, hue_rad + SAMPLE_TURN_RAD)


def weights(hue_rad: float) -> Light:
    """(3,) for blue, green, red: their sum so weighed is nought for grey and largest for that hue."""
    return np.cos(hue_rad - AXES_RAD).astype(np.float32)


def hue_and_strength(log_contrast: NDArray[np.float32]) -> tuple[float, float]:
    """Hue, radians from -pi to pi, and length of a difference (3,) of logarithms of blue green red light."""
    blue, green, red = (float(value) for value in log_contrast)
    x, y = red - 0.5 * (green + blue), math.sqrt(0.75) * (green - blue)
    return math.atan2(y, x), math.hypot(x, y)
