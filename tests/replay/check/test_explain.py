"""Why a robot believed what it believed, in sentences that agree with the recording."""

from collections.abc import Callable
from pathlib import Path

import pytest

from agent.core.codec import decode
from agent.core.config import ConfigError
from agent.core.messages import State
from agent.core.step_io import Outputs
from replay.check.explain import explain, find
from replay.check.reexecute import open_box
from tests.places import GOLDEN

R2 = GOLDEN / "three" / "r2.mcap"


def first(file: Path, wanted: Callable[[State], bool]) -> tuple[int, float, State]:
    """Step, seconds and state of the first state that is wanted."""
    start_ns = None
    for step in open_box(file).steps():
        start_ns = start_ns or step.now_ns
        state = decode(step.outputs, Outputs, limit=10**6).state
        if state is not None and wanted(state):
            return step.number, (step.now_ns - start_ns) * 1e-9, state
    raise AssertionError(file)


def test_a_moment_is_found_by_iteration_time_and_step() -> None:
    step, seconds, _ = first(R2, lambda state: state.t == 7)
    for at in ("7", f"{seconds + 0.01:.2f}s", f"step:{step}", f"step:{step + 3}"):
        moment = find(R2, at)
        assert moment is not None
        assert (moment.state.t, moment.step) == (7, step), at
        assert moment.before is not None
        assert moment.before.t == 6
    last = find(R2, None)
    assert last is not None
    assert last.state.t > 7
    assert find(R2, str(last.state.t)) == last


@pytest.mark.parametrize("at", ["9999", "9999s", "step:99999"])
def test_a_moment_behind_the_end_is_one_line_that_says_where_the_end_is(at: str) -> None:
    last = find(R2, None)
    assert last is not None
    with pytest.raises(ConfigError, match=f"--at {at}: .*from 1 to {last.state.t}, steps to ") as caught:
        explain(R2, at)
    assert "\n" not in str(caught.value)


def test_mixing_has_its_weights_ages_and_alpha() -> None:
    _, _, state = first(R2, lambda state: state.rule == "mix" and sum(n.used for n in state.neighbours) == 2)
    shown = explain(R2, str(state.t))
    assert "It mixed its own measurement with what its neighbours said." in shown
    assert f"alpha {1 / state.t:.4f}" in shown
    assert "Neighbours in S that counted: r1, r3." in shown
    assert shown.count(f"weight {(1 - 1 / state.t) / 2:.4f}") == 2
    assert "ms old" in shown


def test_sweeps_are_told_with_the_peak_and_the_place_that_the_kernel_logged() -> None:
    outcome = next(
        outputs.outcome
        for step in open_box(R2).steps()
        if (outputs := decode(step.outputs, Outputs, limit=10**6)).outcome and outputs.outcome.x_m
    )
    told = "\n".join(explain(R2, str(t)) for t in range(1, 16))
    assert f"Sweep {outcome.sweep}: peak at lens position {outcome.lens_position:.1f} ± {outcome.sigma:.1f}" in told
    assert f"puts the target at ({1e3 * outcome.x_m[0]:.2f}, " in told


def test_being_told_and_holding_are_told_apart() -> None:
    _, _, state = first(R2, lambda state: state.rule == "told")
    assert "did not measure, and took what its neighbours said" in explain(R2, str(state.t))
    assert "knows the target from others only" in explain(R2, str(state.t))
    _, _, state = first(R2, lambda state: state.rule == "hold")
    assert "It neither measured nor heard" in explain(R2, str(state.t))


def test_a_robot_that_was_left_out_is_named() -> None:
    shown = explain(GOLDEN / "liar" / "r1.mcap")
    assert "The outcome is 'outlier': one contradicts the others and is left out." in shown
    counts = shown.split("Whose measurements are in the estimate:\n")[1]
    assert "left out" in next(line for line in counts.splitlines() if line.startswith("  r3:"))


def test_what_is_heard_and_whose_measurements_count_are_told_apart() -> None:
    """With `evidence` a robot counts whether or not it is heard now, so nobody is said not to count who does."""
    file = GOLDEN / "three_evidence" / "r1.mcap"
    _, _, state = first(file, lambda state: state.explain is not None and len(state.explain.weights) == 3)
    shown = explain(file, str(state.t))
    assert "that counted" not in shown
    assert "It joined all that it knows of what robots have measured" in shown
    heard, counts = shown.split("What it heard:\n")[1].split("Whose measurements are in the estimate:\n")
    assert "weight" not in heard
    assert counts.count("weight") == 3
    assert "  r1 (itself): weight " in counts
    alone = explain(file, str(first(file, lambda state: state.t == 1)[2].t))
    assert "Whose measurements are in the estimate: nobody's." in alone


@pytest.mark.parametrize("at", ["soon", "-1", "1.5", "step:x", "0"])
def test_a_moment_that_is_none_is_one_line(at: str) -> None:
    with pytest.raises(ConfigError, match="--at") as caught:
        explain(R2, at)
    assert "\n" not in str(caught.value)
