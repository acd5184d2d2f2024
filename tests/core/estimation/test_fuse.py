"""Vote and leaving out: against formulas in numpy, against least squares where all are honest, against liars."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.core.estimation import fuse as fusing
from agent.core.estimation.fuse import (
    AGREE,
    BOTH_LOW,
    HIGH,
    LOW,
    TEMPER,
    Blocks,
    Opinion,
    Shared,
    distances2,
    doubts,
    fuse,
    parts,
    stretch,
)
from agent.core.estimation.fuse import inverse as inverse_blocks
from agent.core.estimation.track import begin, correct, predict
from agent.core.linear_algebra import apply, inverse, invert, upper

RNG = np.random.default_rng(5)


def opinion(name, x, cov) -> Opinion:
    packed = upper(cov)
    return Opinion(name, tuple(float(v) for v in x), packed, inverse(packed))


def crowd(n, rng, spread=1.0):
    """Honest opinions about (0.7, 0.5, 0.1) with covariances of a few mm along random rays."""
    truth, found = np.array([0.7, 0.5, 0.1]), []
    for k in range(n):
        root = np.linalg.qr(rng.standard_normal((3, 3)))[0] * [0.012, 0.003, 0.003]
        found.append(opinion(f"r{k:03d}", truth + spread * root @ rng.standard_normal(3), root @ root.T))
    return found


def full(a):
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def mean(opinions):
    """Weighted least squares: (x, P)."""
    P = np.linalg.inv(sum(np.linalg.inv(full(o.cov_m2)) for o in opinions))
    return P @ sum(np.linalg.solve(full(o.cov_m2), o.x_m) for o in opinions), P


def chi2(opinions):
    x, _ = mean(opinions)
    return sum((o.x_m - x) @ np.linalg.solve(full(o.cov_m2), o.x_m - x) for o in opinions)


def apart2(a, b):
    gap = np.subtract(a.x_m, b.x_m)
    return gap @ np.linalg.solve(full(a.cov_m2) + full(b.cov_m2), gap)


def textbook(opinions, size=1):
    """The rule in matrices: (x, P, factor of each). Chi^2 falls by d^2 when `size` of the group go."""
    near = [[k for k, b in enumerate(opinions) if k == j or apart2(a, b) < AGREE] for j, a in enumerate(opinions)]
    inside = [sum(apart2(opinions[j], opinions[k]) for j, k in combinations(group, 2)) for group in near]
    best = min(range(len(near)), key=lambda j: (-len(near[j]), inside[j], j))
    group = [opinions[k] for k in near[best]]
    x, P = mean(group)
    factors = {o.origin: float(o in group) for o in opinions}
    if len(group) < 3:
        return x, P, factors
    ways = [[o for o in group if o not in out] for out in combinations(group, size)]
    d2 = np.array([chi2(group) - chi2(kept) for kept in ways])
    b = np.clip((np.sqrt(d2.max() / size) - LOW) / (HIGH - LOW), 0.0, 1.0)
    p = np.exp(-TEMPER * (d2.max() - d2) / 2)
    weights = [1.0 - b, *(b * p / p.sum())]
    places = [(x, P), *(mean(kept) for kept in ways)]
    x = sum(w * place for w, (place, _) in zip(weights, places, strict=True))
    spread = [cov + np.outer(place - x, place - x) for place, cov in places]
    for w, kept in zip(weights[1:], ways, strict=True):
        for o in group:
            factors[o.origin] -= w * (o not in kept)
    return x, sum(w * cov for w, cov in zip(weights, spread, strict=True)), factors


def swayed(rng, n):
    """Honest opinions but for one or two that stand 0 to 8 sigma off and claim to know anything from little to all."""
    found = crowd(n, rng)
    for k in range(min(n, int(rng.integers(0, 3)))):
        root = np.linalg.cholesky(full(found[k].cov_m2))
        off = root @ rng.standard_normal(3) * rng.uniform(0.0, 4.0)
        found[k] = opinion(found[k].origin, found[k].x_m + off, 10 ** rng.uniform(-3, 1) * root @ root.T)
    return found


# --- the rule -------------------------------------------------------------------------------------------------


@given(st.integers(0, 10**9), st.integers(1, 10))
@settings(max_examples=200, deadline=None)
def test_it_is_the_rule_of_the_textbook(seed, n) -> None:
    opinions = swayed(np.random.default_rng(seed), n)
    fused, (x, P, factors) = fuse(opinions), textbook(opinions)
    assert fused.x_m == pytest.approx(x, abs=1e-9)
    assert full(fused.cov_m2) == pytest.approx(P, rel=1e-6, abs=1e-9)
    assert fused.factors == pytest.approx(factors, abs=1e-6)
    assert math.fsum(fused.shares.values()) == pytest.approx(1.0)


@given(st.integers(0, 10**9), st.integers(7, 10))
@settings(max_examples=60, deadline=None)
def test_two_are_left_out_where_two_may_lie(seed, n) -> None:
    opinions = swayed(np.random.default_rng(seed), n)
    fused, (x, P, factors) = fuse(opinions, liars=2), textbook(opinions, size=2)
    if len([f for f in factors.values() if f > 0.0]) < fusing.PAIRS[0]:
        return  # the vote left too few to look for two
    assert fused.x_m == pytest.approx(x, abs=1e-9)
    assert full(fused.cov_m2) == pytest.approx(P, rel=1e-6, abs=1e-9)
    assert fused.factors == pytest.approx(factors, abs=1e-6)


def test_the_draws_of_these_tests_reach_every_part_of_the_rule() -> None:
    """Nobody stands out; somebody may; somebody does; the vote leaves one out; the vote is tied."""
    strengths, left_out = [], 0
    for seed in range(300):
        opinions = swayed(np.random.default_rng(seed), 3 + seed % 6)
        fused = fuse(opinions)
        left_out += 0.0 in fused.factors.values()
        strengths.append(doubts([o for o in opinions if fused.factors[o.origin] > 0.0]).strength)
    assert strengths.count(0.0) > 50
    assert strengths.count(1.0) > 5
    assert sum(0.0 < s < 1.0 for s in strengths) > 50
    assert left_out > 20


def test_close_opinions_give_the_weighted_least_squares_mean() -> None:
    near = crowd(6, RNG, spread=0.3)  # nobody stands out
    precision = sum(full(o.precision) for o in near)
    mean = np.linalg.solve(precision, sum(full(o.precision) @ o.x_m for o in near))
    fused = fuse(near)
    assert fused.verdict == "ok"
    assert fused.x_m == pytest.approx(mean, abs=1e-12)
    assert full(fused.cov_m2) == pytest.approx(np.linalg.inv(precision), rel=1e-9)
    assert math.fsum(fused.shares.values()) == pytest.approx(1.0)


def test_the_shared_error_is_added_and_cannot_be_averaged_away() -> None:
    place_m2 = (1e-6, 0.0, 0.0, 1e-6, 0.0, 4e-6)
    opinions = crowd(4, RNG)
    assert np.subtract(fuse(opinions, Shared(place_m2)).cov_m2, fuse(opinions).cov_m2) == pytest.approx(place_m2)


SCALE, SPREADS = 0.01, {"around": 2.0 * math.pi, "one side": 0.7}


def watchers(n, spread_rad, rng, scale=SCALE, eps=0.0):
    """Opinions of robots 0.6 m from the target, whose ranges are all long by eps."""
    truth, found = np.array([0.7, 0.5, 0.1]), []
    for k in range(n):
        angle = spread_rad * k / n
        lever = 0.6 * np.array([math.cos(angle), math.sin(angle), 0.1])
        root = np.linalg.qr(np.column_stack([lever, *rng.standard_normal((2, 3))]))[0] * [0.002, 0.001, 0.001]
        own = root @ root.T
        of = opinion(f"r{k:03d}", truth + eps * lever + root @ rng.standard_normal(3), own + scale**2 * outer(lever))
        found.append(of._replace(lever_m=tuple(lever.tolist()), random_m2=upper(0.25 * own)))
    return found


def outer(v):
    return np.outer(v, v)


@pytest.mark.parametrize("n", [3, 15])
@pytest.mark.parametrize("where", SPREADS)
def test_one_scale_of_all_ranges_is_in_the_mean_as_in_matrices(where: str, n: int) -> None:
    group = watchers(n, SPREADS[where], np.random.default_rng(7))
    P = np.linalg.inv(sum(np.linalg.inv(full(o.cov_m2)) for o in group))
    W = [P @ np.linalg.inv(full(o.cov_m2)) for o in group]
    g = sum(w @ o.lever_m for w, o in zip(W, group, strict=True))
    own = [full(o.cov_m2) - SCALE**2 * outer(o.lever_m) for o in group]
    expected = sum(w @ r @ w.T for w, r in zip(W, own, strict=True)) + SCALE**2 * outer(g)
    fused = fuse(group, Shared(scale=SCALE))
    if all(factor == 1.0 for factor in fused.factors.values()):
        assert full(fused.cov_m2) == pytest.approx(expected, rel=1e-9, abs=1e-15)
    random_m2 = sum(np.trace(w @ r @ w.T) for w, r in zip(W, own, strict=True)) / 4.0
    assert parts(group, Shared(scale=SCALE)) == pytest.approx(
        (random_m2, 3.0 * random_m2, SCALE**2 * float(g @ g), 0.0)
    )


@pytest.mark.parametrize("n", [3, 15])
def test_by_how_much_all_ranges_are_long_is_fitted_with_the_place_by_least_squares(n: int) -> None:
    """By what each robot has for itself; the scale that robots allow for is added to the sigma."""
    group = watchers(n, SPREADS["around"], np.random.default_rng(8), eps=0.03)
    N, b = np.zeros((4, 4)), np.zeros(4)
    for o in group:
        D = np.column_stack([np.eye(3), o.lever_m])
        weight = np.linalg.inv(full(o.cov_m2) - SCALE**2 * outer(o.lever_m))
        N, b = N + D.T @ weight @ D, b + D.T @ weight @ o.x_m
    eps, sigma = stretch(group, Shared(scale=SCALE))
    assert eps == pytest.approx(np.linalg.solve(N, b)[3], rel=1e-6)
    assert sigma == pytest.approx(math.sqrt(np.linalg.inv(N)[3, 3] + SCALE**2), rel=1e-6)


@pytest.mark.parametrize("n", [3, 15])
@pytest.mark.parametrize("where", SPREADS)
def test_a_fleet_whose_ranges_are_all_long_says_so_in_its_sigma(where: str, n: int) -> None:
    """Mean NEES 3: on one side fifteen robots know no more of the range than one."""
    rng, nees, blind = np.random.default_rng(n), [], []
    for _ in range(300):
        eps = SCALE * rng.standard_normal()
        fused = fuse(watchers(n, SPREADS[where], rng, eps=eps), Shared(scale=SCALE))
        unaware = fuse(watchers(n, SPREADS[where], rng, scale=0.0, eps=eps))
        for found, of in ((nees, fused), (blind, unaware)):
            error = np.subtract(of.x_m, (0.7, 0.5, 0.1))
            found.append(error @ np.linalg.solve(full(of.cov_m2), error))
    assert 2.4 <= np.mean(nees) <= 3.6
    assert np.mean(blind) > 9.0 or where == "around"


@pytest.mark.parametrize("n", [3, 5, 80])
def test_one_liar_is_left_out_however_sure_it_is(n) -> None:
    opinions = crowd(n, np.random.default_rng(1), spread=0.5)
    liar = opinion("r001", np.add(opinions[1].x_m, (0.3, 0.0, 0.0)), 1e-6 * np.eye(3))
    fused = fuse([opinions[0], liar, *opinions[2:]])
    honest = fuse([opinions[0], *opinions[2:]])
    assert fused.verdict == "outlier"
    assert fused.factors["r001"] == 0.0
    assert fused.x_m == pytest.approx(honest.x_m, abs=1e-12)


def test_two_that_disagree_are_ambiguous_and_one_alone_is_single() -> None:
    a = opinion("a", (0.5, 0.5, 0.1), 1e-5 * np.eye(3))
    b = opinion("b", (0.8, 0.5, 0.1), 1e-5 * np.eye(3))
    assert fuse([a, b]).verdict == "ambiguous"
    assert fuse([a]).verdict == "single"
    assert fuse([]) is None


def test_two_against_two_is_no_majority() -> None:
    pair = [opinion(n, (x, 0.5, 0.1), 1e-5 * np.eye(3)) for n, x in zip("abcd", (0.5, 0.501, 0.8, 0.801), strict=True)]
    fused = fuse(pair)
    assert fused.verdict == "ambiguous"
    assert fused.votes == {"a": 2, "b": 2, "c": 2, "d": 2}


@given(st.integers(0, 10**6), st.integers(2, 8))
@settings(max_examples=60, deadline=None)
def test_it_turns_with_the_world_and_does_not_care_for_names(seed, n) -> None:
    rng = np.random.default_rng(seed)
    opinions = swayed(rng, n)
    turn, shift = np.linalg.qr(rng.standard_normal((3, 3)))[0], rng.standard_normal(3)
    moved = [opinion(o.origin, turn @ o.x_m + shift, turn @ full(o.cov_m2) @ turn.T) for o in opinions]
    fused = fuse(opinions)
    if fused.verdict == "ambiguous":
        return  # groups of one have no distance inside: names settle it
    assert fuse(moved).x_m == pytest.approx(turn @ fused.x_m + shift, abs=1e-9)
    renamed = sorted(o._replace(origin=f"r{99 - k}") for k, o in enumerate(opinions))
    assert fuse(renamed).x_m == pytest.approx(fused.x_m, abs=1e-9)


# --- what it is for -------------------------------------------------------------------------------------------


def test_who_stands_apart_takes_itself_out_however_sure_it_is() -> None:
    """6 sigma of the others: near enough to each for the vote, sure enough to be the mean of all."""
    opinions = crowd(5, np.random.default_rng(3), spread=0.2)
    honest = fuse(opinions[1:])
    root = np.linalg.cholesky(full(honest.cov_m2))
    boast = opinion("r000", np.add(honest.x_m, 6.0 * root[:, 0]), 1e-9 * np.eye(3))
    fused = fuse([boast, *opinions[1:]])
    assert fused.verdict == "ok"
    assert math.dist(mean([boast, *opinions[1:]])[0], honest.x_m) > 4.0 * math.dist(fused.x_m, honest.x_m)
    assert fused.factors["r000"] < 0.2
    assert min(fused.factors[o.origin] for o in opinions[1:]) > 0.8
    assert fused.sway_m["r000"] == pytest.approx(math.dist(fused.x_m, honest.x_m), abs=1e-12)


def test_two_equally_suspect_are_met_half_way_and_the_covariance_says_so() -> None:
    """One of three robots is blind along x; which of the other two is right, nobody can say."""
    lie, honest = (opinion(n, (x, 0.5, 0.1), 1e-6 * np.eye(3)) for n, x in (("a", 0.7), ("b", 0.705)))
    witness = opinion("c", (0.7025, 0.5, 0.1), np.diag([1.0, 1e-6, 1e-6]))
    fused = fuse([lie, honest, witness])
    assert fused.x_m[0] == pytest.approx(0.7025, abs=1e-5)
    assert math.sqrt(fused.cov_m2[0]) > 0.0015
    assert fused.factors["a"] == pytest.approx(fused.factors["b"], abs=1e-3)


def test_of_equal_groups_the_closest_wins_and_not_the_surest() -> None:
    """Two honest ones, a liar that each of two groups of three could hold, and a boast beside it."""
    close = [opinion(n, (0.7 + dx, 0.5, 0.1), 1e-5 * np.eye(3)) for n, dx in (("a", 0.0), ("b", 0.001), ("c", 0.002))]
    far = [opinion(n, (0.9 + dx, 0.5, 0.1), 1e-7 * np.eye(3)) for n, dx in (("d", 0.0), ("e", 0.001), ("f", 0.0015))]
    fused = fuse([*close, *far])
    assert fused.verdict == "ambiguous"
    assert fused.x_m[0] == pytest.approx(0.701, abs=1e-9)


def test_the_cost_of_many_stays_linear() -> None:
    """More than VOTERS: no pairs, whether one may lie or two."""
    opinions = crowd(4 * fusing.VOTERS, np.random.default_rng(4), spread=0.5)
    assert fuse(opinions, liars=2) == fuse(opinions)
    assert len(doubts(opinions, liars=2).ways) in (0, len(opinions))


def test_large_swarms_vote_with_the_median_and_find_the_same() -> None:
    opinions = crowd(fusing.VOTERS + 10, np.random.default_rng(2), spread=0.5)
    few, many = fuse(opinions[: fusing.VOTERS]), fuse(opinions)
    assert many.verdict == "ok"
    assert math.dist(few.x_m, many.x_m) < 0.002


# --- track distance ---
# Distances of tracks in place and velocity: against matrices in numpy, and what place alone does not see.

SECOND_NS = 1_000_000_000


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
    assert doubt.factors(opinions)["r0"] < 0.05
