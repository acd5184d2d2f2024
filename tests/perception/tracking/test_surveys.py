"""What a place has to surpass to be taken for a lost thing: what else was like it, unless that is still there."""

import pytest

from agent.perception.tracking.appearance import Box
from agent.perception.tracking.distractors import CLUTTER_KEPT, EVERY, Seen, Surveys
from agent.perception.tracking.follow import FOLLOWED, Follower, load_box_tracker
from tests.perception.tracking.test_appearance import RED, around, picture, water

__all__ = ["water"]  # the fixture


def at(u):
    return Box(u - 20, 80, 40, 40)


def test_clutter_that_comes_and_goes_has_to_be_surpassed_and_what_is_still_there_has_not():
    surveys = Surveys()
    assert surveys.surpass(0, []) == 0.0
    surveys.add(0, [Seen(at(50), 0.65), Seen(at(400), 0.9)])
    assert surveys.surpass(1, [Seen(at(400), 0.88)]) == pytest.approx(0.65)
    assert surveys.surpass(1, [Seen(at(400), 0.7)]) == pytest.approx(0.9)  # it is another that is there now
    assert surveys.surpass(1, [Seen(at(402), 0.9), Seen(at(52), 0.6)]) == 0.0
    for k in range(CLUTTER_KEPT):
        surveys.add(EVERY * (k + 1), [])
    assert surveys.surpass(EVERY * CLUTTER_KEPT, []) == 0.0


def test_what_was_out_of_reach_when_it_was_lost_is_not_what_was_lost(water):
    """It goes from one frame to the next; what stands a little farther away than it can have got to is another."""
    dull = (60, 60, 150)  # like it, but not so much that it is known as its look-alike before
    frames = [picture(water, *([(120, 90, RED)] if k < 6 else []), (150, 92, dull), seed=k) for k in range(12)]
    follower = Follower(load_box_tracker(None))
    follower.start(frames[0], around(120, 90))
    seen = [follower.look(frame) for frame in frames[1:]]
    assert all(now.state == "followed" for now in seen[:5])
    assert not any(now.state in FOLLOWED for now in seen[5:])
