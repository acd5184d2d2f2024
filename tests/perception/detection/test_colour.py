"""What counts for which colour, on tones as real pictures have them; and what veil and exposure do to them."""

import math

import cv2
import numpy as np
import pytest

from agent.perception.detection.colour import Tone, hue_and_strength, redder
from agent.perception.detection.detect import find_ball
from agent.perception.detection.paints import NAMED
from agent.perception.detection.picture import exposed
from tests.perception.painted import CAMERA, ball_light, expose

# Light of paints, blue green red; and of waters: their own, and the share of light that comes through.
PAINTS = {"red": (0.04, 0.06, 0.6), "yellow": (0.07, 0.6, 0.75), "green": (0.08, 0.4, 0.04)}
WATERS = {
    "green": ((0.10, 0.20, 0.02), (0.55, 0.75, 0.35)),
    "blue": ((0.25, 0.20, 0.02), (0.75, 0.70, 0.30)),
    "without red": ((0.12, 0.20, 0.006), (0.50, 0.60, 0.20)),
}


def tone(hue_deg: float, strength: float, redder: float, burnt: float = 0.0) -> Tone:
    return Tone(math.radians(hue_deg), strength, redder, burnt)


def through(paint: tuple[float, ...], water: str, lamp: float) -> Tone:
    """The tone of a paint in so much lamp light before the water itself."""
    veil, left = (np.array(part) for part in WATERS[water])
    own = np.log(lamp * np.array(paint) * left + veil * (1.0 - left))
    hue_rad, strength = hue_and_strength(np.asarray(own - np.log(veil), np.float32))
    return Tone(hue_rad, strength, redder(own, np.log(veil)), 0.0)


def test_white_glare_on_blue_water_is_not_red() -> None:
    """What is burnt white has more red than the water around it; a red thing burns out to yellow, not to pink."""
    assert not NAMED["red"].fits(tone(-14.0, 0.88, 1.0, burnt=0.95), 0.0)
    assert NAMED["red"].fits(tone(-14.0, 0.88, 1.0), 0.0)
    assert NAMED["red"].fits(tone(11.0, 3.0, 1.6, burnt=0.76), 0.0)


@pytest.mark.parametrize("water", WATERS)
@pytest.mark.parametrize("lamp", [0.7, 1.5])
@pytest.mark.parametrize("paint", PAINTS)
def test_a_paint_is_named_in_any_water_in_any_light(paint: str, water: str, lamp: float) -> None:
    """Darker than the water or brighter; no limit of hue does that: in water without red a dark green one is orange."""
    seen = through(PAINTS[paint], water, lamp)
    assert [name for name in PAINTS if NAMED[name].fits(seen, 0.0)] == [paint]


def test_a_veil_in_front_does_not_change_what_paint_is_left() -> None:
    wall, ball = np.log([0.2, 0.2, 0.05]), np.array([0.01, 0.3, 0.2])
    plain = redder(np.log(ball), wall)
    veiled = redder(np.log(ball + 0.5 * np.exp(wall)), wall)
    assert veiled == pytest.approx(plain, abs=0.1)


def test_of_two_neighbours_one_is_likelier() -> None:
    """Their probabilities are one together, so the search for either puts its own ball first."""
    between = tone(60.0, 1.0, -2.0)
    assert NAMED["yellow"].probability(between) + NAMED["green"].probability(between) == pytest.approx(1.0, abs=0.01)
    far, near = tone(60.0, 1.0, -3.5), tone(60.0, 1.0, -0.8)
    assert NAMED["green"].probability(far) > 0.9 > 0.1 > NAMED["green"].probability(near)


def test_a_picture_with_a_tenth_of_the_light_has_the_same_ball() -> None:
    frame = expose(0.1 * ball_light((0.05, 0.02, 0.8)), 4)
    ball = find_ball(frame, CAMERA)
    assert ball is not None and ball.score > 0.8


def test_what_a_camera_multiplies_afterwards_is_burnt_out_below_white() -> None:
    image = np.full((80, 80, 3), 90, np.uint8)
    cv2.circle(image, (40, 40), 20, (217, 217, 217), -1)
    assert exposed(image).white == 212
