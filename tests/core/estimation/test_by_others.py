"""Where a target is without anything that one robot measured: against an estimator that never heard of that robot."""

import itertools

import numpy as np
import pytest

from agent.core.estimation.evidence import Evidence, StaticTarget
from agent.core.estimation.evidence_table import Bounds, Table
from agent.core.estimation.interface import Prior
from agent.core.estimation.modes import Me
from agent.core.estimation.protocols import Metropolis, Paper
from agent.core.linear_algebra import upper
from agent.core.messages import Epoch, Gossip
from agent.core.trust import Authority

S = 1_000_000_000
BALL = np.array([0.7, 0.5, 0.1])
ORIGINS = (("r1", 1), ("r1", 4), ("r2", 1), ("r3", 2), ("r4", 1))  # r1 was started twice
BOUNDS = Bounds(frozenset(("r1", "r2", "r3", "r4")), (1.5, 1.2, 0.8), S)


def samples():
    """Ten of each start: (origin, incarnation) -> priors. Those of one start have one systematic error's covariance."""
    rng, found = np.random.default_rng(4), {}
    for key in ORIGINS:
        axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        systematic = axes @ np.diag([9e-6, 1e-6, 2e-6]) @ axes.T
        off = rng.multivariate_normal(np.zeros(3), systematic)
        found[key] = []
        for _ in range(10):
            root = rng.uniform(0.5, 1.5) * np.linalg.qr(rng.standard_normal((3, 3)))[0] * [0.008, 0.003, 0.003]
            at = BALL + off + root @ rng.standard_normal(3)
            found[key].append(Prior(tuple(at.tolist()), upper(root @ root.T), 0, upper(systematic)))
    return found


SAMPLES = samples()


def full(a):
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def heard_by(name, order=ORIGINS):
    """r1's or somebody's state after its own samples and all entries of others, which came in that order."""
    me = Me((name, 4), ("r2", "r3", "r4"), BOUNDS, 14, (0.0,) * 6, Authority(("r2", "r3", "r4")), ("tank", "ball"))
    state = StaticTarget(me, Epoch())
    for k, key in enumerate(order):
        if key == me.key:
            for prior in SAMPLES[key]:
                state.add(k, prior, S)
            continue
        table = Table()
        for prior in SAMPLES[key]:
            table.measure(key, prior)
        if key[0] == "r1":
            state._table.merge(table.entries[key])  # its own, of an earlier start: it comes back signed
        else:
            state.hear(key[0], Gossip(Epoch(), entries=(table.entries[key],)), S)
    return state


def test_as_one_who_never_saw_that_robot_s_samples() -> None:
    """Each robot's mean by least squares, its systematic error added once, and these together by least squares."""
    total, weighted = np.zeros((3, 3)), np.zeros(3)
    for key in ORIGINS[2:]:
        information = sum(np.linalg.inv(full(p.random_m2)) for p in SAMPLES[key])
        mean = np.linalg.solve(information, sum(np.linalg.solve(full(p.random_m2), p.x_m) for p in SAMPLES[key]))
        word = np.linalg.inv(np.linalg.inv(information) + full(SAMPLES[key][0].systematic_m2))
        total, weighted = total + word, weighted + word @ mean
    told = heard_by("r1").by_others()
    np.testing.assert_allclose(told.x_m, np.linalg.solve(total, weighted), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(full(told.cov_m2), np.linalg.inv(total), rtol=1e-9, atol=1e-18)
    assert told.x_m != heard_by("r1").conclude(True, None, S).posterior.x_m


def test_the_same_bytes_whatever_the_order_and_whatever_it_measured_itself() -> None:
    told = heard_by("r1").by_others()
    assert all(heard_by("r1", order).by_others() == told for order in itertools.permutations(ORIGINS))
    assert heard_by("r1", ORIGINS[2:]).by_others() == told
    state = heard_by("r1")
    for k in range(5):
        state.add(10 + k, Prior((0.75, 0.5, 0.1), (1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8), S), S)
        assert state.by_others() == told


def test_nobody_else_and_others_that_contradict_each_other() -> None:
    assert heard_by("r1", ORIGINS[:2]).by_others() is None
    far, near = Table(), Table()
    far.measure(("r2", 1), Prior((0.3, 0.5, 0.1), (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6), 0))
    near.measure(("r3", 1), Prior((0.7, 0.5, 0.1), (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6), 0))
    state = heard_by("r1", ORIGINS[:2])
    state.hear("r2", Gossip(Epoch(), entries=tuple(far.entries.values())), S)
    assert state.by_others().x_m == pytest.approx((0.3, 0.5, 0.1))
    state.hear("r3", Gossip(Epoch(), entries=tuple(near.entries.values())), S)
    assert state.by_others() is None


def test_none_of_a_target_that_moves_nor_from_protocols_that_average() -> None:
    one = Evidence("r1", 4, ("r2",), S, BOUNDS)
    one.begin(Epoch(counter=1, moving=True), S)
    averaging = Paper(S), Metropolis("r1", S, 1, 0.0)
    assert [each.by_others() for each in (one, *averaging)] == [None] * 3
