"""Balls of two colours that one search would take for the other, as they are or in other light."""

import itertools
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from agent.core.config import Colour, ConfigError, Fleet, Pose, Robot, Target
from agent.ground.check_files import target_findings
from agent.perception.detection.colour import NAMED, Sample, sampled
from agent.perception.detection.detectors import (
    CreatureDetector,
    Sought,
    colours_too_alike,
    creature_hues,
    find_creature,
    load_detectors,
    mistaken_in,
    named_hues,
    named_paint,
    sampled_hues,
)
from agent.robot.fleet_reader import ALIKE
from tests.perception.painted import CAMERA, ball_light, expose

WATER = (120, 95, 60)  # blue, green, red
ORANGE, AMBER, YELLOW, GREEN = (40, 95, 235), (40, 140, 235), (40, 210, 235), (40, 210, 60)
DULL_RED = (30, 20, 80)


def painted(paint: tuple[int, int, int]) -> Sought:
    sample = Sample(np.full((9, 3), paint, np.uint8), np.full((9, 3), WATER, np.uint8))
    model = sampled(sample)
    assert model is not None
    return Sought(model, sample)


def test_of_named_colours_those_are_alike_that_a_fleet_may_not_have_both() -> None:
    for one, other in itertools.combinations(NAMED, 2):
        paints = [Sought(NAMED[colour], named_paint(NAMED[colour])) for colour in (one, other)]
        assert (mistaken_in(*paints) is not None) == (other in ALIKE.get(one, ()))


@pytest.mark.parametrize(
    ("one", "other", "light"),
    [
        (ORANGE, AMBER, "as it is"),  # 11 degrees of hue
        (ORANGE, DULL_RED, "gamma 1.4"),  # 28 degrees, 3 beyond what a sample's search takes
        (ORANGE, GREEN, None),
        (YELLOW, GREEN, None),
    ],
)
def test_two_samples(one, other, light: str | None) -> None:
    assert mistaken_in(painted(one), painted(other)) == light
    assert mistaken_in(painted(other), painted(one)) == light


@pytest.mark.parametrize(("name", "paint", "alike"), [("red", ORANGE, True), ("green", ORANGE, False)])
def test_a_sample_beside_a_name(name: Colour, paint, alike: bool) -> None:
    named = Sought(NAMED[name], named_paint(NAMED[name]))
    assert (mistaken_in(named, painted(paint)) is not None) == alike


def two_targets(folder: Path, paint: tuple[int, int, int], colour: Colour) -> Fleet:
    image = np.full((480, 640, 3), WATER, np.uint8)
    cv2.circle(image, (320, 240), 60, paint, -1)
    path = folder / "buoy.png"
    cv2.imwrite(str(path), image)
    shown = Target(radius_m=0.07, picture=str(path), box=(300.0, 220.0, 40.0, 40.0))
    return Fleet(fleet="t", target={"ball": Target(colour=colour, radius_m=0.07), "buoy": shown}, robot={})


def test_the_check_says_so_in_one_line(tmp_path: Path) -> None:
    fleet = two_targets(tmp_path, ORANGE, "red")
    (said,) = (finding for finding in target_findings(fleet) if finding.level == "warning")
    assert said.text == next(colours_too_alike(fleet))
    assert "'ball' and 'buoy'" in said.text and "\n" not in said.text


def test_nothing_is_said_of_colours_that_are_far_apart(tmp_path: Path) -> None:
    assert [finding.level for finding in target_findings(two_targets(tmp_path, ORANGE, "green"))] == ["ok"]


def test_a_sample_that_cannot_be_read_is_one_finding(tmp_path: Path) -> None:
    fleet = two_targets(tmp_path, WATER, "red")
    (said,) = target_findings(fleet)
    assert said.level == "wrong" and "grey" in said.text


# --- creature ---
# A coloured animal among grey things and yellow robots, painted: bluish water, a bent body in two pieces.

CREATURE_ORANGE, CREAM, CREATURE_YELLOW = (70, 120, 205), (200, 205, 205), (60, 190, 195)  # blue green red
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
    cv2.ellipse(image, middle, half, 0, 0, 360, CREATURE_ORANGE, -1)
    cv2.rectangle(image, (middle[0] - 14, y0), (middle[0] + 14, y1), CREAM, -1)  # a blotch across
    return cv2.GaussianBlur(image, (0, 0), 1.5)


def test_its_box_is_around_both_of_its_pieces():
    found = find_creature(fish(water()), named_hues("orange"))
    assert (found.x0, found.y0, found.x1, found.y1) == pytest.approx(AT, abs=5)


def test_neither_water_nor_stones_nor_tags_nor_robots_are_one():
    image = water()
    assert find_creature(image, named_hues("orange")) is None
    cv2.ellipse(image, (320, 200), (150, 60), 0, 0, 360, CREATURE_YELLOW, -1)
    assert find_creature(image, named_hues("orange")) is None
    assert find_creature(image, named_hues("yellow")) is not None


def test_beside_a_robot_that_fills_a_third_of_the_picture_it_is_still_found():
    image = water()
    cv2.ellipse(image, (480, 200), (160, 150), 0, 0, 360, CREATURE_YELLOW, -1)
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


# --- sampled target ---
# A ball target whose colour a picture shows, from the fleet file to the detector.

BLUE = expose(ball_light((0.0, 0.0, 0.8))[..., ::-1], 4)
RED = expose(ball_light((0.0, 0.0, 0.8)), 4)


def fleet(picture, box):
    robot = Robot(listen="tcp/h:1", serial="s", camera="c", calibration="k", pose=Pose(x_m=0.1, y_m=0.1, yaw_deg=0.0))
    return Fleet(fleet="t", target={"ball": Target(radius_m=0.07, picture=picture, box=box)}, robot={"r1": robot})


def test_a_sample_from_a_picture_tells_the_ball_from_others(tmp_path):
    path = tmp_path / "buoy.png"
    cv2.imwrite(str(path), BLUE)
    detector = load_detectors(fleet(str(path), (300.0, 220.0, 40.0, 40.0)), CAMERA)["ball"]
    found = detector.find(BLUE)
    assert found is not None and found.radius_sigma_px is not None and found.radius_sigma_px > 0.0
    assert detector.find(RED) is None


@pytest.mark.parametrize(("box", "why"), [((5.0, 5.0, 40.0, 40.0), "grey"), ((900.0, 5.0, 40.0, 40.0), "outside")])
def test_a_box_without_a_colour_is_refused(tmp_path, box, why):
    path = tmp_path / "buoy.png"
    cv2.imwrite(str(path), np.asarray(BLUE))
    with pytest.raises(ConfigError, match=why):
        load_detectors(fleet(str(path), box), CAMERA)
