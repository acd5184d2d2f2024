"""The body of a creature bends in a wave that runs to its tail, and hangs together."""

import math
from itertools import pairwise

import numpy as np
import pytest

from agent.core.config import ConfigError
from hw.twin.creatures import (
    PARTS,
    ROBOT_M,
    SHY_M,
    TICK_S,
    TURN_RAD_S,
    TURN_S,
    Attitude,
    Doing,
    School,
    Swimmer,
    Thing,
    Water,
    bend,
    lee,
    swimming,
)
from hw.twin.scene import Creature, Solid, load_scene

FISH = Creature(name="fish", length_m=0.2)


def test_the_tail_beats_a_tenth_of_the_length_and_the_nose_not_at_all():
    beats = np.linspace(0, 2 * math.pi, 181)
    assert max(bend(1.0, beat, 1.0)[0] for beat in beats) == pytest.approx(0.1, rel=1e-3)
    assert max(abs(bend(0.0, beat, 1.0)[0]) for beat in beats) == 0.0
    assert max(abs(bend(1.0, beat, 0.5)[0]) for beat in beats) == pytest.approx(0.05, rel=1e-3)


def test_the_wave_runs_to_the_tail_and_parts_point_along_it():
    """A quarter of a beat later the crest is a quarter of a wave further back."""
    s = np.linspace(0.2, 1.0, 401)
    shares = 0.02 * s + 0.08 * s * s

    def crest(beat):
        return s[np.argmax([bend(x, beat, 1.0)[0] / share for x, share in zip(s, shares, strict=True)])]

    assert crest(math.pi / 2) - crest(0.0) == pytest.approx(0.25, abs=0.005)
    for x in (0.3, 0.9):
        (ahead, _), (behind, _) = bend(x - 1e-6, 1.0, 1.0), bend(x + 1e-6, 1.0, 1.0)
        assert math.tan(bend(x, 1.0, 1.0)[1]) == pytest.approx((ahead - behind) / 2e-6, rel=1e-5)


def test_it_looks_where_it_heads_and_is_as_long_as_said():
    """Nose to tail along the heading, nose up by the pitch; each part overlaps with the next."""
    attitude = Attitude(1.0, 1.2, 0.3, math.radians(30), math.radians(10), 0.7, 0.0)
    parts = swimming(FISH, attitude, 0).parts[: len(PARTS) - 1]
    ahead = np.array([math.cos(0.5236) * math.cos(0.17453), math.sin(0.5236) * math.cos(0.17453), math.sin(0.17453)])
    nose, tail = parts[0].position_m + parts[0].radii_m[0] * ahead, parts[-1].position_m - parts[-1].radii_m[0] * ahead
    np.testing.assert_allclose(nose - tail, 0.2 * ahead, atol=1e-5)
    np.testing.assert_allclose((nose + tail) / 2, attitude[:3], atol=1e-9)
    for width in (0.0, 1.0):
        bent = swimming(FISH, attitude._replace(width=width), 0).parts[: len(PARTS) - 1]
        assert all(
            np.linalg.norm(a.position_m - b.position_m) < 0.8 * (a.radii_m[0] + b.radii_m[0]) for a, b in pairwise(bent)
        )


def test_a_look_alike_wears_the_same_blotches_another_of_the_colour_does_not():
    def pattern(**keywords):
        creature = Creature(**keywords)
        parts = swimming(creature, Attitude(1, 1, 0.2, 0, 0, 0, 0), 3).parts
        return [(part.pattern_m, part.material) for part in parts]

    assert pattern(name="two", like="fish") == pattern(name="fish") != pattern(name="two")
    assert pattern(name="fish", colour="silver")[0][1] != pattern(name="fish")[0][1]


# --- swimmer ---
# How creatures swim: within the tank and around what is in it, as fast as the scene says, by chance of their own.

SIZE_M = (3.0, 2.0, 0.5)
SWIMMER_FISH = Creature(name="fish")
STONES = load_scene("fish").solid
ROBOTS_M = np.array([[0.5, 0.5, 0.2], [2.5, 0.4, 0.2]])


def swum(school, ticks, robots_m=ROBOTS_M, solids=STONES):
    """(ticks, 7) attitudes of the first creature."""
    rows = []
    for _ in range(ticks):
        school.tick(robots_m, solids)
        rows.append(school.attitudes[0])
    return np.array(rows)


def speeds_m_s(rows):
    return np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1) / TICK_S


@pytest.mark.parametrize("creature", [SWIMMER_FISH, Creature(name="long", length_m=0.3, speed_m_s=0.2)])
def test_no_part_of_it_leaves_the_water_or_enters_a_robot(creature):
    school = School([creature], 1, SIZE_M, STONES)
    for _ in range(60):
        swum(school, 25)
        attitude = school.attitudes[0]
        for part in swimming(creature, attitude, 1).parts:
            reach_m = np.sqrt(((np.asarray(part.rotation) * part.radii_m) ** 2).sum(1))
            assert (part.position_m - reach_m > 0).all() and (part.position_m + reach_m < SIZE_M).all()
        assert (np.linalg.norm((np.array(attitude[:3]) - ROBOTS_M) / ROBOT_M, axis=1) > 1).all()
        assert all(math.dist(attitude[:3], stone.position_m) > min(stone.radii_m) for stone in STONES)


def test_it_cruises_at_its_speed_and_rests_now_and_then():
    """In a minute."""
    school, doing, rows = School([SWIMMER_FISH], 2, SIZE_M, STONES), [], []
    for _ in range(60):
        rows.append(swum(school, 100))
        doing.append(school._swimmers["fish"].doing)
    rows = np.concatenate(rows)
    cruising = speeds_m_s(rows[:500])
    assert cruising[100:] == pytest.approx(SWIMMER_FISH.speed_m_s, rel=0.02)
    assert speeds_m_s(rows).max() < 1.05 * SWIMMER_FISH.speed_m_s
    assert set(doing) == set(Doing)
    resting = rows[99::100][np.array([what is Doing.REST for what in doing])]
    assert np.median(resting[:, 6]) < 0.1  # and its tail with it


def test_in_open_water_it_turns_as_the_process_says():
    """Two minutes: eighty correlation times, so that the deviation is known to a tenth."""
    school = School([SWIMMER_FISH], 3, (1000.0, 1000.0, 1000.0), ())
    school._swimmers["fish"]._left_s = math.inf
    rates = np.diff(swum(school, 12_000, np.zeros((0, 3)), ())[:, 3]) / TICK_S
    assert rates.std() == pytest.approx(TURN_RAD_S, rel=0.2)
    lag = round(TURN_S / TICK_S)
    assert np.mean(rates[lag:] * rates[:-lag]) / rates.var() == pytest.approx(math.exp(-1), abs=0.2)


def test_it_turns_away_from_a_robot_in_its_way():
    """Head on, at 0.6 m; without the robot it passes right through that place."""
    creature = Creature(name="fish", path=((0.5, 1.0, 0.25), (2.5, 1.0, 0.25)))

    def closest_m(robots):
        swimmer = Swimmer(creature, 0, Water(SIZE_M))
        swimmer._course, swimmer._left_s, least_m = (), math.inf, math.inf  # let loose
        swimmer._rng = np.random.default_rng(5)
        for _ in range(600):
            swimmer.tick(Water(SIZE_M, (), robots), TICK_S)
            swimmer._turn_rad_s = 0.0
            least_m = min(least_m, math.dist(swimmer.attitude[:2], (1.1, 1.0)))
        return least_m

    assert closest_m(()) < 0.05
    assert 0.20 < closest_m((Thing((1.1, 1.0, 0.25), ROBOT_M),)) < SHY_M


def test_its_hiding_place_is_behind_the_stone():
    stone = Thing(STONES[0].position_m, STONES[0].radii_m)
    for robot_m in ROBOTS_M:
        spot_m = lee(stone, tuple(robot_m), 0.15, Water(SIZE_M, (stone,)))
        towards, past = np.array(stone.centre_m)[:2] - robot_m[:2], np.array(spot_m)[:2] - robot_m[:2]
        assert np.linalg.norm(past) > np.linalg.norm(towards)
        assert towards[0] * past[1] == pytest.approx(towards[1] * past[0], abs=1e-9)


def test_a_path_is_swum_round_and_round():
    course = ((0.8, 0.6, 0.2), (2.2, 0.6, 0.3), (1.5, 1.5, 0.2))
    school = School([Creature(name="fish", path=course)], 0, SIZE_M, ())
    rows = swum(school, 4000, np.zeros((0, 3)), ())
    np.testing.assert_allclose(rows[0, :3], course[0], atol=0.002)
    for point in course:
        near = np.linalg.norm(rows[:, :3] - point, axis=1) < SWIMMER_FISH.length_m / 2
        assert np.sum(near[1:] & ~near[:-1]) >= 1
    assert speeds_m_s(rows)[50:] == pytest.approx(0.15, rel=0.01)


def test_a_startled_one_flees_for_so_long():
    school = School([SWIMMER_FISH], 1, SIZE_M, ())
    swum(school, 100, solids=())
    robot_m = np.array(school.attitudes[0][:3])[None] + (0.5, 0.0, 0.0)
    school.startle("fish", 0.5, 1.0)
    rows = swum(school, 300, robot_m, ())
    assert speeds_m_s(rows)[40:90] == pytest.approx(0.5, rel=0.02)
    assert speeds_m_s(rows)[-1] == pytest.approx(0.15, rel=0.1)
    assert np.linalg.norm(rows[99, :2] - robot_m[0, :2]) > 0.7


def test_chance_is_of_the_seed_and_of_the_name_alone():
    def way(seed, *creatures):
        return swum(School(creatures, seed, SIZE_M, STONES), 300).tobytes()

    other = Creature(name="other", like="fish")
    assert way(1, SWIMMER_FISH) == way(1, SWIMMER_FISH) == way(1, SWIMMER_FISH, other)
    assert len({way(1, SWIMMER_FISH), way(2, SWIMMER_FISH), way(1, other, SWIMMER_FISH)}) == 3


@pytest.mark.parametrize(
    ("creature", "says"),
    [
        (Creature(name="fish", path=((1.0, 1.0, 0.25), (2.99, 1.0, 0.25))), "too close to a wall.*0.08 to 2.92"),
        (Creature(name="fish", position_m=(1.0, 1.0, 0.49)), "too close"),
        (Creature(name="fish", length_m=0.4), "no room"),
        (Creature(name="fish", like="whale"), "no creature 'whale'"),
    ],
)
def test_what_has_no_place_is_said_at_the_start(creature, says):
    with pytest.raises(ConfigError, match=says):
        School([creature], 0, (3.0, 2.0, 0.2) if creature.length_m == 0.4 else SIZE_M, ())


def test_two_of_one_name_are_refused():
    with pytest.raises(ConfigError, match="two are called 'fish'"):
        School(
            [SWIMMER_FISH, SWIMMER_FISH],
            0,
            SIZE_M,
            [Solid(kind="ball", position_m=(1, 1, 0.1), radii_m=(0.1, 0.1, 0.1))],
        )


def test_the_current_takes_it_along_while_it_swims_and_not_while_it_rests():
    current_m_s, ticks = (0.04, -0.02, 0.0), 300
    still, flowing = (School([SWIMMER_FISH], 0, (40.0, 40.0, 20.0), ()) for _ in range(2))
    for _ in range(ticks):
        still.tick(np.zeros((0, 3)), ())
        flowing.tick(np.zeros((0, 3)), (), current_m_s)
    apart_m = np.array(flowing.attitudes[0][:3]) - still.attitudes[0][:3]
    np.testing.assert_allclose(apart_m, np.array(current_m_s) * ticks * TICK_S, atol=1e-9)
    swimmer = flowing._swimmers["fish"]
    swimmer._begin(Doing.REST)
    swimmer._left_s = 10.0
    for _ in range(400):
        flowing.tick(np.zeros((0, 3)), (), current_m_s)
    before = flowing.attitudes[0]
    flowing.tick(np.zeros((0, 3)), (), current_m_s)
    after = flowing.attitudes[0]
    assert np.linalg.norm(np.array(after[:3]) - before[:3]) < 1e-6
    assert after.beat_rad > before.beat_rad
