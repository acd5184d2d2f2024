"""A thing in a box is followed, known to be gone when it is gone, and found again; with NanoTrack where it is there."""

import hashlib

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.perception.detection.detectors import BoxDetector
from agent.perception.tracking.appearance import Box, likeness, remember, search
from agent.perception.tracking.distractors import Motion
from agent.perception.tracking.follow import (
    FOUND_LIKE,
    HOLD_SHAPE,
    SURE_SHAPE,
    CorrelationTracker,
    Follower,
    load_box_tracker,
)
from tests.perception.tracking.swimming import clip, overlap
from tests.places import DATA

MODELS = DATA / "models" / "nanotrack_v2"
BACKBONE, NECK = MODELS / "nanotrack_backbone_sim.onnx", MODELS / "nanotrack_head_sim.onnx"


@pytest.fixture
def nano():
    if not BACKBONE.exists():
        pytest.skip("reference data absent")
    for line in (MODELS / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split()
        assert hashlib.sha256((MODELS / name).read_bytes()).hexdigest() == digest, name
    return load_box_tracker((BACKBONE, NECK))


class Scripted:
    """A tracker that follows the truth, then settles on the background as trackers do."""

    def __init__(self, boxes):
        self.boxes, self.starts = list(boxes), []

    def start(self, image, box):
        self.starts.append(box)

    def follow(self, image):
        return Box(*self.boxes.pop(0))

    def learn(self, image, box):
        pass


def test_nanotrack_follows_loses_and_finds_again(nano):
    follower, overlaps, gone = Follower(nano), [], range(30, 45)
    for k, (image, box) in enumerate(clip(75, gone)):
        if k == 0:
            follower.start(image, Box(*box))
            continue
        now = follower.look(image)
        assert now.lost if k in gone else True, k
        if box and not now.lost:
            overlaps.append(overlap(now.box, box))
    assert np.mean(overlaps) > 0.85 and min(overlaps) > 0.6
    assert len(overlaps) > 29 + 15  # all before it went, and most after it came back
    assert not now.lost


def test_a_confident_engine_on_the_wrong_thing_is_not_believed():
    frames = list(clip(12))
    boxes = [box for _, box in frames[1:6]] + [(330, 250, 90, 50)] * 6
    tracker = Scripted(boxes)
    follower = Follower(tracker)
    follower.start(frames[0][0], Box(*frames[0][1]))
    seen = [follower.look(image) for image, _ in frames[1:]]
    assert not any(now.lost for now in seen[:5])
    assert len(tracker.starts) > 1  # begun again where the thing really was
    assert overlap(tracker.starts[1], frames[6][1]) > 0.6


def test_lost_is_said_with_the_last_place_and_no_score():
    frames = list(clip(10, range(5, 10)))
    boxes = [box for _, box in frames[1:5]] + [frames[4][1]] * 5
    follower = Follower(Scripted(boxes))
    follower.start(frames[0][0], Box(*frames[0][1]))
    seen = [follower.look(image) for image, _ in frames[1:]]
    assert [now.state for now in seen] == ["followed"] * 4 + ["lost"] * 5
    assert seen[-1].score == 0.0 and overlap(seen[-1].box, frames[4][1]) > 0.9


def test_a_thing_does_not_jump_or_swell_from_frame_to_frame():
    still = Motion(Box(100, 100, 60, 40))
    assert still.allows(Box(125, 110, 64, 44))
    assert not still.allows(Box(135, 100, 60, 40))
    assert not still.allows(Box(300, 110, 60, 40))
    assert not still.allows(Box(90, 90, 90, 60))


def test_what_moves_goes_on_and_may_be_farther_away_the_longer_nobody_saw_it():
    moving = Motion(Box(100, 100, 60, 40))
    for k in range(1, 20):
        moving = moving.seen(Box(100 + 10 * k, 100, 60, 40))
    assert moving.expected.x == pytest.approx(300, abs=1)
    far = Box(430, 100, 60, 40)
    assert not moving.reaches(far)
    assert moving.missed().missed().missed().missed().reaches(far)


def test_likeness_survives_defocus_and_tells_other_places():
    image, box = next(clip(1))
    looks = remember(image, Box(*box))
    assert likeness(looks, image, Box(*box)).least > SURE_SHAPE
    assert likeness(looks, cv2.GaussianBlur(image, (0, 0), 5), Box(*box)).shape > SURE_SHAPE
    assert likeness(looks, image, Box(300, 200, *box[2:])).shape < HOLD_SHAPE
    (found, like), *others = search(looks, np.roll(image, (40, 120), (0, 1)), Box(*box))
    assert like.least > FOUND_LIKE and overlap(found, (box[0] + 120, box[1] + 40, *box[2:])) > 0.75
    assert all(place.like.least < FOUND_LIKE for place in others)


@pytest.mark.parametrize("box", [(-5, 10, 50, 50), (400, 10, 100, 50), (10, 10, 5, 50)])
def test_a_box_that_cannot_be_followed(box):
    image, _ = next(clip(1))
    with pytest.raises(ConfigError, match="480x360"):
        Follower(Scripted([])).start(image, Box(*box))


def test_network_files_that_are_not_nanotrack(tmp_path):
    other = tmp_path / "other.onnx"
    other.write_bytes(b"no network")
    with pytest.raises(ConfigError, match="no such file"):
        load_box_tracker((tmp_path / "none.onnx", other))
    with pytest.raises(ConfigError, match="is not nanotrack_backbone_sim"):
        load_box_tracker((other, other))


# --- correlation ---
# The filter that follows a box without any file.


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


# --- drawn box ---
# A box that somebody draws in a frame that was shown: vision looks for what is in it from the next frame on.

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
    follower = Follower(load_box_tracker(None))
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
