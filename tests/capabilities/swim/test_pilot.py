"""The pilot on bodies that are not as it believes, with fixes that come late; behaviours that are swum."""

import itertools
import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.capabilities.swim.barrier import (
    APART_1_S,
    BRAKE_M_S2,
    DELAY_S,
    FLEES_M,
    FORCE_N,
    MOMENT_NM,
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
)
from agent.capabilities.swim.behaviour import (
    LEAD,
    MOST_TURNED_RAD,
    W_RAD_S,
    YAW_W_RAD_S,
    Z,
    reference,
    start,
    wanted_velocity,
    wrench,
)
from agent.capabilities.swim.pose_filter import Hull, begin
from agent.capabilities.swim.search import Surroundings, walled_in
from agent.core.config import Behaviour, Goto, Hold, Orbit, Turn
from agent.core.linear_algebra import wrap
from tests.capabilities.swim.planar_tank import Fixes, Piloted, Swimmer

S = 1_000_000_000
OPEN = Surroundings((100.0, 100.0))  # water without walls
DAMPED = math.exp(-math.pi * 0.3 / math.sqrt(1.0 - 0.09))  # overshoot of a damping of 0.3: 37 %


def of_mass(factor, lag_s=0.115):
    return Hull(mass_kg=6.0 * factor, inertia_kgm2=0.09 * factor, lag_s=lag_s)


@pytest.mark.parametrize(("w", "inertia", "drag"), [(W_RAD_S, 6.0, 2.0), (YAW_W_RAD_S, 0.09, 0.03)])
def test_poles_are_damped(w, inertia, drag) -> None:
    """Place, speed, force; what is believed of the force is what a thruster of 0.115 s would give."""
    for lag, factor in itertools.product((0.08, 0.115, 0.15), (0.75, 1.0, 1.3)):
        kp, kv, k = w / (2 * Z), 2 * Z * w, drag / inertia
        want = inertia * np.array([-kp * kv, k - kv, 0.0, 0.0])
        believed = np.array([0.0, 0.0, 0.0, 1.0])
        asked = believed + LEAD * (want - believed)
        A = np.array(
            [
                [0.0, 1.0, 0.0, 0.0],
                [0.0, -k / factor, 1.0 / (inertia * factor), 0.0],
                (asked - [0.0, 0.0, 1.0, 0.0]) / lag,
                (asked - believed) / 0.115,
            ]
        )
        poles = np.linalg.eigvals(A)
        assert np.all(-poles.real / np.abs(poles) > 0.3)


@pytest.mark.parametrize(
    ("factor", "lag_s", "delay_s"), [(0.75, 0.08, 0.2), (0.75, 0.15, 0.2), (1.3, 0.08, 0.05), (1.3, 0.15, 0.2)]
)
def test_steps_are_damped_on_other_bodies_with_late_fixes(factor, lag_s, delay_s) -> None:
    swimmer = Swimmer.resting((1.0, 1.0, 0.0), of_mass(factor, lag_s))
    one = Piloted(swimmer, fixes=Fixes(200_000_000, round(delay_s * S)))
    path = []
    for _ in range(110):
        one.cycle(lambda t, belief: Reference((1.05, 1.0), 0.1))
        path.append(swimmer.at.copy())
    over = np.max(path, axis=0) - [1.05, 1.0, 0.1]
    assert over[0] < DAMPED * 0.05 and over[2] < DAMPED * 0.1
    assert np.abs(np.array(path[-20:]) - [1.05, 1.0, 0.1]).max() < 0.15 * 0.1


def test_it_holds_against_a_pull_of_the_tether() -> None:
    """0.05 N rms, changing over 4 s; fixes of 2 mm and 0.14 degrees at 5 Hz, 80 ms late; drag drawn from x0.5 to x2."""
    errors = []
    rng = np.random.default_rng(1)
    drag, drag2, turn_drag, turn_drag2 = np.array([2.0, 20.0, 0.03, 0.1]) * 2.0 ** rng.uniform(-1, 1, 4)
    drawn = Hull(drag=drag, drag2=drag2, turn_drag=turn_drag, turn_drag2=turn_drag2)
    swimmer = Swimmer.resting((1.0, 1.0, 0.0), drawn)
    one = Piloted(swimmer, rng, Fixes(200_000_000, 80_000_000, (0.002, 0.002, 0.0025)))
    sigma = np.array([0.05, 0.05, 0.0015])
    pull, keeps = rng.normal(0.0, sigma), math.exp(-0.05 / 4.0)
    for k in range(280):
        pull = keeps * pull + math.sqrt(1.0 - keeps * keeps) * rng.normal(0.0, sigma)
        one.cycle(lambda t, belief: Reference((1.0, 1.0), 0.0), pull=pull)
        if k > 80:
            errors.append(swimmer.at - [1.0, 1.0, 0.0])
    errors = np.square(errors)
    assert np.sqrt(np.mean(errors[:, 0] + errors[:, 1])) < 0.006
    assert np.degrees(np.sqrt(np.mean(errors[:, 2]))) < 0.7


def test_what_is_asked_for_has_limits() -> None:
    belief = begin(0, (0.0, 0.0, 0.3), (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6))
    near, far = (wrench(belief, Hull(), Reference((0.0, 0.0), 0.3), v) for v in ((0.03, 0.04), (3.0, 4.0)))
    assert math.hypot(*far[:2]) == pytest.approx(FORCE_N)
    assert math.atan2(far[1], far[0]) == pytest.approx(math.atan2(near[1], near[0]))  # scaled together
    assert wrench(belief, Hull(), Reference((0.0, 0.0), -2.8, turn_rad_s=2.0), (0.0, 0.0))[2] == -MOMENT_NM
    slow = wanted_velocity(belief, Reference((3.0, -4.0), 0.0, velocity_m_s=(0.01, 0.0), speed_m_s=0.1))
    assert slow == pytest.approx((0.07, -0.08))


# --- behaviours -------------------------------------------------------------------------------------------------


def swum(what, seconds, at=(1.0, 1.0, 0.0), hull=None, rng=None, watched=None):
    """(times, true poses, references, progress) of a behaviour."""
    swimmer = Swimmer.resting(at, hull)
    one, progress = Piloted(swimmer, rng, Fixes(200_000_000, 80_000_000, (0.002, 0.002, 0.0025))), start(at, 0.0, 0)
    times, path, told = [], [], []

    def steer(t, belief):
        nonlocal progress
        to, progress = reference(what, progress, belief.pose, round(t * S), OPEN, watched)
        return to

    for _ in range(round(seconds * 20)):
        _, to = one.cycle(steer)
        times.append(one.now_ns * 1e-9)
        path.append(swimmer.at.copy())
        told.append(to)
    return np.array(times), np.array(path), told, progress


def test_kinds_are_told_apart_in_a_file() -> None:
    told = [{"kind": "hold"}, {"kind": "goto", "x_m": 1, "y_m": 2}, {"kind": "turn", "yaw_deg": 90}]
    orbit = {"kind": "orbit", "x_m": 1, "y_m": 1, "radius_m": 0.5}
    assert [type(msgspec.convert(each, Behaviour)) for each in (*told, orbit)] == [Hold, Goto, Turn, Orbit]
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"kind": "turn", "yaw_deg": 90, "x_m": 1.0}, Behaviour)


def test_hold_stays_where_it_was_told_to() -> None:
    _, path, told, _ = swum(Hold(), 3.0, (1.2, 0.7, 0.4))
    assert np.abs(path - [1.2, 0.7, 0.4]).max() < 1e-6 and not told[-1].done


@pytest.mark.parametrize(("bearing_deg", "yaw_deg"), [(45.0, 0.0), (130.0, 80.0), (-100.0, -50.0)])
def test_hold_turns_the_body_only_where_the_gimbal_does_not_reach(bearing_deg, yaw_deg) -> None:
    bearing = math.radians(bearing_deg)
    _, path, *_ = swum(Hold(), 4.0, watched=(1.0 + 0.8 * math.cos(bearing), 1.0 + 0.8 * math.sin(bearing)))
    assert np.degrees(path[-1, 2]) == pytest.approx(yaw_deg, abs=1.0)


@pytest.mark.parametrize("drag", [0.7, 1.4])
def test_half_a_metre_and_not_beyond(drag) -> None:
    """With a drag that is as far from what is believed as after a poor calibration of the body."""
    hull = Hull(drag=2.0 * drag, drag2=20.0 * drag)
    times, path, told, _ = swum(Goto(x_m=1.4, y_m=1.3), 7.0, hull=hull)
    way = (path[:, :2] - [1.0, 1.0]) @ [0.8, 0.6]
    off = np.hypot(*(path[:, :2] - [1.4, 1.3]).T)
    assert times[np.flatnonzero(off > 0.02)[-1]] < 5.0
    assert way.max() < 0.5 + 0.03
    assert np.degrees(path[-1, 2]) == pytest.approx(np.degrees(np.arctan2(0.3, 0.4)), abs=3.0)  # along the way
    done = [to.done for to in told]
    assert done[-1] and times[done.index(True)] > 2.0


def test_goto_looks_at_the_target_or_where_it_is_told_to() -> None:
    _, path, told, _ = swum(Goto(x_m=1.2, y_m=1.0, depth_m=0.3), 5.0, watched=(1.2, 2.0))
    assert np.degrees(path[-1, 2]) == pytest.approx(90.0, abs=2.0) and told[-1].depth_m == 0.3
    _, path, _, _ = swum(Goto(x_m=1.2, y_m=1.0, yaw_deg=-30.0), 5.0, watched=(1.2, 2.0))
    assert np.degrees(path[-1, 2]) == pytest.approx(-30.0, abs=1.0)


def test_a_quarter_turn_takes_three_seconds() -> None:
    times, path, told, progress = swum(Turn(yaw_deg=90.0), 5.0)
    off = np.abs(np.degrees(path[:, 2]) - 90.0)
    assert times[np.flatnonzero(off > 3.0)[-1]] < 3.0
    assert told[-1].done and progress.turned == pytest.approx(np.pi / 2, abs=0.02)


def test_the_tether_is_not_wound_up() -> None:
    """Quarter turns on and on to the left: after four of them the fifth goes back over three."""
    progress, yaw, total, most = start((0.0, 0.0, 0.0), 0.0, 0), 0.0, 0.0, 0.0
    for quarter in range(1, 12):
        for _ in range(400):
            to, progress = reference(Turn(yaw_deg=90.0 * quarter), progress, (0.0, 0.0, yaw), 0, OPEN)
            step = float(np.clip(wrap(to.yaw - yaw), -0.05, 0.05))
            yaw, total = wrap(yaw + step), total + step
            most = max(most, abs(total))
        assert abs(wrap(yaw - math.radians(90.0 * quarter))) < 1e-6
        assert progress.turned == pytest.approx(total)
    assert 1.9 * np.pi < most <= MOST_TURNED_RAD + 1e-6


def test_an_orbit_s_velocity_is_that_of_its_place_and_it_turns_back_in_time() -> None:
    what, h, at = Orbit(x_m=1.5, y_m=1.0, radius_m=0.6, speed_m_s=0.1), 1_000_000, (1.5, 0.4, 2.0)
    progress = start(at, 0.0, 0)
    looks, step_ns = [], S // 5
    for t_ns in range(0, 200 * S, step_ns):
        three = []
        for t in (t_ns, t_ns + h, t_ns + 2 * h):
            to, progress = reference(what, progress, at, t, OPEN)
            three.append(to)
        before, to, after = three
        assert math.dist(to.place_m, (1.5, 1.0)) == pytest.approx(0.6)
        slope = np.subtract(after.place_m, before.place_m) / (2e-9 * h)
        np.testing.assert_allclose(to.velocity_m_s, slope, atol=1e-7)
        np.testing.assert_allclose(
            to.acceleration_m_s2, np.subtract(after.velocity_m_s, before.velocity_m_s) / (2e-9 * h), atol=1e-7
        )
        assert to.rate_rad_s == pytest.approx(wrap(after.yaw - before.yaw) / (2e-9 * h), abs=1e-6)
        inwards = math.atan2(1.0 - to.place_m[1], 1.5 - to.place_m[0])
        assert wrap(inwards - to.yaw) == pytest.approx(0.0, abs=1e-9)
        looks.append(to.rate_rad_s)
    turned = np.cumsum(looks) * step_ns / S
    assert max(looks) > 0 > min(looks) and np.ptp(turned) <= 2.0 * MOST_TURNED_RAD


def test_an_orbit_is_as_slow_as_the_robot_and_waits_for_it() -> None:
    what, at, h = Orbit(x_m=1.5, y_m=1.0, radius_m=0.6, speed_m_s=0.2), (1.5, 0.4, 2.0), S // 20
    slow, progress = Surroundings(OPEN.tank_m, speed_m_s=0.05), start(at, 0.0, 0)
    first, progress = reference(what, progress, at, 0, slow)
    for k in range(1, 21):
        to, progress = reference(what, progress, at, k * h, slow)
    assert math.hypot(*to.velocity_m_s) < 0.05
    assert math.dist(to.place_m, first.place_m) == pytest.approx(math.hypot(*to.velocity_m_s), rel=1e-3)
    later, _ = reference(what, progress, at, 60 * S, slow)  # it was lost for a while
    assert later.place_m == to.place_m
    rests, _ = reference(what, progress, at, 21 * h, slow._replace(speed_m_s=0.0))
    assert rests.place_m == to.place_m and rests.velocity_m_s == pytest.approx((0.0, 0.0))


def test_an_orbit_is_swum() -> None:
    what = Orbit(x_m=1.5, y_m=1.0, radius_m=0.5, speed_m_s=0.1)
    _, path, _, _ = swum(what, 13.0, (1.0, 1.0, 0.0), rng=np.random.default_rng(4))
    radius = np.hypot(*(path[60:, :2] - [1.5, 1.0]).T)
    assert np.sqrt(np.mean((radius - 0.5) ** 2)) < 0.008
    facing = np.arctan2(1.0 - path[60:, 1], 1.5 - path[60:, 0]) - path[60:, 2]
    assert np.degrees(np.abs((facing + np.pi) % (2 * np.pi) - np.pi)).max() < 5.0
    assert abs(path[-1, 2] - path[60, 2]) > 1.8  # it got round


@pytest.mark.parametrize(("x", "y"), [(2.7, 1.0), (1.5, 0.3), (0.3, 1.7), (2.75, 1.75)])
def test_who_goes_to_a_wall_looks_away_from_it(x, y) -> None:
    """A camera before a wall sees no whole landmark, and its robot is lost there."""
    tank_m, yaws = (3.0, 2.0), []
    pose, progress = (1.5, 1.0, 0.0), start((1.5, 1.0, 0.0), 0.0, 0)
    for step in range(1, 41):  # on the straight way, and as it turns
        to, progress = reference(Goto(x_m=x, y_m=y), progress, pose, step * S, Surroundings(tank_m))
        at = np.array([1.5, 1.0]) + step / 40.0 * (np.array([x, y]) - (1.5, 1.0))
        pose = (float(at[0]), float(at[1]), to.yaw)
        yaws.append(to.yaw)
    assert not walled_in(pose[:2], yaws[-1], tank_m)
    told, _ = reference(Goto(x_m=x, y_m=y, yaw_deg=10.0), progress, pose, S, Surroundings(tank_m))
    assert told.yaw == pytest.approx(np.radians(10.0))  # whoever is told which way looks that way


def test_who_goes_through_the_middle_looks_along_the_way() -> None:
    to, _ = reference(
        Goto(x_m=1.9, y_m=1.1), start((1.0, 0.9, 0.0), 0.0, 0), (1.0, 0.9, 0.0), 0, Surroundings((3.0, 2.0))
    )
    assert to.yaw == pytest.approx(np.arctan2(0.2, 0.9))


# --- barrier ---
# Robots keep clear: braking in closed form, half-planes against a grid, and robots that swim at each other.

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
    else:  # of all velocities it breaks the worst broken rule least
        assert (least - normals @ velocity).max() <= (least - grid @ normals.T).max(axis=1).min() + 1e-3


def test_where_nothing_is_safe_it_flees_from_none_into_another() -> None:
    """In a corridor of two others it stays in their middle, however unsure it gets of its own place."""
    close = [robot(place, STILL, KNOWN) for place in ((1.4, 1.0), (0.6, 1.0), (1.0, 1.45))]
    for sigma_m in (0.02, 0.05, 0.1):
        unsure = (sigma_m**2, 0.0, sigma_m**2)
        assert nearest([clear_of((1.0, 1.0), unsure, other) for other in close], (0.0, 0.0)) is None
        velocity = safe_velocity((0.0, 0.0), (1.0, 1.0), unsure, TANK, [], close)
        assert velocity[0] == pytest.approx(0.0, abs=1e-3) and velocity[1] <= 0.0
        nearer = safe_velocity((0.0, 0.0), (1.02, 1.0), unsure, TANK, [], close)
        assert nearer[0] < -0.01, "and goes back there"


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
