"""What colour a thing has beside what is around it, under whatever light and water.

Water and lamp scale each plane of a picture, and a camera's gamma raises them all to a power. In logarithms of light
the first is a sum and the second a factor: the difference between a thing and its surroundings keeps its direction
in the plane of chromaticity under both. That direction is the hue here, 0 for red, 60 deg for yellow, 120 for green.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.config import Colour

# --- a picture and its exposure: what is too dark to have a colour, and what too bright ---
#
# A camera that takes half the light shows half of it everywhere, and one that multiplies afterwards what its sensor
# gave ends below 255: no absolute value tells a shadow from a black rim, or a bright thing from one burnt out.

Image = NDArray[np.uint8]
Light = NDArray[np.float32]

ENCODED = 2.2  # power between 8-bit values and light, as cameras encode it
LIGHT = (np.arange(256, dtype=np.float32) / 255.0) ** np.float32(ENCODED)  # of 8-bit values
BELOW = 5  # bytes below the brightest of all: from there on a plane says no more than that it is bright
FAINT = 150  # where the brightest is below, nothing has been at the sensor's limit
EVERY = 8  # of rows and columns one is enough to know the exposure
DARK = 0.01  # of the picture's bright light: vignettes of real cameras end below, what is lit lies above
BRIGHT = 0.95  # share of the pixels that are darker than what is called bright
LEAST = LIGHT[10]  # a pixel's noise and JPEG, in the light of dark ones


class Picture(NamedTuple):
    """An image (height, width, 3), blue green red, 8 bits."""

    image: Image
    dark: float  # light below which a pixel has no colour; 1 is white
    log_light: Light  # (256,) of 8-bit values; what is dark is grey
    white: int  # byte from which on a plane is burnt out


def exposed(image: Image) -> Picture:
    """The picture and its exposure."""
    some = image[::EVERY, ::EVERY]
    brightest = np.sort(np.maximum(np.maximum(some[..., 0], some[..., 1]), some[..., 2]).ravel())
    dark = max(DARK * LIGHT[brightest[int(BRIGHT * (len(brightest) - 1))]], LEAST)
    top = int(brightest[-1])
    return Picture(image, float(dark), np.log(LIGHT + np.float32(dark)), (top if top >= FAINT else 255) - BELOW)


# --- colours that are looked for ---

AXES_RAD = np.radians([240.0, 120.0, 0.0])  # hues of blue, green, red

MIN_STRENGTH = 0.12  # of a tone, logarithm of light: noise and caustics stay below
SAMPLE_TURN_RAD = math.radians(25.0)  # one ball's hue from 1 to 4 m in the twin's waters, and in runs of real pictures
# A burnt out top leaves hue only where little light falls, and there planes still clip: then red against green light
# of the least white part says whether it is yellow or red. Between yellows (0.33 to 0.74 of green's byte) and oranges
# (0.82 on) of two real runs; water takes red first, so a yellow thing never has more of it than that.
REDDER = math.log(0.80**2.2)
REDDER_FAR, NEAR = 0.8, 2.0  # what water takes of it with the strength of a colour, of colours weaker than that
ORANGE = 0.5  # red against green light above which no paint is yellow, which reflects both alike
BURNT = 0.03  # share of the disc
GLARE = 0.5  # and from which on a hue as blue as red is only white beside water: a red thing burns out to yellow
YELLOWISH_RAD, FADED_RAD = math.radians(8.0), math.radians(20.0)  # hues that a yellow one has only so, or near by:
NEAR_BY = 1.5  # strength from which on the water has not taken much yet
# A small yellow thing in the sun looks orange, for it is nearly white. Nothing red has so much green light: beside that
# of the water, sunlit yellow had 1.1 to 1.5 on a real run, red and orange 0.8 at most, 0.98 burnt out (logarithms).
BLEACHED = 1.05
# Far through water yellow comes near green. A yellow one still shows red where its colour is strong, a green one never
# does; where both are faint it is the hue alone.
GREENISH_RAD = (math.radians(50.0), math.radians(84.0))
LITTLE_RED, STRONG, MIDDLE_RAD = -1.44, 0.85, math.radians(76.0)
# Where the water itself has red left, as in a camera that balances white, yellow stands out from it and green is pale.
RED_LEFT, PALE = -1.2, 1.0
# Bare stone, shells and starfish are redder than the water around them: of round spots that are no balls 52 were red,
# 12 yellow, 8 green (160 pictures, each changed in eight ways; score above 0.35). Doubt that such a colour outweighs.
RARE = 0.1


class Tone(NamedTuple):
    """The colour of a thing as a picture shows it."""

    hue_rad: float  # against its surroundings, -pi to pi
    strength: float  # how far from their colour, logarithm of light
    red: float  # its own red light against the mean of its blue and green, logarithms
    redder: float  # its own red light against green, logarithms
    burnt: float  # share of it that is too bright to have a colour
    left: float  # red light of its surroundings against the mean of their blue and green, logarithms
    green: float  # its green light against theirs, logarithms


class Sample(NamedTuple):
    """Pixels that show a colour, blue green red."""

    thing: NDArray[np.uint8]  # (n, 3)
    around: NDArray[np.uint8]  # (m, 3)


class ColourModel(NamedTuple):
    """A colour that is looked for."""

    hue_rad: float  # at which spots are looked for
    low_rad: float  # hues that count for it
    high_rad: float
    may_be: Callable[[Tone], bool] = lambda tone: True  # of what the hue does not say
    rare: float = 0.0  # doubt in a thing's shape that it outweighs, for little else in the water has this colour

    def fits(self, tone: Tone, slack_rad: float) -> bool:
        """Whether a thing of this tone is of this colour; `slack_rad`: where its outline is not known well yet."""
        near = self.low_rad - slack_rad <= tone.hue_rad <= self.high_rad + slack_rad
        return near and (slack_rad > 0.0 or self.may_be(tone))


def _warm(tone: Tone) -> bool:
    if (tone.burnt > GLARE and tone.hue_rad < 0.0) or tone.green > BLEACHED:
        return False
    doubtful = tone.hue_rad > YELLOWISH_RAD and (tone.burnt >= BURNT or tone.strength > NEAR_BY)
    return _redder(tone) or not doubtful


def _redder(tone: Tone) -> bool:
    """Whether it has more red light than a yellow thing may have left through as much water."""
    return tone.redder > REDDER + min(REDDER_FAR * (tone.strength - NEAR), 0.0)


def _yellow(tone: Tone) -> bool:
    low, _ = GREENISH_RAD
    if tone.redder > ORANGE:
        return False
    if tone.hue_rad < FADED_RAD:
        return not _warm(tone) or (tone.burnt >= BURNT and not _redder(tone))
    return tone.hue_rad < low or not _greenish(tone)


def _green(tone: Tone) -> bool:
    _, high = GREENISH_RAD
    return tone.hue_rad > high or _greenish(tone)


def _greenish(tone: Tone) -> bool:
    """Of a hue that yellow and green have: whether it is green."""
    if tone.left > RED_LEFT:
        return tone.strength < PALE
    if tone.red > LITTLE_RED:
        return False
    return tone.strength > STRONG or tone.hue_rad > MIDDLE_RAD


def _model(
    hue_deg: float, low_deg: float, high_deg: float, may_be: Callable[[Tone], bool], rare: float = 0.0
) -> ColourModel:
    return ColourModel(math.radians(hue_deg), math.radians(low_deg), math.radians(high_deg), may_be, rare)


# Hues of 255 marked balls in real and made pictures: red -8 to 9 deg, orange 2 to 20, yellow 20 to 80, green 56 to 150.
# Green is looked for at the hue, of four from 100 to 121, at which most small ones and fewest false ones were found:
# the same on the runs of one pool as on all other pictures, each as it is and changed in six ways.
# Orange is what the rules of a known contest call its red buoy: a search for red finds it as well.
NAMED: dict[Colour, ColourModel] = {
    "red": _model(5.0, -20.0, 21.0, _warm),
    "orange": _model(12.0, -10.0, 21.0, _warm),
    "yellow": _model(40.0, 4.0, 84.0, _yellow, RARE),
    "green": _model(114.0, 50.0, 170.0, _green, RARE),
}


def tone_of(sample: Sample) -> Tone:
    """The tone of a thing, by the median of its pixels against that of the others."""
    shown = exposed(np.concatenate([sample.thing, sample.around])[:, None])
    own, around = (np.median(shown.log_light[pixels], axis=0).tolist() for pixels in sample)
    burnt = float(((sample.thing >= shown.white).sum(axis=1) >= 2).mean())
    return tone_between(own, around, burnt)


def tone_between(own: Sequence[float], around: Sequence[float], burnt: float) -> Tone:
    """The tone of a thing by its own light and that of its surroundings, logarithms (3,) of blue green red."""
    blue, green, red = (one - other for one, other in zip(own, around, strict=True))
    hue_rad, strength = hue_and_strength(blue, green, red)
    own_red, left = (light[2] - 0.5 * (light[0] + light[1]) for light in (own, around))
    return Tone(hue_rad, strength, own_red, own[2] - own[1], burnt, left, green)


def sampled(sample: Sample) -> ColourModel | None:
    """The colour of a thing against what is around it; None where it is as grey as that."""
    tone = tone_of(sample)
    if tone.strength < MIN_STRENGTH:
        return None
    return ColourModel(tone.hue_rad, tone.hue_rad - SAMPLE_TURN_RAD, tone.hue_rad + SAMPLE_TURN_RAD)


def weights(hue_rad: float) -> Light:
    """(3,) for blue, green, red: their sum so weighed is nought for grey and largest for that hue."""
    return np.cos(hue_rad - AXES_RAD).astype(np.float32)


def hue_and_strength(blue: float, green: float, red: float) -> tuple[float, float]:
    """Hue, radians from -pi to pi, and length of a difference of logarithms of light."""
    x, y = red - 0.5 * (green + blue), math.sqrt(0.75) * (green - blue)
    return math.atan2(y, x), math.hypot(x, y)
