"""What the two modes of `evidence`, for a target at rest and for one that moves, have in common.

`Mode` is their interface. `Motion` decides which of the two it is, `DeliveryLedger` what a neighbour still has to get.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from agent.core.estimation.evidence_table import Bounds
from agent.core.estimation.interface import Bearing, Posterior, Prior
from agent.core.estimation.track import ROLLING, Dynamics, summed
from agent.core.linear_algebra import apply, invert, quadratic
from agent.core.messages import Explain, Gossip, Holding, Symmetric, Vector
from agent.core.step_transaction import Revertible
from agent.core.trust import CLOCKS_NS, Authority

SEEN_NS = 20_000_000_000  # a robot that measured this lately sees the target


class Me(NamedTuple):
    """What a robot knows of itself and its fleet before it measures anything."""

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
    doubts_itself: bool = False  # it is more likely than not that our own samples are wrong


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
        """Drop all evidence of these origins."""

    def seeing(self, now_ns: int) -> int:
        """How many robots are known to have seen the target of late."""

    def restarted(self, src: str) -> None:
        """A neighbour started again, and holds nothing."""

    def say(self, to: str, now_ns: int) -> Gossip:
        """What this neighbour does not have yet, as far as fits."""

    def by_others(self) -> Posterior | None:
        """Where the target rests, all our own samples left out; see interface.Estimator."""

    def conclude(self, valid: bool, before: Posterior | None, now_ns: int) -> Conclusion:
        """Where the target is by all that is held. `before`: the posterior until now."""


def outliving(known: int | None, incarnation: int, me: Me, now_ns: int) -> int | None:
    """The newest incarnation of ours that is later than the one we write under, after this one was heard of.

    That is an earlier start of ours, by a clock that was ahead: ours has to begin after it, or is taken for the older.
    """
    return max(known or 0, incarnation) if me.key[1] < incarnation <= now_ns + CLOCKS_NS else known


# --- rest or motion ---
# Does the target rest or move? Each robot asks its own samples, and tells the others what it found.
#
# At rest the normalised innovations squared of own samples against the mean of the own samples before them follow chi^2
# with 3 degrees of freedom each. The reference is the own mean, not the agreed place: a robot that is wrong is wrong in
# both, and raises no alarm. Moving turns to rest when the track has stayed in one place for half a minute.
#
# Samples that scatter by more than they say make this sum large as well; in murky water they do so for as long as a
# dive lasts. So the sum of a batch is taken apart, with d the innovations, S their covariances and m the mean of the
# batch,
#
# sum d' S^-1 d  =  m' (sum S^-1) m  +  sum (d - m)' S^-1 (d - m)        m = (sum S^-1)^-1 sum S^-1 d
#
# What moves shows in the first part, whatever samples scatter by: of five that do nothing else it has a fifth.

BATCH = 5  # samples whose sum is judged; two batches in a row must agree
MOVED = 37.70  # chi^2, 15 degrees of freedom, 0.999
# Of that sum, in the mean of the batch. Scatter along one axis, however large, has more in one batch of 26, and twice
# in a row in one of 700; a target that goes off at one speed has 0.8 in the first batch, and soon nearly all.
SHIFT = 0.7
NORMAL = 25.00  # chi^2, 15 degrees of freedom, 0.95
RESTED_NS = 30_000_000_000  # this long in one place is rest
REST_SPEED_M_S = 0.002  # mean speed over that time below which the target counts as resting


class Innovation(NamedTuple):
    """An own sample against what the own samples before it said."""

    step_m: Vector
    covariance_m2: Symmetric  # of that, if nothing changed
    nis: float  # that step, normalised and squared


class Motion(Revertible):
    """Evidence for and against motion, of one robot in one epoch."""

    def __init__(self) -> None:
        self._batch: list[Innovation] = []
        self._alarms = 0
        self._normal = False  # the last full batch scattered no more than it should
        self._path: deque[tuple[int, Vector]] = deque()

    def sample(self, innovation: Innovation) -> None:
        """Take note of one own sample."""
        self._batch.append(innovation)
        if len(self._batch) == BATCH:
            total = sum(each.nis for each in self._batch)
            moved = total > MOVED and _of_mean(self._batch) > SHIFT * total
            self._alarms = self._alarms + 1 if moved else 0
            self._normal = total < NORMAL
            self._batch = []

    def place(self, now_ns: int, x_m: Vector) -> None:
        """Take note of where the track is."""
        self._path.append((now_ns, x_m))
        while len(self._path) > 1 and now_ns - self._path[1][0] >= RESTED_NS:
            self._path.popleft()

    @property
    def moves(self) -> bool:
        return self._alarms >= 2

    def rests(self, now_ns: int) -> bool:
        """Whether the track stayed in one place for half a minute, and own samples agree with it."""
        if not self._normal or not self._path or now_ns - self._path[0][0] < RESTED_NS:
            return False
        here, reach = self._path[-1][1], REST_SPEED_M_S * RESTED_NS * 1e-9
        return all(sum((a - b) ** 2 for a, b in zip(x, here, strict=True)) < reach * reach for _, x in self._path)


def _of_mean(batch: list[Innovation]) -> float:
    """The part of the sum that is due to the mean of the batch."""
    known = [(invert(each.covariance_m2), each.step_m) for each in batch]
    information, vector = summed([(precision, apply(precision, step_m)) for precision, step_m in known])
    return quadratic(invert(information), vector)


# --- delivery ledger ---
# What one neighbour is known to hold, and what it is still owed.
#
# Nothing is taken for delivered because it was sent. A version counts as held once the neighbour shows it, in its
# digest or by sending it to us; until then it is owed and goes out again, whatever the link does.

Key = TypeVar("Key", bound=tuple[Any, ...])  # begins with origin and incarnation

DIGEST_NS = 1_000_000_000  # a digest at least this often: repairs what stopped changing
LINES = 64  # of a digest in one message; longer ones go out in turns


class DeliveryLedger(Revertible, Generic[Key]):
    """Bookkeeping for one neighbour in one epoch."""

    def __init__(self) -> None:
        self._held: dict[Key, int] = {}
        self._sent: dict[Key, int] = {}
        self._turn = 0
        self._digested: tuple[int, int] | None = None  # which state of the table the last digest showed, and when
        self._line = 0

    def forget(self) -> None:
        """The neighbour started again and holds nothing."""
        self._held = {}
        self._digested = None

    def acknowledge(self, key: Key, version: int) -> None:
        """The neighbour says what it holds; what it says later replaces that, downwards too."""
        self._held[key] = version

    def pending(self, versions: Mapping[Key, int], own: tuple[str, int], limit: int) -> list[Key]:
        """What to send now: own evidence first, then what was sent longest ago, at most `limit`."""
        waiting = [key for key, version in versions.items() if version > self._held.get(key, 0)]
        waiting.sort(key=lambda key: (key[:2] != own, self._sent.get(key, -1)))  # stable: else as `versions` has it
        self._turn += 1
        for key in waiting[:limit]:
            self._sent[key] = self._turn
        return waiting[:limit]

    def digest(self, lines: Sequence[Holding], change: int, now_ns: int) -> tuple[Holding, ...]:
        """The lines that go with this message: all when the table changed or a second has passed, else none; of a
        table longer than LINES the next part, with every message."""
        if len(lines) > LINES:
            start, self._line = self._line, self._line + LINES
            if self._line >= len(lines):
                self._line = 0
            return tuple(lines[start : start + LINES])
        if self._digested is not None:
            shown, shown_ns = self._digested
            if change == shown and now_ns - shown_ns < DIGEST_NS:
                return ()
        self._digested = (change, now_ns)
        return tuple(lines)

    def drop(self, kept: Mapping[Key, object]) -> None:
        """Forget about what is no longer in the table."""
        self._held = {key: version for key, version in self._held.items() if key in kept}
        self._sent = {key: turn for key, turn in self._sent.items() if key in kept}
