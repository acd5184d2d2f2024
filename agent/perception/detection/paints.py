"""The four colours of buoys, told from one another by how much red they keep.

Reds and oranges, yellows and greens reflect ever less red for their green, in this order; water takes red from all of
them, and the more of it the weaker a colour has become. So two weights and a place on that scale say between which two
paints a thing is: logistic regression on marked balls of four sources, each source and colour with the same weight,
as other cameras might have taken them (`python -m tests.bench paints` fits them and says how they do on a source that
had no part in it). Hue alone does not serve: in water without red light a green ball has the hue of a yellow one.
"""

from __future__ import annotations

import math

from agent.kernel.config import Colour
from agent.perception.detection.colour import GLARE, ColourModel, Tone

# (place, of redder, of the logarithm of strength), logarithms of odds
WARM_OR_YELLOW = (0.70, 2.58, -2.13)
YELLOW_OR_GREEN = (4.61, 2.28, -0.42)
STRONGEST = 1.5  # strength from which on the water has not taken much, and paint alone makes the difference
# Bare stone, shells and starfish are redder than the water around them, so chance gives a round reddish spot four times
# as often as a yellow or green one of the same shape.
RARE = 0.1


def between(weights: tuple[float, float, float], tone: Tone) -> float:
    """Logarithm of the odds for the redder of two neighbours."""
    place, of_redder, of_strength = weights
    faded = math.log(min(max(tone.strength, 1e-3), STRONGEST))
    return place + of_redder * tone.redder + of_strength * faded


def _warm(tone: Tone) -> float:
    if tone.burnt > GLARE and tone.hue_rad < 0.0:
        return -math.inf  # white glare beside water: red burns out to yellow, not to pink
    return between(WARM_OR_YELLOW, tone)


def _yellow(tone: Tone) -> float:
    return min(-between(WARM_OR_YELLOW, tone), between(YELLOW_OR_GREEN, tone))


def _green(tone: Tone) -> float:
    return -between(YELLOW_OR_GREEN, tone)


# Hues of 255 marked balls in real and made pictures: red -8 to 9 deg, orange 2 to 20, yellow 4 to 80, green 26 to 150.
# Orange is what the rules of a known contest call its red buoy: who looks for red finds it as well.
NAMED: dict[Colour, ColourModel] = {
    "red": ColourModel(math.radians(5.0), math.radians(-20.0), math.radians(35.0), _warm),
    "orange": ColourModel(math.radians(12.0), math.radians(-10.0), math.radians(35.0), _warm),
    "yellow": ColourModel(math.radians(40.0), math.radians(0.0), math.radians(90.0), _yellow, RARE),
    "green": ColourModel(math.radians(100.0), math.radians(20.0), math.radians(170.0), _green, RARE),
}
