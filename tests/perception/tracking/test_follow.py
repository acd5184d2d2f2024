"""A thing in a box is followed, known to be gone when it is gone, and found again; with NanoTrack where it is there."""

import hashlib

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.perception.tracking.appearance import Box, likeness, remember, search
from agent.perception.tracking.distractors import Motion
from agent.perception.tracking.follow import FOUND_LIKE, HOLD_SHAPE, SURE_SHAPE, Follower, load_box_tracker
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
    return load_box_tracker(BACKBONE, NECK)


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
        load_box_tracker(tmp_path / "none.onnx", other)
    with pytest.raises(ConfigError, match="both"):
        load_box_tracker(other, None)
    with pytest.raises(ConfigError, match="is not nanotrack_backbone_sim"):
        load_box_tracker(other, other)
