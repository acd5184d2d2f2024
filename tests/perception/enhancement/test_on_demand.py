from typing import NamedTuple

import numpy as np

from agent.perception.enhancement.enhance import DUE_NS, OLD_NS, SHARE, Colours, Enhancer, OnDemandEnhancer
from hw.camera.camera import Frame, Roi

WHOLE = (64, 48)
IMAGE = np.full((48, 64, 3), 60, np.uint8)
PART = Roi(16, 8, 24, 16)


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


def doubling(clock, cost_s=0.04):
    """An estimate that takes `cost_s` and doubles all values."""
    affine = np.zeros((3, 4, 3, 4), np.float32)
    affine[..., :3] = 2 * np.eye(3)

    def estimate(image):
        clock.now_s += cost_s
        return Colours(affine, (image.shape[1], image.shape[0]))

    return Enhancer("fast", lambda image: image, estimate)


ALL = Roi(0, 0, *WHOLE)


def frame(t_ns, roi=ALL):
    return Frame(t_ns, 0, IMAGE[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width], roi)


def test_parts_of_later_frames_use_the_colours_of_a_whole_one():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    assert (enhancer.view(frame(0), WHOLE) == 120).all()
    spent_s = clock.now_s
    assert (enhancer.view(frame(DUE_NS * 4, PART), WHOLE) == 120).all()
    assert enhancer.view(frame(DUE_NS * 4, PART), WHOLE).shape == (16, 24, 3)
    assert clock.now_s == spent_s
    assert (enhancer.frames, enhancer.raw) == (3, 0)


def test_without_young_colours_a_frame_is_raw_and_counted():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    assert (enhancer.view(frame(0, PART), WHOLE) == 60).all()
    enhancer.view(frame(1), WHOLE)
    assert (enhancer.view(frame(OLD_NS + 2, PART), WHOLE) == 60).all()
    assert (enhancer.frames, enhancer.raw) == (3, 2)


def test_estimates_keep_to_their_share_of_a_core():
    """An estimate of a second on a busy machine: the next one is made when four have passed."""
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock, 1.0), clock)
    spent_s, started_s = 0.0, clock.now_s
    for k in range(200):
        before_s = clock.now_s
        enhancer.view(frame(k * DUE_NS), WHOLE)
        spent_s += clock.now_s - before_s
        clock.now_s += DUE_NS / 1e9
    assert 0 < spent_s <= SHARE * (clock.now_s - started_s) + 1.0
    assert enhancer.raw < 150


def test_the_classic_way_needs_no_estimate():
    enhancer = OnDemandEnhancer(Enhancer("classic", lambda image: image + 1))
    assert (enhancer.view(frame(0, PART), WHOLE) == 61).all()
    assert enhancer.raw == 0 and not enhancer.wants_whole(0)


def test_one_frame_for_two_targets_counts_once():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    one = frame(0)
    assert enhancer.view(one, WHOLE) is enhancer.view(one, WHOLE)
    assert enhancer.frames == 1


class Seen(NamedTuple):
    value: int
    score: float


def seen_from(least, score):
    """Finds something in pictures of at least this brightness."""
    return lambda image: Seen(int(image[0, 0, 0]), score) if image[0, 0, 0] >= least else None


def test_what_the_raw_frame_shows_costs_nothing():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    assert enhancer.look(seen_from(50, 0.1), frame(0), WHOLE) == (60, 0.1)
    assert clock.now_s == 100.0 and not enhancer.wants_whole(2 * OLD_NS)


def test_what_it_does_not_show_is_looked_for_in_the_enhanced_one():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    assert enhancer.look(seen_from(100, 0.1), frame(0), WHOLE) == (120, 0.1)
    assert enhancer.look(seen_from(200, 1.0), frame(2), WHOLE) is None


def test_whole_frames_are_wanted_while_colours_are_needed_and_old():
    clock = Clock()
    enhancer = OnDemandEnhancer(doubling(clock), clock)
    enhancer.look(seen_from(100, 1.0), frame(0), WHOLE)
    assert enhancer.wants_whole(OLD_NS) and not enhancer.wants_whole(2)
    enhancer.look(seen_from(50, 1.0), frame(OLD_NS), WHOLE)
    assert not enhancer.wants_whole(OLD_NS)
