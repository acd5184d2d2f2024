"""Robots keep clear: braking in closed form, half-planes against a grid, and robots that swim at each other."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.capabilities.swim.pilot import (
    APART_1_S,
    BRAKE_M_S2,
    DELAY_S,
    FLEES_M,
    NEAR_1_S,
    RINGS_M,
    SIGMAS,
    STILL,
    SWIMS_M,
    TARGET_M,
    WALL_M,
    Disc,
    Reference,
    approach_m_s,
    clear_of,
    nearest,
    robot,
    safe_velocity,
    walls,
    wanted_velocity,
    wrench,
)
from agent.capabilities.swim.pose_filter import Hull, begin
from tests.capabilities.swim.planar_tank import Swimmer

KNOWN = (0.0, 0.0, 0.0)
TANK = (3.0, 2.0, 0.8)


@settings(max_examples=40, deadline=None)
@given(st.floats(1e-4, 3.0))
def test_two_that_come_as_fast_as_they_may_can_brake_in_time(spare_m) -> None:
    """Both at c: after the delay they brake, by BRAKE together, over what is then left of the way."""
    closing = 2.0 * approach_m_s(spare_m)
    needs_m = closing * DELAY_S + closing**2 / (2.0 * BRAKE_M_S2)
    assert needs_m <= spare_m * (1.0 + 1e-9)
    if approach_m_s(spare_m) < NEAR_1_S * spare_m:
        assert needs_m == pytest.approx(spare_m)


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.3, 0.0))
def test_two_that_are_too_near_part(spare_m) -> None:
    assert approach_m_s(spare_m) == APART_1_S * spare_m


def test_what_is_kept_clear_of_grows_with_what_is_not_known() -> None:
    ours, theirs = (4e-4, 1e-4, 9e-4), (1e-4, 0.0, 1e-4)
    plane = clear_of((1.0, 1.0), ours, Disc((1.6, 1.8), RINGS_M, spread_m2=theirs))
    u = np.array([-0.6, -0.8])
    spread = np.array([[5e-4, 1e-4], [1e-4, 10e-4]])
    spare = 1.0 - RINGS_M - SWIMS_M - SIGMAS * np.sqrt(u @ spread @ u)
    np.testing.assert_allclose(plane.normal, u)
    assert plane.least == pytest.approx(-approach_m_s(spare))


def test_a_neighbour_has_half_of_the_way_and_a_fish_none() -> None:
    """Both recede at 0.1 m/s: of a robot that yields half of it may be had, of a fish all."""
    at, away = (1.0, 1.0), (0.1, 0.0)
    still = clear_of(at, KNOWN, Disc((2.0, 1.0), RINGS_M)).least
    yields = clear_of(at, KNOWN, Disc((2.0, 1.0), RINGS_M, away, yields=True)).least
    fish = clear_of(at, KNOWN, Disc((2.0, 1.0), RINGS_M, away)).least
    assert yields - still == pytest.approx(-0.05) and fish - still == pytest.approx(-0.1)


def test_an_old_word_of_a_neighbour_is_worth_less() -> None:
    old = robot((1.0, 1.0), (0.2, -0.1), (1e-4, 0.0, 1e-4), age_s=0.5)
    assert old.at_m == pytest.approx((1.1, 0.95)) and old.yields
    assert old.spread_m2 == (1e-4, 0.0, 1e-4) and old.strays_m == pytest.approx(0.5 * BRAKE_M_S2 * 0.25)


def test_one_that_is_silent_is_not_approached_and_nobody_flees_from_it() -> None:
    """Half a metre to spare by its last word, 0.12 m too little by its age: no nearer, and no further."""
    here, there = (1.0, 1.0), (1.0, 1.0 + RINGS_M + SWIMS_M + 0.5)
    for age_s, least in ((0.0, -approach_m_s(0.5)), (1.0, -approach_m_s(0.25)), (1.6, 0.0), (600.0, 0.0)):
        plane = clear_of(here, KNOWN, robot(there, STILL, KNOWN, age_s))
        assert plane.least == pytest.approx(least) and plane.normal == pytest.approx((0.0, -1.0))
    near = (1.0, 1.0 + RINGS_M)  # by its last word
    assert clear_of(here, KNOWN, robot(near, STILL, KNOWN, 600.0)).least == pytest.approx(APART_1_S * SWIMS_M)
    assert robot(near, (0.1, 0.0), KNOWN, 600.0).at_m == pytest.approx((1.1, near[1]))  # it does not swim to the moon


def test_one_that_may_be_anywhere_is_fled_from_so_far_and_not_approached_beyond() -> None:
    """Three sigma are 0.9 m: of these FLEES_M count for who has to leave, all for who may come."""
    lost = (0.09, 0.0, 0.09)
    for spare_m, least in ((FLEES_M - 0.1, -0.1 * APART_1_S), (FLEES_M + 0.1, 0.0), (0.8, 0.0), (0.95, 0.05)):
        there = (1.0 + RINGS_M + SWIMS_M + spare_m, 1.0)
        for ours, theirs in ((KNOWN, lost), (lost, KNOWN)):
            plane = clear_of((1.0, 1.0), ours, robot(there, STILL, theirs))
            assert plane.least == pytest.approx(-approach_m_s(least) if least > 0.0 else -least)


def test_a_safe_velocity_stays_as_it_is() -> None:
    others = [robot((2.5, 1.5), STILL, KNOWN)]
    assert safe_velocity((0.1, -0.05), (1.0, 1.0), KNOWN, TANK, [], others) == (0.1, -0.05)


def test_a_robot_comes_no_nearer_to_a_wall_and_slides_along_it() -> None:
    velocity = safe_velocity((-0.2, 0.1), (WALL_M, 1.0), KNOWN, TANK)
    assert velocity == pytest.approx((0.0, 0.1))
    assert safe_velocity((0.0, 0.0), (WALL_M - 0.1, 1.0), KNOWN, TANK)[0] == pytest.approx(0.1 * APART_1_S)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_a_grid_has_no_safe_velocity_that_is_nearer(seed) -> None:
    rng = np.random.default_rng(seed)
    at = tuple(rng.uniform([0.4, 0.4], [2.6, 1.6]).tolist())
    around = [np.add(at, rng.uniform(0.3, 0.9) * np.array([np.cos(a), np.sin(a)])) for a in rng.uniform(0, 7, 3)]
    others = [robot(tuple(p.tolist()), tuple(rng.uniform(-0.15, 0.15, 2).tolist()), KNOWN) for p in around]
    planes = [*walls(at, TANK), *(clear_of(at, KNOWN, other) for other in others)]
    normals, least = np.array([p.normal for p in planes]), np.array([p.least for p in planes])
    wanted = rng.uniform(-0.3, 0.3, 2)
    velocity = safe_velocity(tuple(wanted.tolist()), at, KNOWN, TANK, [], others)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, 61)] * 2), axis=-1).reshape(-1, 2)
    safe = grid[(grid @ normals.T >= least).all(axis=1)]
    if len(safe):
        assert (normals @ velocity - least).min() > -1e-9
        assert np.hypot(*(velocity - wanted)) <= np.hypot(*(safe - wanted).T).min() + 1e-9
    else:
        assert normals[-1] @ velocity >= least[-1] - 1e-9  # whatever else


def test_where_nothing_is_safe_the_last_of_the_robots_is_kept_clear_of() -> None:
    close = [robot(place, STILL, KNOWN) for place in ((1.2, 1.0), (1.0, 1.2), (0.85, 0.85))]
    planes = [clear_of((1.0, 1.0), KNOWN, other) for other in close]
    assert nearest(planes, (0.0, 0.0)) is None
    velocity = safe_velocity((0.0, 0.0), (1.0, 1.0), KNOWN, TANK, [], close)
    assert np.dot(planes[-1].normal, velocity) >= planes[-1].least - 1e-9


def swim(robots, goals, seconds, things=(), age_steps=2):
    """Least distance between any two, m, and between a robot and each thing. Beliefs are the truth; words are old."""
    hull, least, least_thing = Hull(), np.inf, np.inf
    said = [[(tuple(map(float, r.at[:2])), STILL)] * (age_steps + 1) for r in robots]
    for step in range(round(seconds / 0.05)):
        for k, each in enumerate(robots):
            begun = begin(0, tuple(map(float, each.at)), (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6))
            moving = (*map(float, each.speed), *begun.x[6:])
            belief = begun._replace(x=(*begun.x[:3], *moving), force=tuple(map(float, each.force)))
            to = Reference(goals(k, step * 0.05), float(each.at[2]))
            others = [robot(*said[j][0], KNOWN, age_steps * 0.05) for j in range(len(robots)) if j != k]
            velocity = safe_velocity(wanted_velocity(belief, to), belief.pose[:2], KNOWN, TANK, things, others)
            each.swim(wrench(belief, hull, to, velocity), 0.05)
        for k, each in enumerate(robots):
            said[k] = [*said[k][1:], (tuple(map(float, each.at[:2])), tuple(map(float, each.speed[:2])))]
        places = [r.at[:2] for r in robots]
        least = min([least, *(np.hypot(*(a - b)) for a, b in itertools.combinations(places, 2))])
        least_thing = min([least_thing, *(np.hypot(*(a - d.at_m)) for a in places for d in things)])
    return least, least_thing


def test_who_is_cornered_by_an_animal_lets_it_come_and_is_not_pressed_against_the_walls() -> None:
    """It comes at 0.2 m/s from the middle, to 0.3 m from a robot that has walls behind it."""
    at, fish = (WALL_M + 0.01, WALL_M + 0.01), Disc((WALL_M + 0.22, WALL_M + 0.22), TARGET_M, (-0.14, -0.14))
    pressed = safe_velocity((0.0, 0.0), at, KNOWN, TANK, [fish])
    assert min(pressed) < -0.05, "a thing that comes so is fled from, into the walls"
    let = safe_velocity((0.0, 0.0), at, KNOWN, TANK, [fish._replace(flees=True)])
    assert min(let) > -0.02
    far = fish._replace(at_m=(1.0, 1.0), flees=True)
    assert safe_velocity((0.1, 0.1), at, KNOWN, TANK, [far]) == pytest.approx((0.1, 0.1)), "it is far away"
    beside = (1.0, 1.0)  # with room behind it is kept clear of, as of all else
    near = Disc((1.3, 1.0), TARGET_M, (-0.1, 0.0), flees=True)
    assert safe_velocity((0.0, 0.0), beside, KNOWN, TANK, [near])[0] < -0.1


def test_two_that_swim_at_each_other_stop_in_time() -> None:
    pair = [Swimmer.resting((0.8, 1.0, 0.0)), Swimmer.resting((2.2, 1.0, 3.0))]
    least, _ = swim(pair, lambda k, t: ((2.2, 1.0), (0.8, 1.0))[k], 9.0)
    assert RINGS_M <= least < RINGS_M + 0.1


def test_four_that_cross_in_the_middle_stay_apart_and_clear_of_a_stone() -> None:
    corners = [(0.6, 0.6), (2.4, 1.4), (0.6, 1.4), (2.4, 0.6)]
    four = [Swimmer.resting((*corner, 0.7 * k)) for k, corner in enumerate(corners)]
    stone = Disc((1.5, 1.0), 0.06 + WALL_M)
    least, least_stone = swim(four, lambda k, t: corners[k ^ 1], 9.0, [stone])
    assert least >= RINGS_M and least_stone >= 0.06 + WALL_M


def test_a_target_is_kept_at_its_distance() -> None:
    (one,) = [Swimmer.resting((0.6, 1.0, 0.0))]
    _, least = swim([one], lambda k, t: (1.5, 1.0), 7.0, [Disc((1.5, 1.0), TARGET_M)])
    assert TARGET_M <= least < TARGET_M + 0.1
