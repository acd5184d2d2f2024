"""Where a robot turns its camera to find itself."""

from itertools import pairwise

import pytest
from msgspec.structs import replace

from agent.capabilities.swim.landmarks import SEARCH_DEG, WAIT_NS, Glance, Sure, facing, markers
from agent.core.attitude import Attitude
from agent.core.config import Body, Landmarks, Pose, Tag

SURFACE_M, LEVEL = 0.5, Attitude(0.3, 0.0, 0.0)  # 0.2 m above the floor
HERE = Pose(x_m=1.0, y_m=1.0, yaw_deg=0.0)
BODY = Body(camera_m=(0.0, 0.0, 0.0), pan_limit_deg=(-80.0, 80.0))
MS, KNOWN = 1_000_000, Sure(0.0, 0.0)


def on_wall(number, y_m, face="x1", x_m=2.5):
    return Tag(id=number, face=face, position_m=(x_m, y_m, 0.2))


def glance(*tags, body=BODY):
    return Glance(markers(Landmarks(size_m=0.08, tag=tags)).values(), body, SURFACE_M, half_deg=14.0)


def ways(of, count, pose=HERE, sure=KNOWN):
    """What it looks at, one after the other, with a gimbal that takes as long to turn as it is waited for."""
    found, now_ns = [of.direction_deg(pose, sure, LEVEL, True, 0)], 0
    while len(found) < count:
        for steady in (False, True, True):
            now_ns += WAIT_NS
            way = of.direction_deg(pose, sure, LEVEL, steady, now_ns)
        found.append(way)
    return found


TWO = on_wall(1, 1.9), on_wall(2, 2.1)  # 31 and 36 degrees to the left
ALONE = on_wall(0, 0.5)  # nearer, to the right
LEFT, RIGHT = pytest.approx((30.96, 0.0), abs=0.01), pytest.approx((-18.43, 0.0), abs=0.01)


def test_where_most_landmarks_are_first_and_after_the_wait_where_others_are() -> None:
    of = glance(*TWO, ALONE)
    assert ways(of, 4) == [LEFT, RIGHT, LEFT, RIGHT]  # the other of the two was seen beside the first


def test_of_two_the_one_that_murky_water_leaves_first() -> None:
    near, far = on_wall(5, 0.5), on_wall(4, 1.9)
    assert ways(glance(far, near), 2) == [RIGHT, LEFT]


def test_who_hardly_knows_its_yaw_looks_to_where_it_can_hardly_miss() -> None:
    """One landmark straight ahead and near, or four in a row from 20 to 40 degrees to the left."""
    row = [on_wall(k, 1.0 + 1.5 * tan) for k, tan in enumerate((0.38, 0.52, 0.67, 0.83))]
    of = glance(on_wall(9, 1.0, x_m=1.45), *row)
    (sure,), (unsure,) = ways(of, 1), ways(glance(on_wall(9, 1.0, x_m=1.45), *row), 1, sure=Sure(0.1, 12.0))
    assert sure == pytest.approx((0.0, 0.0)) and 25.0 < unsure[0] < 40.0


def test_the_wait_counts_from_when_the_gimbal_rests_and_the_way_stays_the_same() -> None:
    of, moved = glance(*TWO, ALONE), replace(HERE, x_m=1.05, yaw_deg=2.0)
    assert of.direction_deg(HERE, KNOWN, LEVEL, False, 0) == LEFT
    assert of.direction_deg(moved, KNOWN, LEVEL, False, 5000 * MS) == LEFT
    assert of.direction_deg(moved, KNOWN, LEVEL, True, 5100 * MS) == LEFT  # at rest from now on
    assert of.direction_deg(moved, KNOWN, LEVEL, True, 5100 * MS + WAIT_NS - 1) == LEFT
    assert of.direction_deg(HERE, KNOWN, LEVEL, True, 5100 * MS + WAIT_NS) == RIGHT
    of.reset()
    assert of.direction_deg(HERE, KNOWN, LEVEL, True, 9000 * MS) == LEFT


def test_a_look_whose_frames_show_none_is_over_at_once_and_one_that_showed_some_lasts() -> None:
    """Who is lost with its thrusters off drifts while it looks where nothing is."""
    for shown, then in (((False, False), RIGHT), ((False, True, False), LEFT)):
        of = glance(*TWO, ALONE)
        assert of.direction_deg(HERE, KNOWN, LEVEL, True, 0) == LEFT
        of.add_frame(shows=shown[0])
        assert of.direction_deg(HERE, KNOWN, LEVEL, True, 100 * MS) == LEFT  # one frame may be a blurred one
        for shows in shown[1:]:
            of.add_frame(shows)
        assert of.direction_deg(HERE, KNOWN, LEVEL, True, 200 * MS) == then
        of.add_frame(shows=False)  # the first one of the next look says nothing of it yet
        assert of.direction_deg(HERE, KNOWN, LEVEL, True, 300 * MS) == then


UNREACHABLE = {
    "behind": on_wall(9, 1.0, "x0", 0.0),
    "beyond the gimbal's pan": Tag(id=9, face="y1", position_m=(0.9, 2.0, 0.2)),
    "beyond its tilt": Tag(id=9, face="floor", position_m=(1.05, 1.05, 0.0)),
    "too far": on_wall(9, 1.0, x_m=3.1),
    "too near to be in the picture as a whole": on_wall(9, 1.0, x_m=1.2),
    "at a glance": Tag(id=9, face="y1", position_m=(2.2, 1.3, 0.2)),
    "from behind": on_wall(9, 1.0, "x0", 2.0),
}


@pytest.mark.parametrize("why", UNREACHABLE)
def test_what_cannot_be_seen_is_not_looked_at(why) -> None:
    assert set(ways(glance(*TWO, UNREACHABLE[why]), 4)) == set(ways(glance(*TWO), 4))
    assert ways(glance(UNREACHABLE[why]), 3) == list(SEARCH_DEG[:3])  # then all around


def test_who_knows_nothing_looks_all_around_over_and_over() -> None:
    of = glance(*TWO)
    assert ways(of, len(SEARCH_DEG) + 1, pose=None) == [*SEARCH_DEG, SEARCH_DEG[0]]
    pans = sorted({pan for pan, _ in SEARCH_DEG})
    assert all(b - a <= 30.0 for a, b in pairwise(pans))  # a picture is 38 degrees wide
    lowest, highest = Body().pan_limit_deg
    assert pans[0] - 5.0 <= lowest and pans[-1] + 5.0 >= highest


def test_who_finds_out_where_it_is_begins_with_the_best_way() -> None:
    of = glance(*TWO, ALONE)
    *_, last = ways(of, 3, pose=None)
    assert ways(of, 2) == [last, LEFT]  # once it has looked there for long enough


def test_a_landmark_faces_the_water() -> None:
    (marker,) = markers(Landmarks(size_m=0.08, tag=(on_wall(1, 1.0),))).values()
    assert facing(marker, (1.5, 1.0, 0.2)) == pytest.approx(1.0)
    assert facing(marker, (1.5, 2.0, 0.2)) == pytest.approx(0.5**0.5)
    assert facing(marker, (3.5, 1.0, 0.2)) == pytest.approx(-1.0)
    (floor,) = markers(Landmarks(size_m=0.08, tag=(Tag(id=1, face="floor", position_m=(1.0, 1.0, 0.0)),))).values()
    assert facing(floor, (1.0, 1.0, 0.4)) == pytest.approx(1.0)
