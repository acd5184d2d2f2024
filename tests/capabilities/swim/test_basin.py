"""A belief that runs into a wall, against draws of a Gaussian and a body that a wall stops."""

import itertools

import numpy as np
import pytest

from agent.capabilities.swim.event_ring import EventRing, asked, fix
from agent.capabilities.swim.pose_filter import HULL_M, Basin, Drift, Hull, basin, begin, kept_in
from tests.capabilities.swim.planar_tank import Swimmer

S, MS = 1_000_000_000, 1_000_000
TANK_M = (3.0, 2.0, 0.6)
SURE = (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6)


def belief(x, y, spread=None):
    """At a pose, with a covariance in which all goes along with all."""
    rng = np.random.default_rng(5)
    root = rng.normal(0.0, 0.1, (11, 11)) if spread is None else spread
    P = root @ root.T
    return begin(0, (x, y, 0.2), SURE)._replace(P=tuple(map(tuple, P.tolist())))


def drawn(of, inside):
    """Mean and covariance of the draws that are inside."""
    draws = np.random.default_rng(1).multivariate_normal(of.x, of.P, 400_000, method="cholesky")
    kept = draws[inside(draws)]
    return kept.mean(axis=0), np.cov(kept.T)


@pytest.mark.parametrize(
    ("place", "inside"),
    [
        ((0.02, 1.0), lambda draws: draws[:, 0] >= HULL_M),
        ((3.1, 1.0), lambda draws: draws[:, 0] <= 3.0 - HULL_M),
        ((1.5, HULL_M - 1e-9), lambda draws: draws[:, 1] >= HULL_M),
        ((1.5, 2.15), lambda draws: draws[:, 1] <= 2.0 - HULL_M),
    ],
)
def test_what_is_left_of_a_gaussian_at_a_wall(place, inside):
    before = belief(*place)
    after = kept_in(before, basin(TANK_M))
    mean, covariance = drawn(before, inside)
    sigmas = np.sqrt(np.diag(before.P))
    assert np.allclose((np.array(after.x) - mean) / sigmas, 0.0, atol=0.015)
    assert np.allclose((np.array(after.P) - covariance) / np.outer(sigmas, sigmas), 0.0, atol=0.015)
    assert np.linalg.eigvalsh(np.array(after.P)).min() > 0.0


def test_a_belief_inside_is_left_as_it_is():
    before = belief(HULL_M, 1.0)
    assert kept_in(before, basin(TANK_M)) is before


def test_one_that_errs_by_far_comes_to_the_wall_and_is_not_sure_of_it():
    before = belief(-4.0, 1.0, np.eye(11) * 0.05)
    after = kept_in(before, basin(TANK_M))
    assert HULL_M < after.x[0] < HULL_M + 0.05
    assert 0.2 * 0.05 < np.sqrt(after.P[0][0]) < 0.05
    assert (after.x[1:], after.P[1][1]) == (before.x[1:], before.P[1][1])


def ring(within: Basin | None):
    return EventRing(begin(0, (0.5, 1.0, np.pi), SURE), Hull(), Drift(), within=within)


def test_pushed_against_a_wall_in_the_dark():
    """It thrusts towards the wall, and nothing tells it where it is."""
    free, kept = ring(None), ring(basin(TANK_M))
    body = Swimmer.resting((0.5, 1.0, np.pi))
    for one in (free, kept):
        one.add(asked(1, (1.0, 0.0, 0.0)))
    for step in range(1, 121):
        body.swim((1.0, 0.0, 0.0), 0.05)
        body.stay_in(*TANK_M[:2])
        for one in (free, kept):
            one.advance(step * 50 * MS)
    there, stray = kept.at(6 * S), free.at(6 * S)
    assert stray.x[0] < -0.3
    assert HULL_M <= there.x[0] < 0.5
    assert abs(there.x[0] - body.at[0]) < 3.0 * np.sqrt(there.P[0][0])
    assert abs(there.x[3]) < abs(stray.x[3])


def test_whatever_the_order_in_which_it_is_told():
    events = [
        asked(100 * MS, (2.0, 0.0, 0.0)),
        fix(400 * MS, (0.30, 1.0, 3.1), SURE, SURE),
        asked(500 * MS, (2.0, 0.1, 0.0)),
        fix(700 * MS, (0.16, 1.0, 3.1), SURE, SURE),
    ]
    ends = set()
    for order in itertools.permutations(events):
        one = ring(basin(TANK_M))
        for event in order:
            one.add(event)
            one.at(790 * MS)
        ends.add(one.at(799 * MS))
    (end,) = ends
    assert end.x[0] >= HULL_M
