"""What counts for which colour, on tones as real pictures have them; and what exposure does to them."""

import math

import cv2
import numpy as np
import pytest

from agent.perception.detection.colour import NAMED, Tone
from agent.perception.detection.detect import find_ball
from agent.perception.detection.patch import patch
from agent.perception.detection.picture import exposed
from tests.perception.painted import CAMERA, ball_light, defocus, expose


def tone(hue_deg: float, strength: float, redder: float, burnt: float = 0.0) -> Tone:
    return Tone(math.radians(hue_deg), strength, redder, burnt)


def names(seen: Tone) -> list[str]:
    return [name for name, model in NAMED.items() if model.fits(seen, 0.0)]


def test_a_thing_has_one_colour_but_for_red_and_orange() -> None:
    assert names(tone(2.0, 1.5, 0.5)) == ["red", "orange"]
    for hue_deg in range(-180, 180):
        got = names(tone(hue_deg, 0.5, -1.0))
        assert len([name for name in got if name != "orange"]) <= 1
        assert ("red" in got) == ("orange" in got)
    assert names(tone(-90.0, 1.0, 0.0)) == [], "the blue of magenta is nobody's"


def test_white_glare_on_blue_water_is_not_red() -> None:
    """What is burnt white has more red than the water around it; a red thing burns out to yellow, not to pink."""
    assert "red" not in names(tone(-10.0, 0.88, -0.75, burnt=0.95))
    assert "red" in names(tone(-10.0, 0.88, -0.75))


def test_a_strong_colour_without_red_is_green_a_weak_one_may_be_a_far_yellow() -> None:
    assert names(tone(55.0, 1.1, -2.1)) == ["green"]
    assert names(tone(55.0, 1.2, -1.6)) == ["yellow"]
    assert names(tone(55.0, 0.6, -2.5)) == ["yellow"]


BEYOND = {"orange": (0.15, 1.2, 4.0), "yellow": (0.3, 3.0, 3.5)}  # blue green red light of balls that burn out
WATER = (0.40, 0.35, 0.04)


@pytest.mark.parametrize("colour", BEYOND)
def test_the_rim_of_a_burnt_out_ball_tells_its_colour(colour: str) -> None:
    """In the middle red and green are at their limit alike; blur mixes the rim with water, and there both are seen."""
    centre_px, radius_px = (320.0, 240.0), 25.0
    rows, columns = np.mgrid[:480, :640]
    inside = ((columns - centre_px[0]) ** 2 + (rows - centre_px[1]) ** 2 < radius_px**2)[..., None]
    picture = exposed(expose(defocus(np.where(inside, BEYOND[colour], WATER).astype(np.float64), 4.0), 3))
    turn = np.linspace(0.0, 2.0 * np.pi, 96, endpoint=False)
    ring = np.array(centre_px) + radius_px * np.column_stack([np.cos(turn), np.sin(turn)])
    found = patch(picture, ring, np.array(centre_px))
    assert found is not None and found.tone.burnt > 0.9
    assert colour in names(found.tone)


def test_a_picture_with_a_tenth_of_the_light_has_the_same_ball() -> None:
    frame = expose(0.1 * ball_light((0.05, 0.02, 0.8)), 4)
    ball = find_ball(frame, CAMERA)
    assert ball is not None and ball.score > 0.8


def test_what_a_camera_multiplies_afterwards_is_burnt_out_below_white() -> None:
    image = np.full((80, 80, 3), 90, np.uint8)
    cv2.circle(image, (40, 40), 20, (217, 217, 217), -1)
    assert exposed(image).white == 212
