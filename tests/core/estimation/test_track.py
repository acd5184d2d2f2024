"""Bearings in the estimate: stacked updates, triangulation, any order, a fish that swims, links that lose."""

import math
from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from agent.core.estimation.evidence import Evidence
from agent.core.estimation.evidence_table import Bounds, sample_fault
from agent.core.estimation.interface import EstimateCache, Prior
from agent.core.estimation.track import (
    ROLLING,
    SMALL,
    FixedLagFilter,
    Growth,
    Held,
    Track,
    begin,
    correct,
    growth,
    nis_of_bearing,
    predict,
    summed,
    swimming,
)
from agent.core.linear_algebra import apply, times, upper
from agent.core.messages import Sample
from agent.core.target_state import bearing
from hw.twin.creatures import School
from hw.twin.scene import Creature, load_scene
from tests.core.estimation.linked_robots import SECOND_NS, Net, line

TANK_M = (3.0, 2.0, 0.5)
ROBOTS_M = np.array([[0.3, 0.3, 0.25], [2.7, 0.4, 0.2], [1.4, 1.8, 0.3]])
SIGMA_RAD = 0.003
FISH = swimming(0.15, 2.0)
BOUNDS = Bounds(frozenset({"r1"}), TANK_M, SECOND_NS // 5)


def full(a):
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def stacked(track):
    """State (6,) and covariance (6, 6)."""
    C = np.reshape(track.C, (3, 3))
    return np.r_[track.x_m, track.v_m_s], np.block([[full(track.A), C], [C.T, full(track.D)]])


def look(x_m, robot_m, rng, range_m=None, t_ns=0):
    """A bearing with its error, weighed by the range that is believed."""
    way = x_m - robot_m
    far = np.linalg.norm(way)
    across = np.linalg.svd(way[None])[2][1:]
    seen = way / far + rng.normal(0, SIGMA_RAD, 2) @ across
    return bearing(tuple(robot_m.tolist()), tuple(seen.tolist()), float(range_m or far), SIGMA_RAD, t_ns)


def pair(one):
    return one.information, apply(one.information, one.x_m)


def held(one):
    return Held(one.t_ns, *pair(one))


@pytest.mark.parametrize("seed", range(5))
def test_a_correction_is_the_stacked_update(seed) -> None:
    """The information filter with 6x6 matrices, by numpy; information of rank 0, 1, 2 and, badly known, 3."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) * np.repeat([0.1, 0.1], 3)[:, None]
    P, x = root @ root.T + 1e-3 * np.eye(6), rng.normal(size=6)
    track = Track(0, tuple(x[:3]), tuple(x[3:]), upper(P[:3, :3]), tuple(P[:3, 3:].ravel()), upper(P[3:, 3:]))
    x, P = stacked(track)
    for sigmas in ([], [1e-2], [3e-3, 4e-3], [3e-3, 3e-3, 20.0]):
        rays = np.linalg.qr(rng.normal(size=(3, 3)))[0][: len(sigmas)]
        Lam = sum((np.outer(e, e) / s**2 for e, s in zip(rays, sigmas, strict=True)), np.zeros((3, 3)))
        eta = Lam @ (x[:3] + rng.normal(0, 0.05, 3))
        J, y = np.linalg.inv(P), np.linalg.solve(P, x)
        J[:3, :3] += Lam
        y[:3] += eta
        got, covariance = stacked(correct(track, upper(Lam), tuple(eta.tolist())))
        np.testing.assert_allclose(covariance, np.linalg.inv(J), atol=1e-12 + 1e-11 * np.abs(P).max())
        np.testing.assert_allclose(got, np.linalg.solve(J, y), atol=1e-10)


def test_both_forms_of_a_correction_agree_where_both_can_be_used() -> None:
    """To 1e-12 of the covariance before."""
    information = upper(np.diag([1e4, 2e4, 5e3]) + 1e3)
    track = predict(begin(0, upper(np.eye(3) * 100.0), (100.0, 50.0, 20.0)), SECOND_NS, FISH)
    whole = stacked(correct(track, information, (1e4, 1.2e4, 3e3)))
    rays = np.linalg.eigh(full(information))
    parts = [upper(w * np.outer(e, e)) for w, e in zip(rays[0], rays[1].T, strict=True)]
    mean = np.linalg.solve(full(information), (1e4, 1.2e4, 3e3))
    by_ray = reduce(lambda t, part: correct(t, part, apply(part, tuple(mean))), parts, track)
    for a, b in zip(whole, stacked(by_ray), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_two_bearings_are_a_triangulation() -> None:
    """The point nearest to both lines, whichever ranges were believed: one unlike the other moves it by the weights."""
    rng, x = np.random.default_rng(1), np.array((1.2, 0.9, 0.22))
    first, second = (look(x, robot, rng) for robot in ROBOTS_M[:2])
    track = FixedLagFilter(FISH, TANK_M).run([held(first), held(second)], 0, 0)
    information, vector = summed([pair(first), pair(second)])
    nearest = np.linalg.solve(full(information), vector)
    np.testing.assert_allclose(track.x_m, nearest, atol=1e-9)
    assert np.linalg.norm(nearest - x) < 0.02
    after = FixedLagFilter(FISH, TANK_M).run([held(first), held(second._replace(t_ns=1))], 0, 1)
    np.testing.assert_allclose(after.x_m, nearest, atol=1e-4)  # the tank's word weighs next to nothing


@given(st.permutations(range(18)))
@settings(max_examples=15, deadline=None)
def test_any_order_of_arrival_gives_the_same_bytes(order) -> None:
    """Of bearings of three robots at six moments, two of each moment at once."""
    rng = np.random.default_rng(2)
    samples = {}
    for k in range(18):
        x = np.array((1.0 + 0.03 * (k // 3), 0.9, 0.22))
        one = look(x, ROBOTS_M[k % 3], rng, t_ns=(k // 3) * SECOND_NS // 5 + (k % 3 == 2))
        samples["r1", 1, k] = held(one)
    arrived = {("r1", 1, k): samples["r1", 1, k] for k in order}
    tracks = [
        FixedLagFilter(FISH, TANK_M).run([each[key] for key in sorted(each)], 2 * SECOND_NS // 5, SECOND_NS)
        for each in (samples, arrived)
    ]
    assert repr(tracks[0]) == repr(tracks[1])
    central = FixedLagFilter(FISH, TANK_M).run(samples.values(), -1, SECOND_NS)
    np.testing.assert_allclose(tracks[0].x_m, central.x_m, atol=1e-9)


def normalised(path_m, step_s, rng):
    """Normalised errors squared of the track through three robots' bearings, weighed by its own ranges."""
    tracker, track, found = FixedLagFilter(FISH, TANK_M), None, []
    for k, x in enumerate(path_m):
        t_ns = round((k + 1) * step_s * 1e9)
        ranges = [None if track is None else math.dist(track.x_m, robot) for robot in ROBOTS_M]
        seen = [look(x, robot, rng, u, t_ns) for robot, u in zip(ROBOTS_M, ranges, strict=True)]
        track = tracker.run([held(one) for one in seen], t_ns, t_ns)
        error = np.array(track.x_m) - x
        found.append(error @ np.linalg.solve(full(track.A), error))
    return np.array(found[10:])


def test_the_twins_fish_is_followed_with_the_error_that_is_claimed() -> None:
    """Normalised error squared over two minutes: 3 in the mean. It turns by another law than the track's."""
    found = []
    for seed in range(2):
        school = School([Creature(name="fish")], seed, TANK_M, load_scene("fish").solid)
        path = []
        for k in range(6000):
            school.tick(ROBOTS_M, ())
            if k % 10 == 9:
                path.append(school.attitudes[0][:3])
        found.append(normalised(np.array(path), 0.1, np.random.default_rng(seed)))
    assert 2.5 < np.concatenate(found).mean() < 3.5


def test_the_innovation_of_a_bearing_has_two_degrees_of_freedom() -> None:
    rng = np.random.default_rng(3)
    P = np.diag([4e-4, 1e-4, 2e-4])
    found = []
    for _ in range(500):
        x = np.array((1.2, 0.9, 0.22))
        believed = x + rng.normal(size=3) * np.sqrt(np.diag(P))
        track = begin(0, upper(np.linalg.inv(P)), tuple(np.linalg.solve(P, believed)))
        one = look(x, ROBOTS_M[0], rng)
        found.append(nis_of_bearing(track, one.x_m, one.information))
    assert np.mean(found) == pytest.approx(2.0, abs=0.3)


# --- between robots -----------------------------------------------------------------------------------------------


def sample(one):
    return Sample("r1", 1, 1, 0, *pair(one))


def test_a_bearing_is_believed_where_its_line_passes_the_tank() -> None:
    good = sample(bearing((0.5, 0.4, 0.2), (1.0, 0.3, 0.0), 0.8, SIGMA_RAD, 0))
    assert sample_fault(good, BOUNDS, SECOND_NS) is None
    past = sample(bearing((-0.5, 0.4, 0.2), (0.0, 1.0, 0.0), 0.8, SIGMA_RAD, 0))
    assert sample_fault(past, BOUNDS, SECOND_NS) == "outside the tank"
    plane = Sample("r1", 1, 1, 0, (1e4, 0.0, 0.0, 0.0, 0.0, 0.0), (1e4, 0.0, 0.0))
    assert sample_fault(plane, BOUNDS, SECOND_NS) == "not a covariance"
    x, y, z = good.vector
    along = Sample("r1", 1, 1, 0, good.information, (x + 1e3, y + 3e2, z))  # a place on the line, smuggled in
    assert sample_fault(along, BOUNDS, SECOND_NS) == "not a covariance"
    sure = Sample("r1", 1, 1, 0, times(100.0, good.information), tuple(100.0 * v for v in good.vector))
    assert sample_fault(sure, BOUNDS, SECOND_NS) == "too sure"


def test_a_target_that_swims_moves_from_the_first_and_never_rests() -> None:
    def robot(dynamics):
        return Evidence("r1", 1, (), SECOND_NS, BOUNDS, dynamics=dynamics)

    assert not robot(ROLLING).epoch.moving
    fish, box = robot(FISH), EstimateCache("tank", "r1", "fish", ())
    assert fish.epoch == (epoch := type(fish.epoch)(1, True))
    cov_m2 = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
    for k in range(1, 45):
        fish.tick(Prior((1.0, 1.0, 0.2), cov_m2, k * SECOND_NS), box, k * SECOND_NS)
    assert fish.epoch == epoch and not fish._vote.shown(45 * SECOND_NS)


@pytest.fixture
def shoal(monkeypatch):
    """Robots of a net whose target swims."""
    made = Evidence.__init__
    monkeypatch.setattr(Evidence, "__init__", lambda self, *a, **k: made(self, *a, **{"dynamics": FISH, **k}))
    return Net({name: near for name, near in line(3).items()}, loss=0.3, rounds=5)


def test_bearings_of_three_robots_find_it_over_links_that_lose_a_third(shoal) -> None:
    """None of them could alone. It swims along the middle at 2 cm/s, an iteration a second."""
    rng = np.random.default_rng(4)
    cameras = dict(zip(shoal.links, ((0.2, 0.2, 0.2), (1.3, 0.2, 0.3), (0.7, 1.1, 0.2)), strict=True))
    for k in range(12):
        x = np.array((0.5 + 0.02 * k, 0.6, 0.25))
        priors = {name: look(x, np.array(at), rng, t_ns=shoal.now_ns) for name, at in cameras.items()}
        updates = shoal.tick(priors)
    assert {update.explain.status for update in updates.values()} == {"ok"}
    for robot in shoal.robots.values():
        found = robot._mode.conclude(True, None, shoal.now_ns - SECOND_NS).posterior
        error = np.array(found.x_m) - x
        assert np.linalg.norm(error) < 0.02
        assert error @ np.linalg.solve(full(found.cov_m2), error) < 16.3  # chi^2, 3 degrees of freedom, 0.999
    alone = FixedLagFilter(FISH, (1.5, 1.2, 0.8))
    track = alone.run([held(look(x, np.array((0.2, 0.2, 0.2)), rng))], 0, 0)
    assert math.sqrt(max(np.linalg.eigvalsh(full(track.A)))) > 0.3


# --- dynamics ---
# How a target moves unseen: the closed form against integrals, many short steps, and drawn paths.

DYNAMICS_FISH = swimming(0.2, 2.0)


def test_a_fish_of_20_cm_a_second_in_the_plane() -> None:
    assert DYNAMICS_FISH.first_speed_m_s == pytest.approx(0.2 / math.sqrt(2))
    assert DYNAMICS_FISH.psd_m2_s3 == pytest.approx(2e-2)


@pytest.mark.parametrize("h_s", [1e-6, 1e-3, SMALL * 2.0 * 0.999, SMALL * 2.0 * 1.001, 0.2, 3.0, 60.0])
def test_what_a_step_brings_is_the_integral(h_s) -> None:
    """Place and velocity answer an impulse of dW that is s old with T (1 - e^(-s/T)) and e^(-s/T)."""
    q, T, _ = DYNAMICS_FISH

    def answer(s):
        return -T * math.expm1(-s / T), math.exp(-s / T)

    def variance(i, j):
        return q * quad(lambda s: answer(s)[i] * answer(s)[j], 0, h_s, epsrel=1e-12, epsabs=0)[0]

    assert growth(DYNAMICS_FISH, h_s) == pytest.approx(
        Growth(*answer(h_s), variance(0, 0), variance(0, 1), variance(1, 1)), rel=1e-9
    )


def test_two_steps_are_one_and_slow_turning_is_a_random_walk() -> None:
    track = Track(0, (1.0, 0.5, 0.2), (0.1, -0.05, 0.0), (1e-4, 1e-5, 0.0, 2e-4, 0.0, 1e-4), (1e-5,) * 9, (0.02,) * 6)
    once, twice = (
        predict(track, 10**9, DYNAMICS_FISH),
        predict(predict(track, 3 * 10**8, DYNAMICS_FISH), 10**9, DYNAMICS_FISH),
    )
    for a, b in zip(once, twice, strict=True):
        assert a == pytest.approx(b, rel=1e-12, abs=1e-16)
    slow, rolling = predict(track, 10**9, ROLLING._replace(turn_s=1e7)), predict(track, 10**9, ROLLING)
    assert (slow.x_m, slow.v_m_s) == (pytest.approx(rolling.x_m, rel=1e-6), pytest.approx(rolling.v_m_s, rel=1e-6))
    for a, b in zip(slow[3:], rolling[3:], strict=True):
        assert a[:-1] == pytest.approx(b[:-1], rel=1e-6), "the last one, upwards, grows less"
        assert a[-1] < b[-1]


def test_drawn_paths_spread_as_the_covariance_says() -> None:
    """20 000 of them, in steps of 5 ms by Euler and Maruyama; from rest, which is no steady state."""
    rng, (q, T, _), h_s, n = np.random.default_rng(0), DYNAMICS_FISH, 0.005, 20_000
    x, v = np.zeros(n), np.full(n, 0.1)
    for _ in range(200):
        x += h_s * v
        v += -v * h_s / T + math.sqrt(q * h_s) * rng.standard_normal(n)
    start = Track(0, (0.0,) * 3, (0.1,) * 3, (0.0,) * 6, (0.0,) * 9, (0.0,) * 6)
    track = predict(start, 10**9, DYNAMICS_FISH)
    assert np.mean(x) == pytest.approx(track.x_m[0], abs=4 * math.sqrt(track.A[0] / n) + 2e-4)
    assert np.mean(v) == pytest.approx(track.v_m_s[0], abs=4 * math.sqrt(track.D[0] / n) + 2e-4)
    assert [np.var(x), np.cov(x, v)[0, 1], np.var(v)] == pytest.approx([track.A[0], track.C[0], track.D[0]], rel=0.04)


def test_unseen_for_long_its_speed_is_as_unknown_as_at_first() -> None:
    track = predict(Track(0, (0.0,) * 3, (0.3,) * 3, (0.0,) * 6, (0.0,) * 9, (0.0,) * 6), 60 * 10**9, DYNAMICS_FISH)
    assert pytest.approx([DYNAMICS_FISH.first_speed_m_s**2 * i for i in (1, 0, 0, 1, 0, 0.09)], abs=1e-12) == track.D
    assert track.v_m_s == pytest.approx((0, 0, 0), abs=1e-12)
