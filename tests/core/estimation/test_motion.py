"""Own samples say that a target at rest moved, soon and not in vain; those of others are judged by own ones."""

import numpy as np
import pytest

from agent.core.estimation.interface import Prior
from agent.core.estimation.motion import Motion
from agent.core.linear_algebra import upper

SECOND_NS = 10**9
SIGMA_M = np.array([0.003, 0.0012, 0.0012])
RANDOM_M2 = upper(np.diag(SIGMA_M**2).tolist())


def samples(rng, count, first=0, step_m=(0.0, 0.0, 0.0), scatter=1.0):
    noise = rng.standard_normal((count, 3)) * SIGMA_M * scatter + step_m
    return [Prior(tuple(x.tolist()), RANDOM_M2, (first + k) * SECOND_NS) for k, x in enumerate(noise)]


def alarms(motion, of):
    return [moved for prior in of if (moved := motion.rested(prior)) is not None]


@pytest.mark.parametrize("scatter", [1.0, 2.0, 4.0])
def test_rest_raises_no_alarm_however_samples_scatter(scatter) -> None:
    assert not alarms(Motion(), samples(np.random.default_rng(1), 1500, scatter=scatter))


@pytest.mark.parametrize("step_m", [(0.0, 0.06, 0.0), (0.02, 0.0, 0.0), (0.0, 0.0, -0.06)])
def test_a_step_is_noticed_at_the_second_sample_and_told_by_its_size(step_m) -> None:
    rng, motion = np.random.default_rng(2), Motion()
    assert not alarms(motion, samples(rng, 30))
    first, second = samples(rng, 2, 30, step_m)
    assert motion.rested(first) is None, "one may be odd"
    moved = motion.rested(second)
    assert moved.step_m == pytest.approx(step_m, abs=0.006)
    assert moved.since_ns == first.t_ns


def test_a_creep_of_a_millimetre_a_second_is_noticed_within_a_minute() -> None:
    rng, motion = np.random.default_rng(3), Motion()
    assert not alarms(motion, samples(rng, 60))
    creeping = [samples(rng, 1, 60 + k, (0.0, 0.001 * k, 0.0))[0] for k in range(60)]
    assert alarms(motion, creeping[:20])


@pytest.mark.parametrize("said", [True, False])
def test_a_drift_that_a_robot_says_of_itself_is_no_motion(said) -> None:
    """Of its height by 40 um/s, the standard deviation of what it says."""
    rng, motion = np.random.default_rng(6), Motion()
    drifts = (*[0.0] * 5, 4e-5**2 if said else 0.0)
    drifting = [samples(rng, 1, k, (0.0, 0.0, 4e-5 * k))[0]._replace(drift_m2_s2=drifts) for k in range(400)]
    assert bool(alarms(motion, drifting)) is not said


def test_samples_that_are_odd_one_by_one_are_no_motion() -> None:
    rng, motion = np.random.default_rng(4), Motion()
    odd = [samples(rng, 1, k, (0.0, 0.02 * (k % 25 == 24), 0.0))[0] for k in range(400)]
    assert not alarms(motion, odd)


@pytest.mark.parametrize(("moved", "judged"), [(True, True), (False, False)])
def test_a_step_that_another_saw_is_judged_by_own_samples_since(moved, judged) -> None:
    rng, motion, step_m = np.random.default_rng(5), Motion(), (0.0, 0.03, 0.0)
    alarms(motion, samples(rng, 20))
    told_ns = 19 * SECOND_NS
    since = samples(rng, 3, 20, step_m if moved else (0.0, 0.0, 0.0))
    assert motion.judge(step_m, told_ns) is None, "none since"
    for prior in since:
        motion.rested(prior)
    assert motion.judge(step_m, told_ns) is judged
