"""The pilot on bodies that are not as it believes, with fixes that come late; behaviours that are swum."""

import itertools
import math

import msgspec
import numpy as np
import pytest

from agent.capabilities.swim.behaviour import MOST_TURNED_RAD, reference, start
from agent.capabilities.swim.pilot import (
    FORCE_N,
    LEAD,
    MOMENT_NM,
    W_RAD_S,
    YAW_W_RAD_S,
    Reference,
    Z,
    wanted_velocity,
    wrench,
)
from agent.capabilities.swim.pose_filter import Hull, begin
from agent.capabilities.swim.search import walled_in
from agent.core.config import Behaviour, Goto, Hold, Orbit, Turn
from agent.core.linear_algebra import wrap
from tests.capabilities.swim.planar_tank import Fixes, Piloted, Swimmer

S = 1_000_000_000
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
        to, progress = reference(what, progress, belief.pose, round(t * S), watched)
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
            to, progress = reference(Turn(yaw_deg=90.0 * quarter), progress, (0.0, 0.0, yaw), 0)
            step = float(np.clip(wrap(to.yaw - yaw), -0.05, 0.05))
            yaw, total = wrap(yaw + step), total + step
            most = max(most, abs(total))
        assert abs(wrap(yaw - math.radians(90.0 * quarter))) < 1e-6
        assert progress.turned == pytest.approx(total)
    assert 1.9 * np.pi < most <= MOST_TURNED_RAD + 1e-6


def test_an_orbit_s_velocity_is_that_of_its_place_and_it_turns_back_in_time() -> None:
    what, h = Orbit(x_m=1.5, y_m=1.0, radius_m=0.6, speed_m_s=0.1), 1_000_000
    progress = start((1.5, 0.4, 2.0), 0.0, 0)
    looks = []
    for t_ns in range(0, 200 * S, S):
        three = (reference(what, progress, (1.5, 0.4, 2.0), t) for t in (t_ns, t_ns + h, t_ns + 2 * h))
        before, to, after = (each for each, _ in three)
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
    turned = np.cumsum(looks)
    assert max(looks) > 0 > min(looks) and np.ptp(turned) <= 2.0 * MOST_TURNED_RAD


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
        to, progress = reference(Goto(x_m=x, y_m=y), progress, pose, step * S, tank_m=tank_m)
        at = np.array([1.5, 1.0]) + step / 40.0 * (np.array([x, y]) - (1.5, 1.0))
        pose = (float(at[0]), float(at[1]), to.yaw)
        yaws.append(to.yaw)
    assert not walled_in(pose[:2], yaws[-1], tank_m)
    told, _ = reference(Goto(x_m=x, y_m=y, yaw_deg=10.0), progress, pose, S, tank_m=tank_m)
    assert told.yaw == pytest.approx(np.radians(10.0))  # whoever is told which way looks that way


def test_who_goes_through_the_middle_looks_along_the_way() -> None:
    to, _ = reference(Goto(x_m=1.9, y_m=1.1), start((1.0, 0.9, 0.0), 0.0, 0), (1.0, 0.9, 0.0), 0, tank_m=(3.0, 2.0))
    assert to.yaw == pytest.approx(np.arctan2(0.2, 0.9))
