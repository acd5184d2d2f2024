"""What a neighbour is owed: nothing is given up before it is shown, the longest unsent goes first, restarts owe all."""

import math
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.core.estimation.evidence_table import Bounds
from agent.core.estimation.interface import Prior
from agent.core.estimation.modes import DIGEST_NS, LINES, DeliveryLedger
from agent.core.estimation.motion import BATCH, Innovation, Motion
from agent.core.estimation.moving_target import WINDOW, Window
from agent.core.estimation.track import ROLLING, FixedLagFilter, Held, begin, correct, nis, predict
from agent.core.linear_algebra import apply, inverse, upper
from agent.core.messages import MAX_PAYLOAD, Epoch, Holding, Sample
from tests.core.estimation.linked_robots import NAMES, Net, line

OWN = ("r0", 1)
KEYS = [(f"r{k}", 1) for k in range(9)]


@given(st.integers(1, 4), st.lists(st.booleans(), min_size=60, max_size=60))
@settings(max_examples=60, deadline=None)
def test_whatever_is_lost_everything_arrives_and_own_evidence_goes_first(limit, arrives) -> None:
    ledger, there, versions = DeliveryLedger(), set(), dict.fromkeys(KEYS, 3)
    for arrived in [*arrives, *[True] * len(KEYS)]:
        chosen = ledger.pending(versions, OWN, limit)
        assert len(chosen) <= limit
        if OWN not in there:
            assert chosen[0] == OWN
        if arrived:
            there.update(chosen)
            for key in chosen:
                ledger.acknowledge(key, 3)
    assert there == set(KEYS)
    assert ledger.pending(versions, OWN, limit) == []


@given(st.integers(2, 4), st.integers(1, 30))
@settings(max_examples=40, deadline=None)
def test_without_an_answer_everything_goes_out_in_turns_longest_unsent_first(limit, rounds) -> None:
    ledger, sent = DeliveryLedger(), dict.fromkeys(KEYS, -1)
    for turn in range(rounds):
        chosen = ledger.pending(dict.fromkeys(KEYS, 1), OWN, limit)
        assert chosen[0] == OWN
        others = [key for key in KEYS if key not in chosen]
        assert max(sent[key] for key in chosen[1:]) <= min(sent[key] for key in others)
        sent |= dict.fromkeys(chosen, turn)


def test_an_older_version_in_a_digest_makes_it_owed_again_and_so_does_a_restart() -> None:
    ledger = DeliveryLedger()
    ledger.acknowledge(OWN, 5)
    assert ledger.pending({OWN: 5}, OWN, 4) == []
    ledger.acknowledge(OWN, 4)
    assert ledger.pending({OWN: 5}, OWN, 4) == [OWN]
    ledger.acknowledge(OWN, 5)
    ledger.forget()
    assert ledger.pending({OWN: 5}, OWN, 4) == [OWN]


def test_news_goes_between_two_rounds_and_again_when_a_round_of_its_own_has_passed_unanswered() -> None:
    ledger, old, new = DeliveryLedger(), KEYS[3], KEYS[5]
    versions = dict.fromkeys((old, new), 2)
    ledger.changed(new, 2, told=False)
    assert list(ledger.news) == [new]
    assert ledger.pending(versions, OWN, 1) == [new], "news comes before what is merely owed"
    ledger.changed(new, 2, told=False)
    assert ledger.pending({key: 2 for key in ledger.news}, OWN, 4, between=True) == [new] and not ledger.news
    assert ledger.pending(versions, OWN, 4) == [old], "it was sent a moment ago"
    assert set(ledger.pending(versions, OWN, 4)) == {old, new}
    ledger.changed(new, 3, told=False)
    ledger.acknowledge(new, 2)
    assert list(ledger.news) == [new]
    ledger.acknowledge(new, 3)
    assert not ledger.news
    ledger.changed(new, 3, told=False)
    assert not ledger.news, "the neighbour showed it before it came to us"


def test_what_many_are_told_at_a_time_is_not_sent_again_before_a_digest_can_have_shown_it() -> None:
    ledger, versions = DeliveryLedger(), {(f"r{k}", 1): 1 for k in range(3 * LINES)}
    sent = [ledger.pending(versions, ("", 0), 3 * LINES) for _ in range(5)]
    assert [len(each) for each in sent] == [3 * LINES, 0, 0, 0, 3 * LINES]


def test_a_digest_goes_out_on_change_once_a_second_and_after_a_restart() -> None:
    ledger, lines = DeliveryLedger(), [Holding("r0", 1, 3)]
    assert lines[ledger.due(len(lines), 1, 0)] == lines
    assert lines[ledger.due(len(lines), 1, DIGEST_NS // 2)] == []
    assert lines[ledger.due(len(lines), 2, DIGEST_NS // 2)] == lines
    assert lines[ledger.due(len(lines), 2, DIGEST_NS // 2 + DIGEST_NS)] == lines
    ledger.forget()
    assert lines[ledger.due(len(lines), 2, DIGEST_NS // 2 + DIGEST_NS + 1)] == lines


def test_a_long_digest_goes_out_in_turns_that_leave_nothing_out() -> None:
    ledger, lines = DeliveryLedger(), [Holding("r0", k, 1) for k in range(2 * LINES + 5)]
    shown = [line for _ in range(3) for line in lines[ledger.due(len(lines), 1, 0)]]
    assert shown == lines


def test_what_left_the_table_is_forgotten() -> None:
    ledger = DeliveryLedger()
    ledger.acknowledge(OWN, 7)
    ledger.drop({})
    assert ledger.pending({OWN: 7}, OWN, 4) == [OWN]


# --- motion ---
# Moving targets: the window is the central filter, late news included; the swarm notices motion, and rest.

SECOND_NS = 1_000_000_000
BOUNDS = Bounds(frozenset({"r1", "r2", "r3"}), (10.0, 10.0, 10.0), SECOND_NS)
COV = (1e-4, 2e-5, 0.0, 2e-4, 0.0, 5e-5)
INFORMATION = inverse(COV)


def full(a):
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def take(window, sample, arrived_ns):
    """What a robot does with a neighbour's sample; returns what is wrong with it."""
    if (sample.origin, sample.incarnation, sample.number) in window.samples:
        return window.earlier(sample, arrived_ns)
    return window.fault(sample, arrived_ns) or window.merge(sample, arrived_ns, 0, direct=False)


def kalman(samples):
    """The textbook filter with 6x6 matrices over (t_s, z); returns state and covariance at the last sample."""
    R, H = full(COV), np.hstack([np.eye(3), np.zeros((3, 3))])
    (t, z), *rest = samples
    x, P = np.r_[z, np.zeros(3)], np.zeros((6, 6))
    P[:3, :3], P[3:, 3:] = R, ROLLING.first_speed_m_s**2 * np.eye(3)
    for then, z in rest:
        dt, t = then - t, then
        F = np.eye(6)
        F[:3, 3:] = dt * np.eye(3)
        Q = ROLLING.psd_m2_s3 * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(3))
        x, P = F @ x, F @ P @ F.T + Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x, P = x + K @ (z - H @ x), (np.eye(6) - K @ H) @ P
    return x, P


def path(rng, n):
    times = np.cumsum(rng.uniform(0.2, 1.5, n)).round(3)
    return [(float(t), np.array([0.5 + 0.02 * t, 0.5, 0.1]) + rng.normal(0, 0.01, 3)) for t in times]


def test_the_track_is_the_textbook_filter() -> None:
    samples = path(np.random.default_rng(1), 12)
    x, P = kalman(samples)
    track = None
    for t, z in samples:
        t_ns, vector = round(t * 1e9), apply(INFORMATION, tuple(z))
        track = (
            begin(t_ns, INFORMATION, vector) if track is None else correct(predict(track, t_ns), INFORMATION, vector)
        )
    assert track.x_m == pytest.approx(x[:3], abs=1e-9)
    assert track.v_m_s == pytest.approx(x[3:], abs=1e-9)
    assert full(track.A) == pytest.approx(P[:3, :3], abs=1e-12)
    assert np.reshape(track.C, (3, 3)) == pytest.approx(P[:3, 3:], abs=1e-12)
    assert full(track.D) == pytest.approx(P[3:, 3:], abs=1e-12)
    gap = np.array([0.01, 0.0, 0.0])
    expected = gap @ np.linalg.solve(P[:3, :3] + full(COV), gap)
    assert nis(track, tuple(x[:3] + gap), COV) == pytest.approx(expected, rel=1e-6)


@given(st.permutations(range(20)), st.lists(st.integers(0, 19), max_size=10))
@settings(max_examples=40, deadline=None)
def test_samples_in_any_order_and_repeated_give_the_same_track(order, repeated) -> None:
    samples = path(np.random.default_rng(2), 20)
    said = [
        Sample(f"r{1 + k % 3}", 1, 1 + k, round((samples[-1][0] - t) * 1e9), INFORMATION, apply(INFORMATION, tuple(z)))
        for k, (t, z) in enumerate(samples)
    ]
    now_ns = round(samples[-1][0] * 1e9)
    window = Window(BOUNDS._replace(iteration_ns=100 * SECOND_NS))  # a window that holds them all
    for k in (*order, *repeated):
        assert take(window, said[k], now_ns) is None
    x, _ = kalman(samples)
    fresh = [held for origin in window.fresh().values() for held in origin]
    assert FixedLagFilter().run(fresh, window.horizon_ns(now_ns), now_ns).x_m == pytest.approx(x[:3], abs=1e-9)


def test_freezing_changes_nothing_but_the_work() -> None:
    samples = path(np.random.default_rng(3), 60)
    window, lagged = Window(BOUNDS), FixedLagFilter()
    for k, (t, z) in enumerate(samples):
        t_ns = round(t * 1e9)
        window.measure(("r1", 1, 1 + k), Held(t_ns, INFORMATION, apply(INFORMATION, tuple(z))))
        track = lagged.run(window.fresh()["r1"], window.horizon_ns(t_ns), t_ns)
        window.freeze(window.horizon_ns(t_ns))
        assert len(window.samples) <= 2 * WINDOW * 5
    x, _ = kalman(samples)
    assert track.x_m == pytest.approx(x[:3], abs=1e-9)
    late = Sample("r2", 1, 1, 40 * SECOND_NS, INFORMATION, (0.0, 0.0, 0.0))
    assert take(window, late, round(samples[-1][0] * 1e9)) == "too late"


def test_ages_add_up_over_relays_whose_clocks_disagree() -> None:
    """Exposed at 100 s of r1; r2 is an hour ahead and holds it 2 s, r3 half an hour behind."""
    hour_ns, half_ns = 3600 * SECOND_NS, -1800 * SECOND_NS
    r1, r2, r3 = Window(BOUNDS), Window(BOUNDS), Window(BOUNDS)
    key = ("r1", 1, 1)
    r1.measure(key, Held(100 * SECOND_NS, INFORMATION, apply(INFORMATION, (0.5, 0.5, 0.1))))
    take(r2, r1.sample(key, 101 * SECOND_NS), 101 * SECOND_NS + hour_ns)
    take(r3, r2.sample(key, 103 * SECOND_NS + hour_ns), 103 * SECOND_NS + half_ns)
    assert r3.samples[key].t_ns == 100 * SECOND_NS + half_ns


def test_a_digest_names_each_sample_that_is_held() -> None:
    window = Window(BOUNDS)
    for number in (3, 4, 7):
        window.measure(("r1", 1, number), Held(number * SECOND_NS, INFORMATION, (0.0, 0.0, 0.0)))
    (line,) = window.digest()
    assert line.newest == 7
    assert line.older == 0b1100  # 6 and 5 are missing, 4 and 3 are there


def test_half_a_minute_in_one_place_is_rest() -> None:
    motion, step = Motion(), (0.01, 0.01, 0.01)
    for _ in range(BATCH):
        motion.tracked(Innovation(step, upper(0.01**2 * np.eye(3)), 3.0))
    for t in range(40):
        motion.place(t * SECOND_NS, (0.5 + 0.02 * t, 0.5, 0.1))
    assert not motion.rests(39 * SECOND_NS)
    for t in range(40, 72):
        motion.place(t * SECOND_NS, (1.3, 0.5, 0.1))
    assert motion.rests(71 * SECOND_NS)


def test_a_swarm_follows_a_target_that_starts_and_stops() -> None:
    sigma, random = 0.005, Random(4)
    cov, net = upper(sigma**2 * np.eye(3)), Net(line(4), loss=0.2, rounds=3)
    x, moving_from, errors = 0.2, None, []
    for t in range(110):
        x += 0.02 if 20 <= t < 60 else 0.0
        place = {n: (x + random.gauss(0, sigma), 0.5 + random.gauss(0, sigma), 0.1) for n in NAMES[1:4]}
        net.tick({n: Prior(p, cov, net.now_ns) for n, p in place.items()})
        robots = list(net.robots.values())
        if t == 20:
            assert {robot.epoch for robot in robots} == {Epoch()}
        if moving_from is None and all(robot.epoch.moving for robot in robots):
            moving_from = t
        if 45 <= t < 60:
            read_m = (x + 0.02 * 2 / 3, 0.5, 0.1)  # the last of three rounds of messages is over
            errors += [math.dist(r.posterior.x_m, read_m) for r in robots]
    assert moving_from is not None
    assert moving_from - 20 <= 2 * BATCH + 5
    assert math.sqrt(np.mean(np.square(errors))) < 0.01
    (epoch,) = {robot.epoch for robot in robots}
    assert not epoch.moving
    assert epoch.counter >= 2
    assert all(math.dist(r.posterior.x_m, (x, 0.5, 0.1)) < 0.005 for r in robots)
    assert max(net.sizes) < MAX_PAYLOAD // 2


def chased(names, seconds, wrong):
    """A full graph after a chase along x in which `wrong`(name, t) shifts what a robot measures, along y."""
    net, random = Net({n: tuple(m for m in names if m != n) for n in names}, loss=0.2), Random(6)
    for robot in net.robots.values():
        robot.begin(Epoch(1, True, names[0]), net.now_ns)
    for t in range(seconds):
        x = 0.2 + 0.02 * t
        place = {n: (x + random.gauss(0, 0.005), 0.5 + random.gauss(0, 0.005) + wrong(n, t), 0.1) for n in names}
        updates = net.tick({n: Prior(p, upper(0.005**2 * np.eye(3)), net.now_ns) for n, p in place.items()})
    return net, updates, (x, 0.5, 0.1)


@pytest.mark.parametrize("since", [0, 20])
def test_a_robot_that_is_wrong_does_not_pull_the_track(since) -> None:
    """It is wrong from the start, or from one day to the other."""
    net, updates, truth_m = chased(NAMES[:4], 40, lambda name, t: 0.3 * (name == "r01" and t >= since))
    for name in ("r00", "r02", "r03"):
        assert updates[name].explain.status == "outlier"
        assert updates[name].explain.doubted == {"r01": 0.0}
        assert "r01" not in updates[name].explain.weights
        assert math.dist(net.robots[name].posterior.x_m, truth_m) < 0.015
    assert updates["r01"].alpha == 0.0


def test_a_robot_that_is_wrong_by_less_than_the_vote_can_tell_is_left_out_by_degrees() -> None:
    """34 mm of samples with 5 mm: one that lacks its newest sample can say less against it than the others."""
    names = NAMES[:5]
    net, updates, truth_m = chased(names, 40, lambda name, t: 0.034 * (name == "r04" and t >= 20))
    for name in names[:4]:
        explain = updates[name].explain
        assert explain.status == "ok"
        assert 0.0 < explain.doubted["r04"] < 1.0
        assert explain.weights["r04"] < 0.95 / len(names)
        assert sum(explain.weights.values()) == pytest.approx(1.0)
        assert abs(net.robots[name].posterior.x_m[1] - truth_m[1]) < 0.002, "a fifth of it would be 6.8 mm"
    assert min(updates[name].explain.doubted["r04"] for name in names[:4]) < 0.05


def test_the_first_to_see_is_wrong_and_is_outvoted_by_those_who_come_later() -> None:
    names = NAMES[:3]
    net = Net({n: tuple(m for m in names if m != n) for n in names})
    for robot in net.robots.values():
        robot.begin(Epoch(1, True, "r00"), net.now_ns)
    for t in range(60):
        place = {"r00": (0.9, 0.8, 0.1)} | ({n: (0.9, 0.5, 0.1) for n in names[1:]} if t >= 45 else {})
        net.tick({n: Prior(p, COV, net.now_ns) for n, p in place.items()})
    for name in names[1:]:
        assert net.robots[name].posterior.x_m == pytest.approx((0.9, 0.5, 0.1), abs=0.005)


def test_two_that_chase_and_disagree_each_keep_their_own() -> None:
    net, updates, _ = chased(NAMES[:2], 25, lambda name, t: 0.3 * (name == "r01"))
    assert {update.rule for update in updates.values()} == {"ambiguous"}
    assert net.robots["r00"].posterior.x_m[1] == pytest.approx(0.5, abs=0.02)
    assert net.robots["r01"].posterior.x_m[1] == pytest.approx(0.8, abs=0.02)


def test_a_target_that_nobody_sees_any_more_is_held_where_it_was() -> None:
    net, random = Net(line(2)), Random(5)
    for robot in net.robots.values():
        robot.begin(Epoch(1, True, "r00"), net.now_ns)
    for t in range(15):
        x = 0.9 + 0.02 * t + random.gauss(0, 0.001)
        net.tick({"r00": Prior((x, 0.5, 0.1), COV, net.now_ns)})
    for _ in range(WINDOW + 30):
        updates = net.tick({})
    assert updates["r01"].rule == "hold"
    assert net.robots["r01"].posterior.x_m[0] < 1.7, "a tank of 1.5 m and its margin"
