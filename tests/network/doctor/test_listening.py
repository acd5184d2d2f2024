"""How long is listened, and what is put down of states that arrive."""

import time
from collections.abc import Callable

import pytest
from msgspec.structs import replace

from agent.core import topics
from agent.core.codec import encode, encoding
from agent.core.config import Fleet
from agent.core.messages import NeighbourState, State
from agent.ground import doctor_facts
from agent.ground.doctor_facts import Facts, Looker, _Ears, listen
from router_config.settings import observer_config


class Arriving:
    """A sample of the door's."""

    is_put, encoding = True, encoding(State)

    def __init__(self, state: State) -> None:
        self.key, self._payload = topics.key(topics.STATE, fleet="test", robot=state.robot), encode(state)
        self.size = len(self._payload)

    def payload(self) -> bytes:
        return self._payload


def test_states_are_put_down(state: Callable[..., State]) -> None:
    now_ns = iter((1000, 2000, 3000, 4000))
    ears = _Ears(lambda: next(now_ns))

    def shows(sent_ns: int, gaps: int, target: str = "ball", **changed: object) -> None:
        near = (NeighbourState(robot="r2", gaps=gaps),)
        said = replace(state("r1"), sent_ns=sent_ns, target=target, neighbours=near, **changed)
        ears.state(Arriving(said))
        ears.read()

    shows(500, gaps=7)
    shows(1700, gaps=9)
    shows(2000, gaps=4, target="ring")  # counted by themselves
    assert ears.late_ns == {"r1": 300} and ears.states["r1"].target == "ring"
    assert dict(ears.missed()) == {("r1", "r2"): 2}
    shows(2000, gaps=99, schema=1)
    assert ears.unreadable == {"r1": "schema 1, ours is 2"} and ears.missed()["r1", "r2"] == 2


@pytest.mark.parametrize(("pace", "least_s"), [(1.0, 0.3), (10.0, 0.3), (0.5, 0.6), (0.0, 0.9)])
def test_a_dive_in_the_twin_is_listened_to_by_its_own_time(
    pace: float, least_s: float, make_fleet: Callable[..., Fleet], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_facts, "LISTEN_S", 0.3)
    monkeypatch.setattr(doctor_facts, "SLOWEST_S", 0.9)
    fleet = make_fleet({"r1": ()})
    looker = Looker(observer_config(fleet), "view", asks=False, orders=False)
    began_s = time.monotonic()
    facts = listen(fleet, looker, ["r1"], lambda: int((time.monotonic() - began_s) * 1e9 * pace))
    assert time.monotonic() - began_s >= least_s
    assert facts == Facts({}, {}, frozenset(), {}, {}, {}, {}, {}, {})
