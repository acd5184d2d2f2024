"""What r1 says of a ball, as its kernel gives it: its own word unsigned, that of others with their signatures."""

from typing import Any

from agent.core.messages import Entry, Epoch, Estimate, Gossip, Proposal, Sample
from tests.sample_messages import estimate

SIX, THREE = (2.5e6, 0.0, 1.0, 4e6, 0.5, 1e6), (1.0, 2.0, -3.5)
START = 1_767_225_600_000_000_000
EPOCH = Epoch(counter=3, moving=True, proposer="r2")
FOREIGN = bytes(range(64))


def entry(origin: str = "r1", count: int = 5, **about: Any) -> Entry:
    rest = {"incarnation": START, "information": SIX, "vector": THREE, "systematic_m2": SIX}
    return Entry(origin=origin, count=count, **{**rest, **about})


def sample(origin: str = "r1", number: int = 7, **about: Any) -> Sample:
    rest = {"incarnation": START, "age_ns": 40_000_000, "information": SIX, "vector": THREE, "t_ns": START + 9}
    return Sample(origin=origin, number=number, **{**rest, **about})


def proposal(proposer: str = "r1", **about: Any) -> Proposal:
    return Proposal(proposer=proposer, **{"since_ns": START + 9, "counter": 4, "moving": False, **about})


def said(*word: Entry | Sample | Proposal, dst: str = "r2", **about: Any) -> Estimate:
    gossip = Gossip(
        epoch=EPOCH,
        entries=tuple(each for each in word if isinstance(each, Entry)),
        samples=tuple(each for each in word if isinstance(each, Sample)),
        proposals=tuple(each for each in word if isinstance(each, Proposal)),
    )
    return estimate(**{"src": "r1", "dst": dst, "incarnation": START, "gossip": gossip, **about})
