"""A coloured animal among grey things and yellow robots, painted: bluish water, a bent body in two pieces."""

import cv2
import msgspec
import numpy as np
import pytest

from agent.core.config import ConfigError, Target
from agent.perception.detection.detectors import (
    CreatureDetector,
    creature_hues,
    find_creature,
    named_hues,
    sampled_hues,
)

ORANGE, CREAM, YELLOW = (70, 120, 205), (200, 205, 205), (60, 190, 195)  # blue green red
AT = (200, 180, 340, 240)


def water(seed=1):
    rng = np.random.default_rng(seed)
    shade = np.linspace(1.0, 0.7, 480)[:, None, None] * np.array((170.0, 168.0, 140.0))  # farther is bluer
    shade = shade + rng.normal(0, 3, (480, 640, 3))
    image = np.clip(shade, 0, 255).astype(np.uint8)
    cv2.rectangle(image, (40, 300), (140, 400), (235, 235, 228), -1)
    cv2.rectangle(image, (60, 320), (120, 380), (60, 62, 55), -1)  # a tag
    cv2.circle(image, (560, 400), 70, (120, 124, 122), -1)  # a near stone
    return image


def fish(image, at=AT):
    x0, y0, x1, y1 = at
    middle, half = ((x0 + x1) // 2, (y0 + y1) // 2), ((x1 - x0) // 2, (y1 - y0) // 2)
    cv2.ellipse(image, middle, half, 0, 0, 360, ORANGE, -1)
    cv2.rectangle(image, (middle[0] - 14, y0), (middle[0] + 14, y1), CREAM, -1)  # a blotch across
    return cv2.GaussianBlur(image, (0, 0), 1.5)


def test_its_box_is_around_both_of_its_pieces():
    found = find_creature(fish(water()), named_hues("orange"))
    assert (found.x0, found.y0, found.x1, found.y1) == pytest.approx(AT, abs=5)


def test_neither_water_nor_stones_nor_tags_nor_robots_are_one():
    image = water()
    assert find_creature(image, named_hues("orange")) is None
    cv2.ellipse(image, (320, 200), (150, 60), 0, 0, 360, YELLOW, -1)
    assert find_creature(image, named_hues("orange")) is None
    assert find_creature(image, named_hues("yellow")) is not None


def test_beside_a_robot_that_fills_a_third_of_the_picture_it_is_still_found():
    image = water()
    cv2.ellipse(image, (480, 200), (160, 150), 0, 0, 360, YELLOW, -1)
    found = find_creature(fish(image), named_hues("orange"))
    assert (found.x0, found.x1) == pytest.approx((AT[0], AT[2]), abs=6)


def test_a_sample_of_it_finds_it_in_other_light():
    hues = sampled_hues(fish(water()), (AT[0], AT[1], AT[2] - AT[0], AT[3] - AT[1]))
    darker = (fish(water(2), (60, 60, 160, 110)) * 0.6).astype(np.uint8)
    found = find_creature(darker, hues)
    assert (found.x0, found.y0) == pytest.approx((60, 60), abs=5)
    assert sampled_hues(water(), (60, 320, 60, 60)) is None


def test_a_grey_sample_is_refused_with_a_remedy(tmp_path):
    path = tmp_path / "fish.png"
    cv2.imwrite(str(path), water())
    target = Target(detector="creature", picture=str(path), box=(60.0, 320.0, 60.0, 60.0))
    with pytest.raises(ConfigError, match=r'as grey as the rest.*detector = "box"'):
        creature_hues("fish", target, (640, 480))
    assert creature_hues("fish", msgspec.structs.replace(target, picture=None, box=None), (640, 480)) == named_hues(
        "red"
    )


def test_a_part_of_a_frame_is_placed_in_the_whole():
    found = CreatureDetector(named_hues("orange")).find(fish(water())[100:400, 100:500], (100, 100))
    assert found.centre_px == pytest.approx(((AT[0] + AT[2]) / 2, (AT[1] + AT[3]) / 2), abs=4)
    assert found.radius_px is None and 0.5 <= found.score <= 1.0
