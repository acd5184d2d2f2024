"""A short run of what `python -m tests.fuzz steps` does for as long as one likes, by counts instead of time."""

from __future__ import annotations

import itertools

import pytest

from agent.core.codec import encode
from agent.core.step_io import Inputs, Outputs
from tests.fuzz.kernel import whole_steps
from tests.fuzz.kernel.whole_steps import RUNS, STAGES, Watched

SEED = 15
MESSAGES = 600


@pytest.mark.parametrize("name", STAGES)
def test_no_sequence_breaks_a_step_or_asks_more_of_it_than_its_share(name: str) -> None:
    one = Watched(name, SEED, timed=False)
    assert not list(one.run(MESSAGES))
    assert one.messages >= MESSAGES and sum(one.stage.agent.inbox.refused.values()) < one.messages / 2


def test_a_step_that_does_too_much_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(whole_steps, "SUMS", -1)
    one = Watched("survey", SEED, timed=False)
    assert {broken.name for broken in one.run(MESSAGES)} == {"survey: sums"}


@pytest.mark.parametrize(("runs_s", "slow"), [((0.06, 0.01), False), ((0.06, 0.07), True)], ids=["once", "each time"])
def test_a_step_counts_by_the_quickest_of_its_runs(
    runs_s: tuple[float, float], slow: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, sound, said = Watched("night", SEED), Watched._timed, list[bytes]()
    runs = itertools.cycle(runs_s)

    def timed(self: Watched, inputs: Inputs, now_ns: int) -> tuple[float, Outputs]:
        outputs = sound(self, inputs, now_ns)[1]
        said.append(encode(outputs))
        return next(runs), outputs

    monkeypatch.setattr(Watched, "_timed", timed)
    broken = list(one.run(1))
    assert [each.name for each in broken] == ["night: slow"] * slow
    assert len(said) == RUNS and len(set(said)) == 1
