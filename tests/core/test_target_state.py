"""What a robot says of its own knowledge: a change that lasts, not each iteration in which a sweep was late."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from agent.core.messages import Explain
from agent.core.target_state import TargetState
from agent.demo.demo import demo_fleet

FLEET = demo_fleet(3, "evidence", 0.0, 0, False, Path("/nowhere"))
SHOWN = {
    "blind blind told told sees sees": ["told since 3", "sees since 5"],
    "sees told sees told sees told": [],
    "sees sees told sees sees told sees": ["sees since 1"],
    "sees sees sees blind blind sees sees": ["sees since 1", "blind since 4", "sees since 6"],
    "told sees sees": ["sees since 2"],
}


@pytest.mark.parametrize("states", SHOWN)
def test_a_change_is_news_when_it_has_lasted_for_two_iterations(states: str) -> None:
    target, news, shown = TargetState(FLEET, "r1", "ball", 1), [], []
    for t, state in enumerate(states.split(), start=1):
        target.estimator = SimpleNamespace(  # type: ignore[assignment]
            tick=lambda prior, cache, now_ns, t=t: SimpleNamespace(t=t, explain=Explain()),
            valid=state == "sees",
            posterior=None if state == "blind" else object(),
        )
        if target.iterate(t * 10**9):
            news.append(f"{target.knows} since {target.since_t}")
        shown.append(target.knows)
    assert news == SHOWN[states]
    assert shown == states.split(), "what is published is of each iteration"
