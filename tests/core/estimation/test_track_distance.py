"""Distances of tracks in place and velocity: against matrices in numpy, and what place alone does not see."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.core.estimation.fuse import BOTH_LOW, LOW, Blocks, Opinion, distances2, doubts
from agent.core.estimation.fuse import inverse as inverse_blocks
from agent.core.estimation.track import begin, correct, predict
from agent.core.linear_algebra import apply, inverse, invert, upper

SECOND_NS = 1_000_000_000


def full(a):
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def whole(A, C, D):
    square = np.reshape(C, (3, 3))
    return np.block([[full(A), square], [square.T, full(D)]])


def sampled(samples):
    """A track through (t_s, x, R)."""
    track = None
    for t_s, x, R in samples:
        information, t_ns = inverse(upper(R)), round(t_s * 1e9)
        vector = apply(information, tuple(map(float, x)))
        track = (
            begin(t_ns, information, vector) if track is None else correct(predict(track, t_ns), information, vector)
        )
    return track


def tracks(rng, n):
    found = {}
    for k in range(n):
        root = np.linalg.qr(rng.standard_normal((3, 3)))[0] * [0.012, 0.003, 0.003]
        samples = [
            (t, [0.5 + 0.02 * t, 0.5, 0.1] + root @ rng.standard_normal(3), root @ root.T)
            for t in np.sort(rng.uniform(0.0, 20.0, int(rng.integers(1, 12))))
        ]
        found[f"r{k}"] = predict(sampled(samples), 21 * SECOND_NS)
    return found


@given(st.integers(0, 10**9), st.integers(3, 7))
@settings(max_examples=60, deadline=None)
def test_they_are_those_of_the_textbook(seed, n) -> None:
    found = tracks(np.random.default_rng(seed), n)
    state = {name: np.r_[t.x_m, t.v_m_s] for name, t in found.items()}
    P = {name: whole(t.A, t.C, t.D) for name, t in found.items()}
    got = distances2(found)
    assert list(got) == list(found)
    for name in found:
        others = [other for other in found if other != name]
        mean_P = np.linalg.inv(sum(np.linalg.inv(P[other]) for other in others))
        gap = state[name] - mean_P @ sum(np.linalg.solve(P[other], state[other]) for other in others)
        d2 = gap @ np.linalg.solve(P[name] + mean_P, gap)
        assert got[name] == pytest.approx(d2 * (LOW / BOTH_LOW) ** 2, rel=1e-6)


def test_the_inverse_of_blocks_holds_where_a_sample_was_very_sure() -> None:
    track = predict(sampled([(0.0, (0.5, 0.5, 0.1), 1e-9 * np.eye(3))]), SECOND_NS)
    back = inverse_blocks(Blocks(track.A, track.C, track.D))
    assert whole(*back) @ whole(track.A, track.C, track.D) == pytest.approx(np.eye(6), abs=1e-6)


def test_two_tracks_can_tell_nothing_about_each_other() -> None:
    assert distances2(tracks(np.random.default_rng(1), 2)) == {}


def test_a_sure_lie_stays_in_sight_though_the_track_through_it_grew_vague() -> None:
    """One sample, 30 mm off and sure to 0.3 mm, then nothing: after a second it says little of the place, and all of
    it is still in the agreed track, whose velocity the others know."""
    rng = np.random.default_rng(2)
    seen = [(float(t), (0.5 + 0.02 * t, 0.5, 0.1)) for t in range(20)]
    found = {f"r{k}": sampled([(t, x + rng.normal(0.0, 0.003, 3), 9e-6 * np.eye(3)) for t, x in seen]) for k in (1, 2)}
    lie = sampled([(18.0, (0.5 + 0.02 * 18, 0.53, 0.1), 1e-7 * np.eye(3))])
    found = {"r0": predict(lie, 19 * SECOND_NS), **found}
    opinions = [Opinion(name, t.x_m, t.A, invert(t.A)) for name, t in found.items()]
    assert doubts(opinions).strength == 0.0, "by its place alone nobody would doubt it"
    doubt = doubts(opinions, beside=distances2(found))
    assert doubt.strength == 1.0
    assert doubt.factor("r0") < 0.05
