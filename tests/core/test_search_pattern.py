"""A gaze that goes all around: what it covers, when a look is over, and that it stops where there is something."""

import numpy as np
import pytest

from agent.core.capability import CameraAct, LightView
from agent.core.config import Body
from agent.core.ranging.pointing import FRAMES, SearchPattern, SearchPlan, all_around, spiral, view_deg
from agent.core.step_io import Sighting
from agent.robot.target_search import TargetSearch
from tests.capabilities.swim.swimming_agent import CALIBRATION, CAMERA, fleet
from tests.core.situations import situation

START_NS, STEP_NS = 10**18, 50_000_000
WAYS = ((-60.0, -10.0), (0.0, -10.0), (60.0, -10.0))


@pytest.fixture
def target_search():
    of = fleet()
    target_search = TargetSearch(of, of.robot["r1"], CALIBRATION)
    target_search.search(SearchPlan("ball", (), WAYS))
    return target_search


def look(target_search, found, now_ns):
    """A frame as the gimbal has just arrived, but for its play, and one step."""
    frame = Sighting(t_ns=now_ns, frame=1, target="ball", found=found, centre_px=(320.0, 240.0), radius_px=40.0)
    target_search.add_sighting(frame, LightView())
    return act(target_search, now_ns)


def act(target_search, now_ns):
    return target_search.act(situation(target_search, now_ns), True)


@pytest.mark.parametrize("depth_m, surface_m", [(0.3, 0.6), (0.1, 0.5), (0.3, 0.31)])
def test_every_way_that_the_gimbal_reaches_is_within_a_look(depth_m, surface_m) -> None:
    ways = np.array(all_around(CAMERA, Body(), depth_m, surface_m))
    half = np.array(view_deg(CAMERA)) / 2.0
    lowest, highest = (np.degrees(np.arctan2(z, 0.8)) for z in (depth_m - surface_m, depth_m))
    for at in np.random.default_rng(0).uniform((-90.0, lowest), (90.0, highest), (300, 2)):
        assert (np.abs(ways - at) <= half).all(axis=1).any()
    assert np.abs(np.diff(ways, axis=0)).max() < 2.0 * half.max()  # no way back to the beginning of a row


def test_the_spiral_grows_with_what_is_not_known() -> None:
    small, large = (np.array(spiral(CAMERA, reach)) for reach in (1.0, 60.0))
    assert tuple(small[0]) == (0.0, 0.0) and len(small) < len(large)
    assert np.abs(small).max() < 45.0 and np.abs(large[:, 0]).max() > 50.0
    assert np.abs(np.array(spiral(CAMERA, 1e9))).max() < 130.0


def test_a_look_is_over_after_two_frames_without_the_target_and_before_the_gimbal_rests(target_search) -> None:
    act(target_search, START_NS)
    now_ns, panned = START_NS, []
    for _ in range(4):
        panned.append(round(target_search.gimbal_deg()[0]))
        look(target_search, False, now_ns + STEP_NS)  # on its way: it says nothing
        now_ns = target_search.pointing.nearly_from_ns
        for _ in range(FRAMES):
            assert round(target_search.gimbal_deg()[0]) == panned[-1]
            look(target_search, False, now_ns)
            now_ns += STEP_NS
        assert now_ns < START_NS + 10**12 and target_search.pointing.last_leg_ns > now_ns
    assert panned == [-60, 0, 60, -60]


def test_where_there_is_something_it_stays_and_measures(target_search) -> None:
    act(target_search, START_NS)
    at_us, now_ns = target_search.pointing.goal_us, target_search.pointing.nearly_from_ns
    assert look(target_search, True, now_ns) is None and target_search.view(now_ns).sees("ball")
    assert target_search.pointing.goal_us == at_us
    assert look(target_search, True, target_search.pointing.steady_from_ns) is not None, "a sweep"


def test_after_a_glimpse_it_looks_to_both_sides_once() -> None:
    pattern, order = SearchPattern("ball", (), tuple((float(k), 0.0) for k in range(6))), []
    for _ in range(9):
        pattern.advance()
        order.append(round(pattern.way_deg[0]))
        pattern.add_frame(order[-1] == 2)
        for _ in range(FRAMES):
            pattern.add_frame(False)
    assert order == [0, 1, 2, 1, 2, 3, 4, 5, 0]


def test_to_look_at_landmarks_meanwhile_loses_no_look(target_search) -> None:
    act(target_search, START_NS)
    at_us, now_ns = target_search.pointing.goal_us, START_NS + STEP_NS
    target_search.carry_out(CameraAct((30.0, 5.0)), now_ns)
    act(target_search, now_ns + STEP_NS)
    assert target_search.pointing.goal_us == at_us
