"""`metropolis` against its closed form, and the three repairs; what all robots have wrong alike, in all protocols."""

from random import Random

import numpy as np
import pytest

from agent.core.estimation.evidence import Evidence
from agent.core.estimation.evidence_table import Bounds
from agent.core.estimation.fuse import Shared
from agent.core.estimation.interface import NOTHING, EstimateCache, Prior
from agent.core.estimation.moving_target import AGREED
from agent.core.estimation.protocols import Metropolis, Paper
from agent.core.estimation.track import swimming
from agent.core.linear_algebra import upper
from agent.experiments.localization.lockstep import Swarm, graph, metropolis_weights
from tests.sample_messages import estimate

COV = (4e-4, 0.0, 0.0, 4e-4, 0.0, 4e-4)
SECOND_NS = 1_000_000_000


def prior(x: float) -> Prior:
    return Prior((x, 0.0, 0.0), COV, 0)


@pytest.mark.parametrize(("topology", "robots"), [("full", 3), ("line", 4), ("ring", 4)])
def test_noise_gain_is_the_closed_form(topology, robots) -> None:
    """e^T = (1/T) sum_k W^k n^(T-1-k): one unit impulse in, the gain of every robot out."""
    links, total = graph(topology, robots), 6
    W = metropolis_weights(links)
    for source in range(robots):
        for when in range(total):
            swarm = Swarm("metropolis", links, 0.0, Random(0))
            for t in range(total):
                swarm.iterate([prior(float(i == source and t == when)) for i in range(robots)])
            gain = np.linalg.matrix_power(W, total - 1 - when)[:, source] / total
            assert [r.posterior.x_m[0] for r in swarm.robots] == pytest.approx(gain, abs=1e-12)


def alone(t: int = 0) -> tuple[Metropolis, EstimateCache]:
    robot = Metropolis("r1", SECOND_NS, degree=2)
    robot.adopt(t)
    return robot, EstimateCache("tank", "r1", "ball", ("r2", "r3"))


def test_a_lone_observer_averages() -> None:
    robot, box = alone()
    for x in (1.0, 2.0, 6.0):
        update = robot.tick(prior(x), box, SECOND_NS)
    assert update.rule == "alone"
    assert robot.posterior.x_m[0] == pytest.approx(3.0)


def test_what_all_samples_of_a_robot_have_wrong_alike_does_not_average_out() -> None:
    robot, box = alone()
    stays = (9e-6, 0.0, 0.0, 9e-6, 0.0, 9e-6)
    for _ in range(300):
        robot.tick(Prior((1.0, 0.0, 0.0), COV, 0, stays), box, SECOND_NS)
    assert robot.posterior.cov_m2[0] == pytest.approx(stays[0] + COV[0] / 300)


def test_the_first_sample_of_a_late_and_lone_robot_keeps_its_covariance() -> None:
    robot, box = alone(t=20)
    robot.tick(prior(1.0), box, SECOND_NS)
    assert (robot.posterior.x_m[0], robot.posterior.cov_m2) == (1.0, COV)


@pytest.mark.parametrize(("degree", "weight"), [(2, 1 / 3), (5, 1 / 6), (None, 1 / 3)])
def test_weights_follow_the_larger_degree_and_the_rest_stays_with_the_robot(degree, weight) -> None:
    robot, box = alone()
    robot.tick(prior(0.0), box, 0)
    letter = estimate(t=1, valid=True, x_m=(1.0, 0.0, 0.0), cov_m2=COV, degree=degree)
    box.put("r2", letter, 0)
    update = robot.tick(prior(0.0), box, 0)
    assert update.alpha == 0.5
    assert robot.posterior.x_m[0] == pytest.approx(0.5 * weight)
    assert update.explain.weights == pytest.approx({"r2": 0.5 * weight, "r1": 0.5 * (1 - weight)})


def test_the_blind_take_what_they_are_told_without_shrinking_it() -> None:
    swarm = Swarm("metropolis", graph("line", 3), 0.0, Random(0))
    for _ in range(6):
        swarm.iterate([prior(3.0), None, None])
    assert swarm.robots[1].posterior.x_m[0] == pytest.approx(3.0)
    assert swarm.robots[2].posterior is None, "only those who see speak for themselves"


def lied_to(clip: bool, iterations: int = 40) -> tuple[Metropolis, list[float]]:
    """A robot with a neighbour that is honest for half of the time, then a metre off, and how far it is itself."""
    robot, box, far = Metropolis("r1", 10 * SECOND_NS, 1, clip), EstimateCache("tank", "r1", "ball", ("r2",)), []
    for t in range(iterations):
        place = (float(t >= iterations // 2), 0.0, 0.0)
        box.put("r2", estimate(seq=t, t=t, valid=True, x_m=place, cov_m2=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0), degree=1), t)
        robot.tick(prior(0.0), box, t)
        far.append(robot.posterior.x_m[0])
    return robot, far


def test_a_lie_moves_it_by_three_sigma_of_the_own_samples_an_iteration_however_far_it_is() -> None:
    _, free = lied_to(clip=False)
    _, clipped = lied_to(clip=True)
    assert free[-1] > 0.5
    assert clipped[:20] == free[:20] == [0.0] * 20, "who agrees is not drawn in"
    steps = np.diff(clipped)[19:]
    sigma = np.sqrt(3 * 4e-4 / np.arange(21, 41))  # whatever covariance the neighbour claims
    kept = 1 - 1 / np.arange(21, 41)
    expected = [kept[k] * (0.5 * 3.0 * sigma[k]) - clipped[19 + k] / (21 + k) for k in range(20)]
    assert steps == pytest.approx(expected, abs=1e-12)
    assert clipped[-1] < free[-1]


def test_a_robot_that_never_saw_the_target_takes_what_it_is_told_with_the_clip_too() -> None:
    robot, box = Metropolis("r1", SECOND_NS, 1, clip=True), EstimateCache("tank", "r1", "ball", ("r2",))
    box.put("r2", estimate(t=1, valid=True, x_m=(1.0, 0.0, 0.0), cov_m2=COV, degree=1), 0)
    robot.tick(None, box, 0)
    assert robot.posterior.x_m == (1.0, 0.0, 0.0)


SHARED = Shared((1e-6, 0.0, 0.0, 1e-6, 0.0, 4e-6), scale=0.02)
BOUNDS = Bounds(frozenset(("r1",)), (3.0, 2.0, 1.0), SECOND_NS)


@pytest.mark.parametrize(
    "robot",
    [
        Paper(SECOND_NS, SHARED),
        Metropolis("r1", SECOND_NS, 0, shared=SHARED),
        Evidence("r1", SECOND_NS, (), SECOND_NS, BOUNDS, shared=SHARED),
        Evidence("r1", SECOND_NS, (), SECOND_NS, BOUNDS, shared=SHARED, dynamics=swimming(0.15, 3.0)),
    ],
    ids=["paper", "metropolis", "evidence at rest", "evidence moving"],
)
def test_a_place_is_as_unsure_as_the_scale_of_all_ranges_makes_its_lever(robot) -> None:
    lever = np.array([0.5, -0.3, 0.1])
    sample = Prior((1.0, 1.0, 0.5), COV, SECOND_NS, NOTHING, tuple(lever.tolist()))
    robot.tick(sample, EstimateCache("tank", "r1", "ball", ()), SECOND_NS)
    alone = np.array(COV) + upper(0.02**2 * np.outer(lever, lever))
    surer = AGREED if isinstance(robot, Evidence) and robot.epoch.moving else 1.0
    expected = surer * alone + SHARED.place_m2
    assert robot.posterior.cov_m2 == pytest.approx(expected, rel=1e-9, abs=1e-12)
