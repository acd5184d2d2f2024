"""What counts for which colour, on tones as real pictures have them; and what exposure does to them."""

import math

import cv2
import numpy as np

from agent.perception.detection.colour import NAMED, Tone, exposed
from agent.perception.detection.detect import LIMIT, find_ball, score
from agent.perception.detection.outline_cone import OutlineFit, Patch
from tests.perception.painted import CAMERA, ball_light, expose


def tone(
    hue_deg: float, strength: float, redder: float, burnt: float = 0.0, left: float = -2.2, green: float = 0.5
) -> Tone:
    return Tone(math.radians(hue_deg), strength, redder, redder, burnt, left, green)


def test_white_glare_on_blue_water_is_not_red() -> None:
    """What is burnt white has more red than the water around it; a red thing burns out to yellow, not to pink."""
    assert not NAMED["red"].fits(tone(-14.0, 0.88, -0.75, burnt=0.95), 0.0)
    assert NAMED["red"].fits(tone(-14.0, 0.88, -0.75), 0.0)
    assert NAMED["red"].fits(tone(11.0, 3.0, 0.7, burnt=0.76), 0.0)


def test_far_through_water_a_burnt_yellow_and_a_burnt_orange_both_have_less_red() -> None:
    """By how far their colour has faded: near ones part at -0.5, those of strength 1.5 at -0.9."""
    near, far = tone(12.0, 2.3, -0.6, burnt=0.7), tone(12.0, 1.5, -0.6, burnt=0.7)
    assert NAMED["yellow"].fits(near, 0.0) and not NAMED["orange"].fits(near, 0.0)
    assert NAMED["orange"].fits(far, 0.0) and not NAMED["yellow"].fits(far, 0.0)


def test_a_small_yellow_ball_in_the_sun_is_not_orange() -> None:
    """Their hues are the same; no red thing has three times the green light of the water around it."""
    sunlit, orange = tone(10.0, 1.2, -1.2, green=1.3), tone(10.0, 1.2, -1.2, green=0.6)
    assert NAMED["yellow"].fits(sunlit, 0.0) and not NAMED["orange"].fits(sunlit, 0.0)
    assert NAMED["orange"].fits(orange, 0.0) and not NAMED["yellow"].fits(orange, 0.0)


def test_green_has_red_in_water_that_has() -> None:
    """A camera that balances white lifts red everywhere: then green is what stands out little."""
    pale, strong = tone(59.0, 0.6, -0.3, left=-0.6), tone(59.0, 1.4, -0.3, left=-0.6)
    assert NAMED["green"].fits(pale, 0.0) and not NAMED["green"].fits(strong, 0.0)
    assert not NAMED["green"].fits(tone(59.0, 0.6, -0.3), 0.0)


def test_a_shape_in_doubt_is_believed_sooner_in_a_colour_that_little_else_has() -> None:
    """Three tenths of its outline have no edge, as of a faint ball: too many for a reddish spot, as stones have."""
    found = Patch((1.0, 1.0, 1.0), tone(60.0, 0.6, -2.0), -0.5, 0.0, 1.0, 1.0, 0.3)
    fit = OutlineFit(np.array([0.0, 0.0, 1.0]), 15.0, 0.3, 0.71, 0.2, 2.0, 1.0, np.ones(96, bool))
    assert score(found, fit, NAMED["red"].rare) < LIMIT < score(found, fit, NAMED["green"].rare)
    sure = fit._replace(agree=1.0)
    assert score(found._replace(unrest=0.0), sure, NAMED["green"].rare) == 1.0


def test_a_picture_with_a_tenth_of_the_light_has_the_same_ball() -> None:
    frame = expose(0.1 * ball_light((0.05, 0.02, 0.8)), 4)
    ball = find_ball(frame, CAMERA)
    assert ball is not None and ball.score > 0.8


def test_what_a_camera_multiplies_afterwards_is_burnt_out_below_white() -> None:
    image = np.full((80, 80, 3), 90, np.uint8)
    cv2.circle(image, (40, 40), 20, (217, 217, 217), -1)
    assert exposed(image).white == 212
