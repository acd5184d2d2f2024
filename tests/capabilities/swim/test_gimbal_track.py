"""The track at a target that swims: still while it is seen, then over all places where it may be."""

import math

import numpy as np
import pytest

from agent.capabilities.swim.pursuit import (
    LOST_NS,
    PERIOD_S,
    SIGMAS,
    SWIFTEST_DEG_S,
    GimbalTrack,
    across,
    own_part,
    triangle,
)

S, START_NS = 1_000_000_000, 10**18


def test_the_triangle() -> None:
    assert [triangle(k / 8) for k in range(9)] == pytest.approx([0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0])
    assert triangle(3.25) == triangle(0.25)


def swings(half_deg: float, seconds: float) -> list[float]:
    """Each step of 50 ms after it was lost."""
    track, found = GimbalTrack(0.0), []
    track.saw(START_NS)
    for step in range(round((seconds + LOST_NS * 1e-9) * 20)):
        now_ns = START_NS + step * S // 20
        unseen_s, swing = track.unseen_s(now_ns), track.swing(half_deg, now_ns)
        assert unseen_s == pytest.approx(max(step / 20 - LOST_NS * 1e-9, 0.0)) and (unseen_s or not swing)
        found.append(swing)
    return found[round(LOST_NS * 2e-8) :]


def test_it_goes_to_and_fro_and_no_faster_than_frames_and_tags_allow() -> None:
    narrow, wide = swings(15.0, PERIOD_S), swings(60.0, 4.0)
    assert max(narrow) == pytest.approx(1.0, abs=0.1) and min(narrow) == pytest.approx(-1.0, abs=0.1)
    assert max(np.abs(np.diff(wide))) * 60.0 * 20.0 == pytest.approx(SWIFTEST_DEG_S)
    assert max(wide) == pytest.approx(1.0, abs=0.1) and min(wide) == pytest.approx(-1.0, abs=0.1)


def test_how_long_it_was_lost_counts_anew_after_a_look_elsewhere() -> None:
    track = GimbalTrack(0.25)
    track.saw(START_NS)
    track.swing(15.0, START_NS)
    track.saw(START_NS - S)
    assert track.sees(START_NS + LOST_NS), "an older frame that comes later says nothing new"
    assert not track.sees(START_NS + S)
    assert track.unseen_s(START_NS + 3 * S) == 0.0, "the camera was elsewhere meanwhile"


def test_where_it_may_be_is_the_line_of_sight_of_the_one_that_sees_it() -> None:
    """Seen by another along x: from the side it may be anywhere on that line, nearer or farther to the left."""
    along, aside = 0.5, 0.01
    line = (along**2, 0.0, 0.0, aside**2, 0.0, 0.02**2)
    step_m, sigma_deg = across((2.0, 1.0, 0.25), line, (2.0, 0.2, 0.3))
    assert step_m == pytest.approx((-along, 0.0, 0.0)) and sigma_deg == pytest.approx(
        math.degrees(math.atan2(along, 0.8))
    )
    step_m, sigma_deg = across((2.0, 1.0, 0.25), line, (0.5, 1.0, 0.3))
    assert np.hypot(*step_m[:2]) == pytest.approx(aside) and sigma_deg < 1.0, (
        "along the line there is nothing to search"
    )


def test_each_takes_the_places_that_are_nearer_to_it() -> None:
    """Two at either end of the line share it in its middle, and a third behind one of them takes nothing of it."""
    at_m, step_m, left, right = (1.5, 1.0, 0.25), (0.4, 0.0, 0.0), (0.7, 0.2), (2.3, 0.2)
    assert own_part(at_m, step_m, left, (right,)) == pytest.approx((-SIGMAS, 0.0))
    assert own_part(at_m, step_m, right, (left,)) == pytest.approx((0.0, SIGMAS))
    assert own_part(at_m, step_m, left, ()) == (-SIGMAS, SIGMAS)
    behind = left[0], left[1] - 0.5
    assert own_part(at_m, step_m, behind, (left, right)) == (-SIGMAS, SIGMAS), "who has no part looks at all"
    rng = np.random.default_rng(1)
    for _ in range(100):
        robots = rng.uniform((0.0, 0.0), (3.0, 2.0), (3, 2)).tolist()
        for s in rng.uniform(-SIGMAS, SIGMAS, 5):
            place = np.array(at_m[:2]) + s * np.array(step_m[:2])
            k = int(np.argmin([math.dist(place, robot) for robot in robots]))
            low, high = own_part(at_m, step_m, robots[k], [other for other in robots if other is not robots[k]])
            assert low <= s <= high
