"""The filter that follows a box without any file."""

import cv2
import numpy as np
import pytest

from agent.perception.tracking.appearance import Box
from agent.perception.tracking.follow import CorrelationTracker
from tests.perception.tracking.swimming import clip, overlap


@pytest.mark.parametrize("blur_px", [0.1, 9.0])
def test_it_does_not_stay_behind_when_the_camera_turns(blur_px):
    """From a thing as large as half the picture, which moves by a fifth of its box from one frame to the next."""
    image, box = next(clip(1))
    frame = cv2.GaussianBlur(cv2.resize(image, None, fx=3.0, fy=3.0), (0, 0), blur_px)
    box = Box(*(3.0 * side for side in box))
    turns = [(0.0, 0.0), *[(0.2, 0.2)] * 3, *[(0.0, 0.0)] * 2, *[(-0.2, -0.15)] * 4, *[(0.0, 0.0)] * 2]
    tracker = CorrelationTracker()
    tracker.start(frame, box)
    x, y = 0.0, 0.0
    for across, down in turns:
        x, y = x + across * box.width, y + down * box.height
        found = tracker.follow(np.roll(frame, (round(y), round(x)), (0, 1)))
    assert abs(found.x - box.x - x) < 0.05 * box.width
    assert abs(found.y - box.y - y) < 0.05 * box.height


def test_its_box_grows_with_the_thing():
    image, box = next(clip(1))
    tracker, scale = CorrelationTracker(), 1.0
    tracker.start(image, Box(*box))
    for _ in range(12):
        scale *= 1.02
        larger = cv2.resize(image, None, fx=scale, fy=scale)[: image.shape[0], : image.shape[1]]
        found = tracker.follow(larger)
        tracker.learn(larger, found)
    assert overlap(found, [scale * side for side in box]) > 0.75  # 0.62 with the size it had


def test_it_is_not_sent_away_from_a_plain_area():
    image = np.zeros((360, 480, 3), np.uint8)
    tracker = CorrelationTracker()
    tracker.start(image, Box(200, 150, 60, 40))
    assert tuple(tracker.follow(image)) == pytest.approx((200, 150, 60, 40), abs=3)
