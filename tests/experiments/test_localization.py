"""The localization experiment: its swarms against the theorem and the bound."""

import math
from random import Random

import numpy as np
import pytest

from agent.experiments.claim import Row, measure
from agent.experiments.localization.draws import Case, bound_m, score_draw
from agent.experiments.localization.localization import (
    CASES,
    CLAIM,
    SWARMS,
    Settings,
    figures_of,
    rows_of,
    run,
    summary,
)
from agent.experiments.localization.lockstep import (
    Swarm,
    draw_dive,
    draw_world,
    graph,
    metropolis_weights,
    paper_weights,
    prior,
    symmetric,
)


def figures(case: Case) -> list[dict[str, float | None]]:
    """At each iteration of the case."""
    return [figures_of([row]) for row in rows_of("it", case, [score_draw(case, 0, k) for k in range(case.draws)])]


def ratios(case: Case) -> list[float]:
    return [found["ratio"] for found in figures(case)]


# --- the swarm ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("protocol", "weights"), [("paper", paper_weights), ("metropolis", metropolis_weights)])
@pytest.mark.parametrize(("topology", "robots"), [("full", 3), ("ring", 4), ("line", 5)])
def test_noise_gain_is_that_of_the_theorem_to_rounding(protocol, weights, topology, robots) -> None:
    """One sample of one robot is off by a metre: the error of all after T iterations is a column of W^k / T."""
    near, T = graph(topology, robots), 7
    W = weights(near)
    for when in (0, 3, 6):
        swarm = Swarm(protocol, near, 0.0, Random(0))
        cov = symmetric(np.tile(25e-6 * np.eye(3), (robots, 1, 1)))
        for k in range(T):
            at = [np.array([float(k == when and i == 1), 0.0, 0.0]) for i in range(robots)]
            swarm.iterate([prior(at[i], cov[i], (0.0,) * 6, swarm.now_ns) for i in range(robots)])
        gain = np.linalg.matrix_power(W, T - 1 - when)[:, 1] / T
        assert [robot.posterior.x_m[0] for robot in swarm.robots] == pytest.approx(gain.tolist(), abs=1e-12)


@pytest.mark.parametrize(("topology", "robots"), [("full", 3), ("line", 10)])  # a ring: to rounding, above
def test_paper_reaches_its_closed_form_within_5_percent(topology, robots) -> None:
    case = Case("paper", topology, robots, 150, (10, 20), noise="iso")
    assert [found["theory"] for found in figures(case)] == pytest.approx([1.0, 1.0], rel=0.05)


@pytest.mark.slow
def test_paper_fails_where_messages_are_lost() -> None:
    """10 robots on the hard graph, 30 % loss. The literal update falls behind: it starts again too often.

    That evidence does is asked in tests/core/estimation/test_evidence.py, and what comes at 200 by the claim.
    """
    first, later = ratios(Case("paper", "geometric", 10, 80, (10, 20), loss=0.3))
    assert first == pytest.approx(9.6, rel=0.25)  # the scatter of 80 draws
    assert later > 1.25 * first


@pytest.mark.slow
def test_ten_messages_an_iteration_make_distance_cheap() -> None:
    once, often = (ratios(Case("evidence", "geometric", 10, 8, (10,), loss=0.3, says=n))[0] for n in (1, 10))
    assert often < 1.25
    assert often < once


def test_one_of_three_is_wrong_and_the_honest_ones_do_not_care() -> None:
    wrong = {"loss": 0.1, "systematic": True, "outlier_mm": 300.0}
    assert ratios(Case("evidence", "full", 3, 60, (40,), **wrong))[0] < 1.1
    assert figures(Case("paper", "full", 3, 10, (40,), **wrong))[0]["mm"] > 90.0


@pytest.mark.parametrize("topology", ["line", "geometric"])
def test_all_without_a_view_are_covered_by_relays(topology) -> None:
    found = {}
    for protocol in ("paper", "evidence"):
        found[protocol] = figures(Case(protocol, topology, 10, 6, (10, 50), loss=0.1, views="relay"))
    assert [at["knows"] for at in found["evidence"]] == [1.0, 1.0]
    assert found["evidence"][1]["ratio"] < 1.25
    assert found["paper"][1]["knows"] == pytest.approx(0.7)  # only those next to a robot that sees


@pytest.mark.slow
def test_a_moving_target_is_followed() -> None:
    case = Case("evidence", "ring", 5, 2, (30,), loss=0.3, speed_mm_s=20.0, ticks=5)
    assert 1.0 < ratios(case)[0] < 1.5


def test_a_partition_heals_and_a_restarted_robot_is_told_what_it_knew() -> None:
    """Five in a ring, 10 % loss. Robot 2 forgets all at 20; {0, 1, 2} and {3, 4} are apart from 30 to 59.

    Signed, for else nobody is told what he measured himself. An ordinary draw: where chance puts one robot 3 sigma off,
    doubt widens what all claim.
    """
    rng = np.random.default_rng(1)
    world = draw_world(5, "aniso", False, np.random.default_rng(6))
    samples = draw_dive(world, "all", 0.0, 100, rng)
    swarm = Swarm("evidence", graph("ring", 5), 0.1, Random(0), signed=True)
    own, zero = symmetric(world.random_m2), symmetric(world.systematic_m2)
    ratio = {}
    for k in range(100):
        if k == 20:
            swarm.restart(2)
        swarm.sides = (frozenset({0, 1, 2}), frozenset({3, 4})) if 30 <= k < 60 else ()
        swarm.iterate([prior(samples.sample_m[k, i], own[i], zero[i], swarm.now_ns) for i in range(5)])
        claimed = [math.sqrt(sum(r.posterior.cov_m2[j] for j in (0, 3, 5))) for r in swarm.robots]
        ratio[k + 1] = np.array(claimed) / bound_m(world, np.full(5, k + 1))
    assert ratio[24][2] < 1.2  # four iterations after it knew nothing
    # Each side alone: what the others had measured when they parted, and a little that was still on its way.
    for side, parted in (((0, 1, 2), (60, 60, 60, 30, 30)), ((3, 4), (30, 30, 30, 60, 60))):
        alone = bound_m(world, np.array(parted)) / bound_m(world, np.full(5, 60))
        assert ratio[60][list(side)] == pytest.approx(alone, rel=0.01)
        assert alone > 1.05
    assert all(ratio[66] < 1.02)
    assert all(ratio[100] > 0.999)  # surer than the bound: something was counted twice


# --- the claim ------------------------------------------------------------------------------------------------


def batch(draws: int, square: float, central: float, bound: float, **other: float) -> Row:
    """Sums of so many draws."""
    return {
        "swarm": "evidence-late",
        "t": 45,
        "draws": draws,
        "known": draws,
        "nees": 3.0 * draws,
        "covered": float(draws),
        "square": draws * square,
        "central": draws * central,
        "bound": draws * bound,
        "theory_m": None,
        **other,
    }


def test_the_luck_of_the_draws_is_taken_off_where_batches_are_pooled() -> None:
    """All that is off is that the central fusion is off its bound: then the error is the bound, whichever are drawn."""
    lucky, unlucky = batch(3, 0.8e-6, 0.8e-6, 1e-6), batch(1, 2.0e-6, 2.0e-6, 1e-6)
    for chosen in ([lucky], [unlucky], [lucky, unlucky], [unlucky, unlucky, lucky]):
        found = figures_of(chosen)
        assert found["ratio"] == pytest.approx(1.0)
        assert found["mm"] == pytest.approx(1.0)
        assert found["nees"] == pytest.approx(3.0)
    blind = batch(2, 0.0, 1e-6, 1e-6, known=0, nees=0.0, covered=0.0)
    assert figures_of([blind])["ratio"] is None
    assert figures_of([lucky, blind])["knows"] == pytest.approx(0.6)


def test_the_bootstrap_draws_batches() -> None:
    rows = {"late-views": {seed: [batch(2, (1.0 + 0.1 * seed) ** 2 * 1e-6, 1e-6, 1e-6)] for seed in range(10)}}
    found = measure(CLAIM, rows)["evidence-late_ratio"]
    assert 1.2 < found.low < found.value < found.high < 1.7


def test_the_same_seed_gives_the_same_rows_and_another_does_not() -> None:
    few = Settings(draws=2, iterations=5)
    assert run(1, "relays", few) == run(1, "relays", few)
    assert run(1, "relays", few) != run(2, "relays", few)


def test_every_figure_is_found_and_every_swarm_is_in_a_figure() -> None:
    assert len(SWARMS) == sum(map(len, CASES.values())), "a name of a swarm is its own"
    rows = {case: [batch(1, 1.0, 1.0, 1.0, swarm=n, t=t) for n in s for t in s[n].at] for case, s in CASES.items()}
    keys = [figure.key for figure in CLAIM.figures]
    assert len(set(keys)) == len(keys)
    assert set(keys) <= summary(rows).keys()
    assert {key.split("_")[0] for key in keys} == set(SWARMS)
