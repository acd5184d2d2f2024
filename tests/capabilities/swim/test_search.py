"""Searching: whose part of the tank is whose, lanes through it, waiting for the camera; one robot in closed loop."""

import itertools
import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.swim.barrier import WALL_M
from agent.capabilities.swim.behaviour import reference, start
from agent.capabilities.swim.search import SEEN_NS, Surroundings, cell, lanes
from agent.capabilities.swim.swim import swimmer_of
from agent.core.config import Look, Pose, Search, Survey, Target
from agent.core.target_state import TargetEstimate
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import PlanarBodies
from agent.experiments.navigation.swimmers import Swimmers
from tests.capabilities.swim.swimming_agent import InTank, fleet

TANK_M, S, LANE_M = (3.0, 2.0), 1_000_000_000, 0.8
WHAT = Search(target="ball", lane_m=LANE_M)
HERE = (0.7, 0.6, 0.3)


def around(**more):
    return Surroundings(TANK_M, 0.25, **more)


def estimate(seen_ns):
    return TargetEstimate((2.0, 1.5, 0.1), (0.0, 0.0, 0.0), (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6), seen_ns)


def to_lane(point, a, b) -> float:
    """Distance of a point from a lane."""
    p, a, b = map(np.array, (point, a, b))
    share = np.clip((p - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(p - a - share * (b - a)))


# --- parts and lanes -----------------------------------------------------------------------------------------------


def test_ends_of_lanes_are_inside_the_walls_and_in_the_robots_own_part() -> None:
    rng = np.random.default_rng(2)
    for _ in range(150):
        places = [tuple(p) for p in rng.uniform((0.22, 0.22), (2.78, 1.78), (3, 2)).tolist()]
        for me in range(3):
            others = [p for k, p in enumerate(places) if k != me]
            for end in lanes(cell(places[me], others, TANK_M), rng.uniform(0.2, 1.5), places[me]):
                assert all(WALL_M < at < side - WALL_M for at, side in zip(end, TANK_M, strict=True))
                assert math.dist(end, places[me]) <= min(math.dist(end, other) for other in others) + 1e-9


def test_three_that_are_spread_have_no_lane_in_common() -> None:
    places = [(0.6, 0.5), (2.4, 0.5), (1.5, 1.6)]
    found = [lanes(cell(me, [p for p in places if p != me], TANK_M), LANE_M, me) for me in places]
    for one, other in itertools.combinations(found, 2):
        assert min(math.dist(a, b) for a in one for b in other) > 0.34


@pytest.mark.parametrize("tank_m", [TANK_M, (1.5, 1.2), (2.0, 4.0)])
def test_from_its_lanes_a_robot_alone_sees_everything_within_half_a_lane(tank_m) -> None:
    ends = lanes(cell((0.5, 0.5), (), tank_m), LANE_M, (0.5, 0.5))
    inner = [(x, y) for x in np.arange(0.22, tank_m[0] - 0.2, 0.1) for y in np.arange(0.22, tank_m[1] - 0.2, 0.1)]
    ways = list(itertools.pairwise(ends)) or [(ends[0], ends[0])]
    assert max(min(to_lane(p, a, b) for a, b in ways) for p in inner) <= 0.5 * LANE_M * math.sqrt(2.0) + 1e-9
    assert math.dist(ends[0], (0.5, 0.5)) == min(math.dist(end, (0.5, 0.5)) for end in ends)


def test_who_has_no_part_stays_where_it_is() -> None:
    assert lanes((), LANE_M, (1.0, 1.0)) == ()
    to, _ = reference(WHAT, start((0.1, 0.1, 0.0), 0.0, S), (0.1, 0.1, 0.0), S, around(fellows_m=((0.3, 0.3),)))
    assert to.place_m == pytest.approx((0.22, 0.22))


# --- step by step ---------------------------------------------------------------------------------------------------


def test_it_swims_slowly_from_end_to_end_and_then_crosswise() -> None:
    progress, reached, pose = start(HERE, 0.0, S), [], HERE
    for _ in range(16):
        to, progress = reference(WHAT, progress, pose, S, around())
        assert to.most_m_s == WHAT.speed_m_s and not to.done
        reached.append(to.place_m)
        pose = (*to.place_m, to.yaw)
    first, second, third = reached[:4], reached[4:12], reached[12:]
    assert all(a[1] == b[1] for a, b in zip(first[::2], first[1::2], strict=True)), "two lanes along the tank"
    assert all(a[0] == b[0] for a, b in zip(second[::2], second[1::2], strict=True)), "four across it"
    assert set(third) == set(first)


def test_what_swims_is_searched_for_facing_the_middle_of_the_tank() -> None:
    """Whatever way the lane goes: of robots that all face along their lanes, none has what is behind them all."""
    at_yaw = {}
    for x, y in ((0.5, 0.6), (2.5, 0.6), (0.5, 1.5), (2.5, 1.5)):
        to, _ = reference(WHAT, start((x, y, 0.3), 0.0, S), (x, y, 0.3), S, around(swims=True))
        assert to.yaw == pytest.approx(math.atan2(1.0 - y, 1.5 - x))
        at_yaw[x, y] = to.yaw
    to, _ = reference(WHAT, start((1.4, 1.1, 0.3), 0.0, S), (1.4, 1.1, 0.3), S, around(swims=True))
    assert to.yaw == 0.3, "in the middle itself it keeps its yaw"
    rests, _ = reference(WHAT, start((0.5, 0.6, 0.3), 0.0, S), (0.5, 0.6, 0.3), S, around())
    assert abs(rests.yaw - at_yaw[0.5, 0.6]) > 0.1, "what rests is passed by sooner or later"


def test_another_that_searches_takes_its_part_away() -> None:
    _, progress = reference(WHAT, start(HERE, 0.0, S), HERE, S, around())
    alone = progress.hunt.way
    _, progress = reference(WHAT, progress, HERE, S, around(fellows_m=((1.5, 0.6),)))
    assert progress.hunt.way != alone and all(x < 1.1 for x, _ in progress.hunt.way)


def test_it_waits_while_it_sees_something_and_goes_on_when_that_was_nothing() -> None:
    _, progress = reference(WHAT, start(HERE, 0.0, S), HERE, S, around())
    way = progress.hunt.way
    pose = (0.8, 0.6, 1.0)  # it turns, as it sees something
    for now_ns in (2 * S, 3 * S):
        to, progress = reference(WHAT, progress, pose, now_ns, around(sees=True))
        assert to.place_m == pose[:2] and to.yaw == 1.0
        pose = (0.82, 0.6, 1.1)
        assert to.place_m == (0.8, 0.6), "it does not drift along"
        pose = (0.8, 0.6, 1.0)
    to, progress = reference(WHAT, progress, pose, 7 * S, around())
    assert to.place_m == way[0] and progress.hunt.way == way


def test_first_it_looks_where_the_target_was() -> None:
    old = around(target=estimate(S - SEEN_NS), looks=True)
    to, progress = reference(WHAT, start(HERE, 0.0, S), HERE, S + 1, old)
    assert to.place_m == HERE[:2] and not to.done
    to, _ = reference(WHAT, progress, HERE, S + 2, old._replace(looks=False))
    assert to.place_m != HERE[:2]


def test_it_is_done_once_anybody_knows_and_stays_so() -> None:
    _, progress = reference(WHAT, start(HERE, 0.0, S), HERE, S, around())
    to, progress = reference(WHAT, progress, HERE, 2 * S, around(target=estimate(2 * S)))
    assert to.done and to.place_m == HERE[:2]
    to, _ = reference(WHAT, progress, HERE, 60 * S, around(target=estimate(2 * S)))
    assert to.done and to.place_m == HERE[:2]


def seen_share(places, lane_m) -> float:
    """Of the tank's water, by robots that were there."""
    inner = np.array([(x, y) for x in np.arange(0.25, 5.8, 0.1) for y in np.arange(0.25, 3.8, 0.1)])
    seen = np.zeros(len(inner), dtype=bool)
    for place in places:
        seen |= np.hypot(*(inner - place).T) <= 0.5 * lane_m * math.sqrt(2.0)
    return float(seen.mean())


@pytest.mark.parametrize("seed", [0, 1])
def test_a_link_that_drops_now_and_then_does_not_make_them_begin_again(seed) -> None:
    tank_m, h_ns = (6.0, 4.0), 250_000_000
    at = [tuple(p) for p in np.random.default_rng(seed).uniform((0.3, 0.3), (5.7, 3.7), (2, 2)).tolist()]
    progress, passed = [start((*p, 0.0), 0.0, S) for p in at], list(at)
    for now_ns in range(S, 480 * S, h_ns):
        linked, goals = now_ns % (20 * S) < 15 * S, []
        for k, (x, y) in enumerate(at):
            told = Surroundings(tank_m, 0.25, fellows_m=(at[1 - k],) if linked else ())
            to, progress[k] = reference(WHAT, progress[k], (x, y, 0.0), now_ns, told)
            goals.append(to.place_m)
        at = [towards(p, goal, WHAT.speed_m_s * h_ns * 1e-9) for p, goal in zip(at, goals, strict=True)]
        passed += at
    assert seen_share(passed, LANE_M) > 0.99


def towards(p, goal, way_m):
    share = min(way_m / max(math.dist(p, goal), 1e-9), 1.0)
    return p[0] + share * (goal[0] - p[0]), p[1] + share * (goal[1] - p[1])


def test_an_end_that_it_cannot_reach_is_left_out() -> None:
    """Another robot holds there; the time of a sweep does not count."""
    to, progress = reference(WHAT, start(HERE, 0.0, S), HERE, S, around())
    ends, now_ns = progress.hunt.way, S
    pose = (ends[0][0] + 0.34, ends[0][1], 0.0)
    for _ in range(140):
        now_ns += S // 10
        to, progress = reference(WHAT, progress, pose, now_ns, around())
        assert to.place_m == ends[0]
    now_ns += 60 * S
    to, progress = reference(WHAT, progress, pose, now_ns, around())
    assert to.place_m == ends[0]
    for _ in range(152):
        now_ns += S // 10
        to, progress = reference(WHAT, progress, pose, now_ns, around())
    assert to.place_m == ends[1] and progress.hunt.way == ends


# --- whole ----------------------------------------------------------------------------------------------------------


def test_it_finds_a_ball_behind_it_measures_it_and_holds() -> None:
    fleet = basin.fleet(
        {"r1": basin.robot("r1", Pose(x_m=1.6, y_m=0.9, yaw_deg=0.0), WHAT, Look(tilt_deg=-10.0))}, seed=9
    )
    one = Swimmers(fleet, PlanarBodies(fleet), (0.5, 1.1, 0.07))
    agent = one.agents["r1"]
    for _ in range(45 * 20):
        one.step()
        if agent.measuring.current.estimator.posterior is not None:
            break
    believed = agent.measuring.current.estimator.posterior
    assert believed is not None and math.dist(believed.x_m, (0.5, 1.1, 0.07)) < 0.05
    for _ in range(2 * 20):
        one.step()
    assert swimmer_of(agent.capabilities).does == "hold" and agent.target_search.view(0).search is None


def test_a_search_for_another_target_has_a_plan_of_its_own_and_a_survey_has_none() -> None:
    told = fleet(behaviour=Search(target="ball"))
    one = InTank(replace(told, target=told.target | {"cup": Target(radius_m=0.05)}))
    swimmer = swimmer_of(one.agent.capabilities)
    one.run(2.0)
    assert swimmer.search is not None and swimmer.search.target == "ball"
    swimmer.active.begin(Search(target="cup"))
    one.run(1.0)
    assert swimmer.search.target == one.agent._situation.camera.search.target == "cup"
    swimmer.active.begin(Survey())
    one.run(1.0)
    assert swimmer.search is None and one.agent._situation.camera.search is None
