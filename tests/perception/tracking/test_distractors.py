"""Two things that are alike meet and part: each goes on as it went; a look-alike is in one place at a time."""

import pytest

from agent.perception.tracking.appearance import Box
from agent.perception.tracking.distractors import (
    APART,
    KEPT,
    LookAlike,
    Meeting,
    Motion,
    Seen,
    followed,
    merged,
    unexplained,
)


def at(u, v=100.0):
    return Box(u - 20, v - 20, 40, 40)


def moving(u, step):
    return Motion(at(u), (step, 0.0))


@pytest.mark.parametrize("step", [3.0, -3.0])
def test_what_passes_one_that_stays_is_where_it_would_have_got_to(step):
    meeting = Meeting(moving(100, step), moving(100 + 10 * step, 0.0), frames=24)
    assert meeting.parted([at(100 + 24 * step), at(100 + 10 * step)]) == (at(100 + 24 * step), at(100 + 10 * step))


def test_what_turns_back_before_one_that_stays_is_not_that_one():
    meeting = Meeting(moving(100, 3.0), moving(130, 0.0), frames=12)
    mine, its = meeting.parted([at(131), at(80)])
    assert (mine, its) == (at(80), at(131))


def test_two_that_cross_go_on():
    meeting = Meeting(moving(100, 3.0), moving(150, -3.0), frames=30)
    assert meeting.parted([at(60), at(190)]) == (at(190), at(60))


def test_while_one_place_is_seen_nobody_can_tell_and_two_that_stay_unclear_are_read_in_the_end():
    still = Meeting(moving(100, 0.0), moving(110, 0.0), frames=20)
    assert still.parted([at(104)]) is None
    assert still.parted([at(60), at(150)]) is not None  # each is nearer to its own place
    across = [at(105, 60), at(105, 140)]
    assert still.parted(across) is None
    for _ in range(APART):
        still = still.next(apart=True)
    assert still.parted(across) is not None


def test_a_look_alike_explains_one_place_and_what_hides_explains_all_that_it_can_have_reached():
    other = LookAlike(Motion(at(100)), like=0.9)
    near, far = Seen(at(104), 0.9), Seen(at(60), 0.9)
    assert unexplained([other], [near, far]) == [far.box]
    hidden = followed([other], [])
    for _ in range(10):
        hidden = followed(hidden, [])
    assert unexplained(hidden, [far]) == []
    for _ in range(KEPT):
        hidden = followed(hidden, [])
    assert unexplained(hidden, [far]) == [far.box]


def test_what_is_suddenly_much_more_like_the_thing_is_no_look_alike():
    dim = LookAlike(Motion(at(100)), like=0.45)
    assert unexplained([dim], [Seen(at(102), 0.6)]) == []
    assert unexplained([dim], [Seen(at(102), 0.9)]) == [at(102)]


def test_only_one_that_was_seen_for_some_frames_is_met():
    glimpse = followed([LookAlike(Motion(at(100)), 0.9)], [])
    assert merged(glimpse, at(102), 0.8) is None
    others = [LookAlike(Motion(at(100)), 0.9)]
    for _ in range(3):
        others = followed(others, [Seen(at(100), 0.9)])
    assert merged(others, at(100), 0.8) is None  # it is still seen
    assert merged(followed(others, []), at(102), 0.8) is not None
    assert merged(followed(others, []), at(150), 0.8) is None


def test_one_that_is_less_like_the_thing_cannot_be_mistaken_for_it():
    dim = [LookAlike(Motion(at(100), unseen=1), like=0.4, seen=5)]
    assert merged(dim, at(102), 0.8) is None
    assert merged(dim, at(102), 0.4) is not None


def test_a_look_alike_that_turns_to_look_like_the_thing_stays_that_look_alike():
    others = [LookAlike(Motion(at(100)), like=0.40)]
    for k in range(1, 5):
        place = Seen(at(100 + k), 0.40 + 0.1 * k)
        assert unexplained(others, [place]) == []
        others = followed(others, [place])
