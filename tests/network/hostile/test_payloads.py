"""The rogue's payloads are what they are said to be: a flood of what nobody would look at tests nothing."""

from collections.abc import Callable

import pytest

from agent.core.codec import Refusal, decode
from agent.core.config import Fleet
from agent.core.messages import MAX_PAYLOAD, Estimate
from tests.network.hostile.payloads import MANY, kinds


@pytest.fixture
def fleet(make_fleet: Callable[..., Fleet]) -> Fleet:
    return make_fleet({"r1": ("r2", "r3"), "r2": ("r1", "r3"), "r3": ("r1", "r2")})


@pytest.mark.parametrize("kind", ["heartbeat", "entries", "signed", "incarnations", "samples", "epochs"])
def test_a_neighbour_could_have_said_it(fleet: Fleet, kind: str) -> None:
    make = kinds(fleet, "r3", "r1")[kind]
    first, later = (decode(make(k), Estimate) for k in (1, 300_000))
    assert (first.src, first.dst, first.seq, later.seq) == ("r3", "r1", 1, 300_000)
    assert first.gossip is None or first.gossip != later.gossip
    if kind == "heartbeat":
        return
    many = later.gossip.samples if kind == "samples" else later.gossip.entries
    assert len(many) == MANY
    assert {item.origin for item in many} == set(fleet.robot)
    if kind != "epochs":
        before = first.gossip.samples if kind == "samples" else first.gossip.entries
        assert not set(many) & set(before)  # all of it is news


@pytest.mark.parametrize(("kind", "refused"), [("random", "garbage"), ("stuffed", "content")])
def test_as_long_as_may_be_and_no_message(fleet: Fleet, kind: str, refused: str) -> None:
    make = kinds(fleet, "r3", "r1")[kind]
    assert len(make(1)) == MAX_PAYLOAD
    with pytest.raises(Refusal) as caught:
        decode(make(1), Estimate)
    assert caught.value.kind == refused
    assert make(1) != make(2)
