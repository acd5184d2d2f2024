"""What the two modes of `evidence`, for a target at rest and for one that moves, have in common.

`Mode` is their interface. `Motion` decides which of the two it is, `DeliveryLedger` what a neighbour still has to get.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from agent.core.estimation.evidence_table import Bounds
from agent.core.estimation.fuse import Shared
from agent.core.estimation.interface import Bearing, Posterior, Prior
from agent.core.estimation.motion import Innovation
from agent.core.estimation.track import ROLLING, Dynamics
from agent.core.link_clocks import CLOCKS_NS, Way
from agent.core.messages import Explain, Gossip
from agent.core.step_transaction import Revertible
from agent.core.trust import Authority

Links = frozenset[tuple[str, str]]  # robots that speak to each other, by the fleet file, both ways


class Me(NamedTuple):
    """What a robot knows of itself and its fleet before it measures anything."""

    key: tuple[str, int]  # name, and which of its starts this is, or of its entries if it began anew since
    neighbours: tuple[str, ...]
    bounds: Bounds
    max_entries: int  # in one message
    shared: Shared  # what all robots have wrong alike
    authority: Authority
    subject: tuple[str, str]  # fleet and target, as they are signed
    liars: int = 1  # robots that may be wrong at once
    dynamics: Dynamics = ROLLING  # of a target that moves
    links: Links = frozenset()


class Conclusion(NamedTuple):
    """Outcome of one iteration; the fields are those of interface.Update."""

    posterior: Posterior | None
    rule: str
    alpha: float
    explain: Explain
    doubts_itself: bool = False  # it is more likely than not that our own samples are wrong


class Mode(Protocol):
    """Keeps the evidence of one epoch."""

    outlived: int | None  # an incarnation of ours that is newer than the one we write under

    def add(self, number: int, prior: Prior | Bearing, now_ns: int) -> Innovation | None:
        """Take in an own sample; returns its innovation, None where nothing was expected."""

    def hear(self, src: str, gossip: Gossip, arrived_ns: int, way: Way | None) -> list[str]:
        """Take in what a neighbour said, whose message arrived after `way`; returns the kinds of what was not believed.

        way: None where nobody knows how long that was.
        """

    def began(self, me: Me) -> None:
        """We write under another incarnation from now on."""

    def distrust(self, origins: Collection[str]) -> None:
        """Drop all evidence of these origins."""

    def measured_ns(self) -> Mapping[str, int]:
        """When each robot that is known to have measured the target did so last."""

    def restarted(self, src: str) -> None:
        """A neighbour started again, and holds nothing."""

    def news(self, to: str) -> bool:
        """Whether there is something that this neighbour was not told since it is here."""

    def say(self, to: str, now_ns: int, between: bool = False) -> Gossip:
        """What this neighbour does not have yet, as far as fits. between: two rounds, the news alone."""

    def conclude(self, valid: bool, before: Posterior | None, now_ns: int) -> Conclusion:
        """Where the target is by all that is held. `before`: the posterior until now."""


def outliving(known: int | None, incarnation: int, me: Me, now_ns: int) -> int | None:
    """The newest incarnation of ours that is later than the one we write under, after this one was heard of.

    That is an earlier start of ours, by a clock that was ahead: ours has to begin after it, or is taken for the older.
    """
    return max(known or 0, incarnation) if me.key[1] < incarnation <= now_ns + CLOCKS_NS else known


# --- delivery ledger ---
# What one neighbour is known to hold, and what it is still owed.
#
# Nothing is taken for delivered because it was sent. A version counts as held once the neighbour shows it, in its
# digest or by sending it to us; until then it is owed and goes out again, whatever the link does.
#
# What came in since it was last sent is news. It may go between two rounds, and comes first in a round: what is sent
# again has to wait until the neighbour had the time to show that it holds it.

Key = TypeVar("Key", bound=tuple[Any, ...])  # begins with origin and incarnation

DIGEST_NS = 1_000_000_000  # a digest at least this often: repairs what stopped changing
LINES = 64  # of a digest in one message; longer ones go out in turns


class DeliveryLedger(Revertible, Generic[Key]):
    """Bookkeeping for one neighbour in one epoch."""

    def __init__(self) -> None:
        self._held: dict[Key, int] = {}
        self._sent: dict[Key, int] = {}  # in which round
        self._news: dict[Key, int] = {}  # versions that were not sent yet
        self._turn = 0
        self._digested: tuple[int, int] | None = None  # which state of the table the last digest showed, and when
        self._line = 0

    def forget(self) -> None:
        """The neighbour started again and holds nothing."""
        self._held, self._sent = {}, {}
        self._digested = None

    @property
    def news(self) -> Collection[Key]:
        """What changed since it was sent, the oldest news first."""
        return self._news.keys()

    def changed(self, key: Key, version: int, told: bool) -> None:
        """We hold another version. told: by the same robot as we were, the neighbour has been: it counts as sent in the
        next round."""
        if told:
            self._sent[key] = self._turn + 1
            self._news.pop(key, None)
        elif version > self._held.get(key, 0):
            self._news[key] = version

    def acknowledge(self, key: Key, version: int) -> None:
        """The neighbour says what it holds; what it says later replaces that, downwards too."""
        self._held[key] = version
        if version >= self._news.get(key, version + 1):
            del self._news[key]

    def pending(
        self, versions: Mapping[Key, int], own: tuple[str, int], limit: int, between: bool = False
    ) -> list[Key]:
        """What to send now, at most `limit`: own evidence first, then news, then what was sent longest ago.

        between: two rounds. `versions` then are of news alone, which counts as sent in the next round.
        """
        turn, shown_after = self._turn + 1, len(versions) // LINES  # rounds that a digest of so many lines takes
        waiting = [
            key
            for key, version in versions.items()
            if version > self._held.get(key, 0)
            and (key in self._news or key not in self._sent or turn - self._sent[key] > shown_after)
        ]
        # Stable: else in the order of `versions`.
        waiting.sort(key=lambda key: (key[:2] != own, key not in self._news, self._sent.get(key, -1)))
        for key in waiting[:limit]:
            self._sent[key] = turn
            self._news.pop(key, None)
        if not between:
            self._turn = turn
        return waiting[:limit]

    def due(self, lines: int, change: int, now_ns: int) -> slice:
        """Which of the lines of a digest go with this message: all when the table changed or a second has passed, else
        none; of a digest longer than LINES the next part, with every message."""
        if lines > LINES:
            start, self._line = self._line, self._line + LINES
            if self._line >= lines:
                self._line = 0
            return slice(start, start + LINES)
        if self._digested is not None:
            shown, shown_ns = self._digested
            if change == shown and now_ns - shown_ns < DIGEST_NS:
                return slice(0)
        self._digested = (change, now_ns)
        return slice(None)

    def drop(self, kept: Mapping[Key, object]) -> None:
        """Forget about what is no longer in the table."""
        self._held = {key: version for key, version in self._held.items() if key in kept}
        self._sent = {key: turn for key, turn in self._sent.items() if key in kept}
        self._news = {key: version for key, version in self._news.items() if key in kept}
