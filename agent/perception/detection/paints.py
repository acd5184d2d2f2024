"""The four colours of buoys, told from one another by how much red they keep.

Reds and oranges, yellows and greens reflect ever less red for their green, in this order; water takes red from all of
them, and the more of it the weaker a colour has become. So two weights and a place on that scale say between which two
paints a thing is. They are logistic regression on the balls that the detector found in pictures of four sources, taken
as other cameras might have taken them, each source and colour with the same weight; then the place of the second was
moved by 0.3 to where as many greens as yellows are found. `python -m tests.bench paints` fits such weights at the
marked circles, and says how well they do on a source that had no part in it.

Hue alone does not serve: in water without red light a green ball has the hue of a yellow one. It says which colours
come into question.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.kernel.config import Colour
from agent.perception.detection.colour import GLARE, ColourModel, Tone

# (place, of redder, of the logarithm of strength), logarithms of odds
WARM_OR_YELLOW = (0.70, 2.58, -2.13)
YELLOW_OR_GREEN = (4.61, 2.28, -0.42)
STRONGEST = 1.5  # strength from which on the water has not taken much, and paint alone makes the difference
# Bare stone, shells and starfish are redder than the water around them, so chance gives a round reddish spot four times
# as often as a yellow or green one of the same shape.
RARE = 0.1


class Hues(NamedTuple):
    """That a paint has in some water."""

    low_rad: float
    high_rad: float

    def hold(self, tone: Tone) -> bool:
        return self.low_rad <= tone.hue_rad <= self.high_rad


def hues(low_deg: float, high_deg: float) -> Hues:
    return Hues(math.radians(low_deg), math.radians(high_deg))


# Of 255 marked balls in real and made pictures: red -8 to 9 deg, orange 2 to 20, yellow 4 to 80, green 26 to 150.
RED, ORANGE, YELLOW, GREEN = hues(-20.0, 35.0), hues(-10.0, 35.0), hues(0.0, 90.0), hues(20.0, 170.0)


def between(weights: tuple[float, float, float], tone: Tone) -> float:
    """Logarithm of the odds for the redder of two neighbours."""
    place, of_redder, of_strength = weights
    faded = math.log(min(max(tone.strength, 1e-3), STRONGEST))
    return place + of_redder * tone.redder + of_strength * faded


def _warm(tone: Tone) -> float:
    if tone.burnt > GLARE and tone.hue_rad < 0.0:
        return -math.inf  # white glare beside water: red burns out to yellow, not to pink
    return between(WARM_OR_YELLOW, tone) if YELLOW.hold(tone) else math.inf


def _yellow(tone: Tone) -> float:
    against_warm = -between(WARM_OR_YELLOW, tone) if RED.hold(tone) else math.inf
    against_green = between(YELLOW_OR_GREEN, tone) if GREEN.hold(tone) else math.inf
    return min(against_warm, against_green)


def _green(tone: Tone) -> float:
    return -between(YELLOW_OR_GREEN, tone) if YELLOW.hold(tone) else math.inf


# Orange is what the rules of a known contest call its red buoy: who looks for red finds it as well.
NAMED: dict[Colour, ColourModel] = {
    "red": ColourModel(math.radians(5.0), *RED, _warm),
    "orange": ColourModel(math.radians(12.0), *ORANGE, _warm),
    "yellow": ColourModel(math.radians(40.0), *YELLOW, _yellow, RARE),
    "green": ColourModel(math.radians(100.0), *GREEN, _green, RARE),
}
