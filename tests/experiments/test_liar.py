"""Robots that lie: the search finds what moves a fleet, the fleet bears it, and both are what they are said to be."""

import math
from random import Random

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.estimation.evidence_table import Bounds, entry_fault
from agent.core.estimation.evidence_table import opinion as opinion_of
from agent.core.estimation.fuse import Opinion, fuse
from agent.core.linear_algebra import inverse, upper
from agent.core.messages import Epoch, Gossip
from agent.core.trust import entry_bytes
from agent.experiments.claim import Quantile, Share
from agent.experiments.localization.lockstep import (
    TARGET_M,
    Swarm,
    draw_dive,
    draw_world,
    graph,
    perfect_signing,
    prior,
    public_keys,
    symmetric,
    verify,
)
from tests.sample_messages import estimate
from tests.studies.liar.attack import FIRST, LAST, LiarCase, attacked, bumped, told
from tests.studies.liar.claim import CASES, CLAIM, summary
from tests.studies.liar.moving import attacked_moving
from tests.studies.liar.search import CLAIM_M, best_lies, bound_m, conclusions

SECOND_NS = 1_000_000_000


def opinion(name, x_m, cov_m2) -> Opinion:
    packed = upper(cov_m2)
    return Opinion(name, tuple(map(float, x_m)), packed, inverse(packed))


def honest(robots, samples, rng):
    """Places (n, 3) and covariances (n, 3, 3) of all robots but the first."""
    world = draw_world(robots, "aniso", True, np.random.default_rng(6))
    x_m = draw_dive(world, "all", 0.0, samples, rng).sample_m.mean(axis=0)
    return x_m[1:], (world.random_m2 / samples + world.systematic_m2)[1:]


def gain(x_m, cov_m2):
    nobody = np.zeros((1, 0, 3)), np.zeros((1, 0, 3, 3))
    alone_m = conclusions(x_m, cov_m2, *nobody)
    return lambda lies, covs: np.linalg.norm(conclusions(x_m, cov_m2, lies, covs) - alone_m, axis=1)


@pytest.mark.parametrize(("robots", "liars", "reckoned"), [(3, 1, 1), (4, 1, 1), (10, 1, 1), (10, 2, 2), (10, 1, 2)])
def test_many_conclusions_at_once_are_the_kernels_one_by_one(robots, liars, reckoned) -> None:
    rng = np.random.default_rng(1)
    x_m, cov_m2 = honest(robots, 10, rng)
    off = rng.choice([0.004, 0.012, 0.05], (200, 1, 1))
    lies_m = TARGET_M + off * rng.standard_normal((200, liars, 3))
    roots = 10 ** rng.uniform(-4, -2, (200, liars, 1, 1)) * rng.standard_normal((200, liars, 3, 3))
    lies_m2 = roots @ np.swapaxes(roots, -1, -2) + CLAIM_M**2 * np.eye(3)
    found, kinds = conclusions(x_m, cov_m2, lies_m, lies_m2, reckoned), set()
    for m in range(200):
        said = [opinion(f"a{i}", lies_m[m, i], lies_m2[m, i]) for i in range(liars)]
        fused = fuse([*said, *(opinion(f"r{i}", x_m[i], cov_m2[i]) for i in range(len(x_m)))], liars=reckoned)
        assert fused.x_m == pytest.approx(found[m], abs=1e-9)
        kinds.add(min(round(fused.factors["a0"], 3), 0.999) if fused.factors["a0"] in (0.0, 1.0) else 0.5)
    assert len(kinds) == 3, "believed, doubted and left out"


def test_the_search_beats_lies_that_are_chosen_and_meets_the_bound() -> None:
    """Three robots, lies of 5 to 40 mm along 200 directions, sure ones and modest ones, against the one it finds."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        x_m, cov_m2 = honest(3, 30, rng)
        P = np.linalg.inv(np.linalg.inv(cov_m2).sum(axis=0))
        centre_m = P @ np.einsum("nij,nj->i", np.linalg.inv(cov_m2), x_m)
        moved = gain(x_m, cov_m2)
        away = rng.standard_normal((200, 3))
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        chosen = [
            moved((centre_m + mm * 1e-3 * away)[:, None], np.tile(sigma**2 * np.eye(3), (200, 1, 1, 1))).max()
            for mm in (5, 10, 15, 20, 30, 40)
            for sigma in (1e-4, 1e-3, 5e-3)
        ]
        found = best_lies(moved, centre_m, np.linalg.cholesky(P), 1, rng)
        assert found.moves_m > max(chosen)
        assert 0.6 < found.moves_m / bound_m(x_m, cov_m2) < 1.25
        assert found.moves_m == pytest.approx(float(moved(found.x_m[None], found.cov_m2[None])[0]))


def test_what_a_liar_says_passes_every_check_and_means_what_it_wants() -> None:
    rng, entry = np.random.default_rng(2), None
    bounds = Bounds(frozenset({"r0"}), (1.5, 1.2, 0.8), SECOND_NS)
    for k in range(LAST - FIRST):
        x_m = tuple((TARGET_M + rng.normal(0.0, 0.01, 3)).tolist())
        root = 10 ** rng.uniform(-4, -2) * rng.standard_normal((3, 3))
        cov_m2 = upper(root @ root.T + CLAIM_M**2 * np.eye(3))
        before, entry = entry, told("r0", x_m, cov_m2, entry)
        assert entry_fault(entry, bounds, (FIRST + k) * SECOND_NS) is None
        if before is not None:
            assert entry.count > before.count
            assert entry.information[0] > before.information[0]
        meant = opinion_of("r0", [entry])
        assert meant.x_m == pytest.approx(x_m, abs=1e-9)
        assert meant.cov_m2 == pytest.approx(cov_m2, rel=1e-6, abs=1e-12)


def test_perfect_keys_sign_for_their_own_robot_alone() -> None:
    entry = told("r0", (0.7, 0.5, 0.1), (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4), None)
    said = estimate("r0", "r1", incarnation=0, gossip=Gossip(Epoch(), entries=(entry,)))
    keys = public_keys(["r0", "r1"])
    (signed,) = perfect_signing("r0")(said).gossip.entries
    data = entry_bytes(said.fleet, said.target, Epoch(), entry)
    assert verify(keys["r0"], signed.signature, data)
    assert not verify(keys["r1"], signed.signature, data)
    (bare,) = perfect_signing("r1")(said).gossip.entries
    assert not bare.signature


# --- dives ----------------------------------------------------------------------------------------------------


def test_one_of_three_lies_as_well_as_it_can_and_forges_the_others() -> None:
    outcome = attacked(LiarCase("full", 3), 0)
    assert 0.004 < outcome.moved_m < 0.022, "it does something, and not much"
    assert outcome.ratio < 1.25
    assert outcome.end_m <= outcome.moved_m
    assert attacked(LiarCase("full", 3), 0) == outcome
    assert outcome != attacked(LiarCase("full", 3), 1)


def test_without_signatures_one_message_would_have_moved_them_for_ever() -> None:
    """The line: whom a robot does not hear directly, the liar's forgery may speak for. So the forging is real."""
    case = LiarCase("line", 5)
    world = draw_world(5, "aniso", True, np.random.default_rng(6))
    moved = {}
    for signed in (True, False):
        moved[signed] = forged_once(case, world, signed)
    assert moved[True] < 0.03
    assert moved[False] > 0.1


def forged_once(case, world, signed):
    """Metres that the worst of the honest is off after a dozen forged messages."""
    swarm = Swarm("evidence", graph(case.topology, case.robots), 0.0, Random(0), signed=signed)
    own, fixed = symmetric(world.random_m2), symmetric(world.systematic_m2)
    lie = told("r0", (1.4, 1.1, 0.07), (2e-8, 0.0, 0.0, 2e-8, 0.0, 2e-8), None)
    entries = tuple(replace(lie, origin=f"r{j}", count=4000, incarnation=1) for j in range(case.robots))
    swarm.tamper = lambda i, said: said if i else replace(said, gossip=replace(said.gossip, entries=entries))
    for _ in range(12):
        swarm.iterate([None, *(prior(TARGET_M, own[i], fixed[i], swarm.now_ns) for i in range(1, case.robots))])
    return max(math.dist(robot.posterior.x_m, TARGET_M) for robot in swarm.robots[1:])


def test_a_lie_goes_with_its_key_and_fades_where_the_truth_is_told_again() -> None:
    gone = attacked(LiarCase("full", 3, then="no key"), 0)
    assert gone.end_m > 0.004
    assert gone.after_m[1] < 1e-4
    again = attacked(LiarCase("full", 3), 0)
    assert again.after_m[-1] < 0.0025


def test_who_was_knocked_and_repaired_is_believed_again() -> None:
    outcome = bumped(LiarCase("full", 3, bumped_mm=100.0), 0)
    assert 0.7 < outcome.share <= 1.5


@pytest.mark.slow
def test_a_liar_beside_a_target_that_moves() -> None:
    outcome = attacked_moving(LiarCase("full", 3, speed_mm_s=20.0), 0)
    assert 0.003 < outcome.moved_m < 0.04


def test_what_averages_beliefs_is_moved_by_the_lie_itself_and_the_clip_slows_it() -> None:
    moved = {
        (protocol, clip): attacked(LiarCase("full", 3, protocol=protocol, clip=clip), 0).moved_m
        for protocol, clip in (("paper", False), ("metropolis", False), ("metropolis", True))
    }
    assert moved["paper", False] > 0.5
    assert moved["metropolis", False] > 0.5
    assert 0.005 < moved["metropolis", True] < 0.1


# --- the claim ------------------------------------------------------------------------------------------------


def test_what_has_to_hold_in_any_draw_is_told_as_the_share_in_which_it_does() -> None:
    row = {"moved_mm": 9.0, "over_bound": 1.3, "after_2_mm": 0.0, "after_10_mm": 1.0, "share": None}
    mesh = [{"fleet": name, **row} for name in ("mesh-3", "mesh-5")] + [{"fleet": "mesh-3", **row, "over_bound": 1.0}]
    found = summary({"mesh": mesh, "bumped": [{"fleet": "bumped-30", **row, "over_bound": None, "share": 0.7}]})
    assert found["within_bound"] == Share(1, 3)
    assert found["truth_again"] == Share(3, 3)
    assert found["mesh-3_often_mm"] == Quantile([9.0, 9.0], 95.0)
    assert found["bumped-30_share"] == Quantile([0.7], 50.0)
    assert "key_gone" not in found


def test_every_figure_is_found_and_every_fleet_is_in_one() -> None:
    row = {"moved_mm": 1.0, "over_bound": 1.0, "after_2_mm": 0.0, "after_10_mm": 0.0, "share": None}
    found = summary({case: [{"fleet": name, **row} for name in fleets] for case, fleets in CASES.items()})
    keys = {figure.key for figure in CLAIM.figures}
    assert keys <= found.keys()
    one_by_one = {key.split("_")[0] for key in keys}
    assert {name for fleets in CASES.values() for name in fleets} - one_by_one == {"key-gone-3", "key-gone-5"}
