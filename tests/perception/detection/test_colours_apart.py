"""Balls of two colours that one search would take for the other, as they are or in other light."""

import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest

from agent.core.config import Colour, Fleet, Target
from agent.ground.check_files import target_findings
from agent.perception.detection.colour import NAMED, Sample, sampled
from agent.perception.detection.detectors import Sought, colours_too_alike, mistaken_in, named_paint
from agent.robot.fleet_reader import ALIKE

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
