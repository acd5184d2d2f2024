"""What colour a thing has beside what is around it, under whatever light and water.

Water and lamp scale each plane of a picture, and a camera's gamma raises them all to a power. In logarithms of light
the first is a sum and the second a factor: the difference between a thing and its surroundings keeps its direction
in the plane of chromaticity under both. That direction is the hue here, 0 for red, 60 deg for yellow, 120 for green.

It is what tells colours apart: whatever else was tried beside it (lightness, share burnt out, strength, red against
blue) told them apart in one camera and water and misled in the next. One thing physics adds: paint that reflects red
shows some of it as long as water has left its colour strong.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.kernel.config import Colour
from agent.perception.detection.picture import Light, exposed

AXES_RAD = np.radians([240.0, 120.0, 0.0])  # hues of blue, green, red
MIN_STRENGTH = 0.12  # of a tone, logarithm of light: noise and caustics stay below
SAMPLE_TURN_RAD = math.radians(25.0)  # one ball's hue from 1 to 4 m in the twin's waters, and in runs of real pictures
GLARE = 0.5  # share burnt out from which on a hue as blue as red is only white beside water: red burns out to yellow
FAR = 2.5  # spreads from which on a hue is of no named colour
# Paint that reflects red shows some while its colour is strong: logarithm of red against green light, by strength, so
# that no gamma changes it. Green balls near by have -1.6 and less; a thing with less than that is as unlikely to be of
# such paint as one 2 spreads off in hue.
STRONG, LITTLE_RED, LACKING = 1.05, -1.5, 4.0


class Tone(NamedTuple):
    """The colour of a thing as a picture shows it."""

    hue_rad: float  # against its surroundings, -pi to pi
    strength: float  # how far from their colour, logarithm of light
    redder: float  # its own red light against its green, logarithms
    burnt: float  # share of it that is too bright to have a colour


class Paint(NamedTuple):
    """Hues in which one paint is seen: a normal distribution, made unlikely by a lack of red where it reflects red."""

    hue_rad: float
    spread_rad: float
    reflects_red: bool = False

    def surprise(self, tone: Tone) -> float:
        """Minus twice the logarithm of the probability density of a tone, but for a constant."""
        lacks = self.reflects_red and tone.strength > STRONG and tone.redder < LITTLE_RED * tone.strength
        return self.off(tone) ** 2 + 2.0 * math.log(self.spread_rad) + (LACKING if lacks else 0.0)

    def off(self, tone: Tone) -> float:
        """Spreads from the mean hue."""
        return abs(math.remainder(tone.hue_rad - self.hue_rad, 2.0 * math.pi)) / self.spread_rad


class ColourModel(NamedTuple):
    """A colour that is looked for, and the others that may claim a thing with better reason."""

    paint: Paint
    rivals: tuple[Paint, ...] = ()

    def fits(self, tone: Tone, slack_rad: float) -> bool:
        """Whether a thing of this tone is of this colour; `slack_rad`: where its outline is not known well yet."""
        if slack_rad > 0.0:
            return self.paint.off(tone) <= FAR + slack_rad / self.paint.spread_rad
        if self.paint.off(tone) > FAR or (self.rivals and tone.burnt > GLARE and tone.hue_rad < 0.0):
            return False
        own = self.paint.surprise(tone)
        return all(own <= rival.surprise(tone) for rival in self.rivals)


def _paint(hue_deg: float, spread_deg: float, reflects_red: bool) -> Paint:
    return Paint(math.radians(hue_deg), math.radians(spread_deg), reflects_red)


# Mean and spread of the hues of 2300 views of marked balls: 4 runs of real and made pictures, each in 11 ways changed
# as another camera would have changed it, each run and colour with the same weight (`python -m tests.bench eyes`).
# Green's spread is near that of its middle half (26): a few outliers among the smallest would make it 40.
PAINTS = {"red": _paint(6.0, 8.0, True), "yellow": _paint(37.0, 18.0, True), "green": _paint(98.0, 29.0, False)}


def _named(name: str) -> ColourModel:
    return ColourModel(PAINTS[name], tuple(paint for other, paint in PAINTS.items() if other != name))


# Orange is what the rules of a known contest call its red buoy, and through water nobody can tell one from the other:
# who looks for either finds both.
NAMED: dict[Colour, ColourModel] = {
    "red": _named("red"),
    "orange": _named("red"),
    "yellow": _named("yellow"),
    "green": _named("green"),
}


def sampled(sample: NDArray[np.uint8], around: NDArray[np.uint8]) -> ColourModel | None:
    """The colour of pixels (n, 3) of a thing against others (m, 3) around it; None where it is as grey as these."""
    log_light = exposed(np.concatenate([sample, around])[:, None]).log_light
    contrast = np.median(log_light[sample], axis=0) - np.median(log_light[around], axis=0)
    hue_rad, strength = hue_and_strength(np.asarray(contrast, np.float32))
    return ColourModel(Paint(hue_rad, SAMPLE_TURN_RAD / FAR)) if strength >= MIN_STRENGTH else None


def weights(hue_rad: float) -> Light:
    """(3,) for blue, green, red: their sum so weighed is nought for grey and largest for that hue."""
    return np.cos(hue_rad - AXES_RAD).astype(np.float32)


def hue_and_strength(log_contrast: NDArray[np.float32]) -> tuple[float, float]:
    """Hue, radians from -pi to pi, and length of a difference (3,) of logarithms of blue green red light."""
    blue, green, red = (float(value) for value in log_contrast)
    x, y = red - 0.5 * (green + blue), math.sqrt(0.75) * (green - blue)
    return math.atan2(y, x), math.hypot(x, y)
