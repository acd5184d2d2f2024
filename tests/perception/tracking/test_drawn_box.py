"""A box that somebody draws in a frame that was shown: vision looks for what is in it from the next frame on."""

import cv2
import numpy as np

from agent.perception.detection.detectors import BoxDetector
from agent.perception.tracking.appearance import Box
from agent.perception.tracking.follow import Follower, load_box_tracker
from tests.perception.tracking.swimming import overlap

RED, YELLOW, RADIUS = (40, 40, 190), (40, 170, 190), 14  # blue green red


def picture(red, yellow, seed: int) -> np.ndarray:
    """Two balls on water, and the noise of a camera."""
    image = np.full((180, 240, 3), (130, 110, 30), np.uint8)
    for (u, v), colour in ((red, RED), (yellow, YELLOW)):
        cv2.circle(image, (u, v), RADIUS, colour, -1, cv2.LINE_AA)
        cv2.circle(image, (u - 4, v - 5), 4, (230, 230, 230), -1, cv2.LINE_AA)
    noise = np.random.default_rng(seed).normal(0, 3, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def around(u: int, v: int) -> Box:
    return Box(u - RADIUS, v - RADIUS, 2 * RADIUS, 2 * RADIUS)


def test_it_changes_over_to_what_was_drawn_though_that_has_moved_meanwhile() -> None:
    follower = Follower(load_box_tracker(None, None))
    follower.expect(picture((120, 90), (50, 50), 0), around(120, 90))
    detector = BoxDetector(follower)
    red, yellow = (120, 90), (50, 50)
    for seed in range(1, 5):
        found = detector.find(picture(red, yellow, seed))
        assert found is not None and overlap(found.box, around(*red)) > 0.6
    shown = picture(red, yellow, 5)
    moved = (70, 110)
    detector.expect(shown, around(*yellow))
    for seed in range(6, 10):
        found = detector.find(picture(red, moved, seed))
        assert found is not None and overlap(found.box, around(*moved)) > 0.6
