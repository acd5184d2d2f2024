"""What the two modes of `evidence`, for a target at rest and for one that moves, have in common."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple, Protocol

from agent.core.authority import Authority
from agent.core.estimation.dynamics import ROLLING, Dynamics
from agent.core.estimation.evidence_checks import Bounds
from agent.core.estimation.interface import Bearing, Posterior, Prior
from agent.core.estimation.motion import Innovation
from agent.core.messages import Explain, Gossip, Symmetric
from agent.core.transit import CLOCKS_NS

SEEN_NS = 20_000_000_000  # a robot that measured this lately sees the target


class Me(NamedTuple):
    """What a robot knows of itself and its surroundings before it measures anything."""

    key: tuple[str, int]  # name, and which of its starts this is, or of its entries if it began anew since
    neighbours: tuple[str, ...]
    bounds: Bounds
    max_entries: int  # in one message
    common_m2: Symmetric  # covariance of errors that all robots share
    authority: Authority
    subject: tuple[str, str]  # fleet and target, as they are signed
    liars: int = 1  # robots that may be wrong at once
    dynamics: Dynamics = ROLLING  # of a target that moves


class Conclusion(NamedTuple):
    """Outcome of one iteration; the fields are those of interface.Update."""

    posterior: Posterior | None
    rule: str
    alpha: float
    explain: Explain
    doubts_itself: bool = False  # it is more likely than not that our own word is wrong


class Mode(Protocol):
    """Keeps the evidence of one epoch."""

    outlived: int | None  # an incarnation of ours that is newer than the one we write under

    def add(self, number: int, prior: Prior | Bearing, now_ns: int) -> Innovation | None:
        """Take in an own sample; returns its innovation, None where nothing was expected."""

    def hear(self, src: str, gossip: Gossip, arrived_ns: int) -> list[str]:
        """Take in what a neighbour passed on at `arrived_ns`; returns the kinds of what was not believed."""

    def began(self, me: Me) -> None:
        """We write under another incarnation from now on."""

    def distrust(self, origins: Collection[str]) -> None:
        """Nothing of these counts any more."""

    def seeing(self, now_ns: int) -> int:
        """How many robots are known to have seen the target of late."""

    def restarted(self, src: str) -> None:
        """A neighbour started again: it holds nothing any more."""

    def say(self, to: str, now_ns: int) -> Gossip:
        """What this neighbour does not have yet, as far as fits."""

    def by_others(self) -> Posterior | None:
        """Where the target rests, all our own samples left out; interface.Estimator."""

    def conclude(self, valid: bool, before: Posterior | None, now_ns: int) -> Conclusion:
        """Where the target is by all that is held. `before`: the posterior until now."""


def outliving(known: int | None, incarnation: int, me: Me, now_ns: int) -> int | None:
    """The newest incarnation of ours that is later than the one we write under, after this one was heard of.

    An earlier life of ours, by a clock that was ahead: ours has to begin after it, or is taken for the older.
    """
    return max(known or 0, incarnation) if me.key[1] < incarnation <= now_ns + CLOCKS_NS else known
