"""The newest message of each neighbour, and how far it can be trusted to be fresh.

Clocks of different robots need not agree. The smallest (arrival - sent) of the last minute stands for the constant
part of that difference; what a message took beyond it is time it spent queued, and counts as age.

Numbers and stamps may run ahead by what clocks and rates allow, and no more. What is beyond is refused and not
remembered, so that one wrong number does not silence a neighbour; one that insists is believed (see also transit.py).
"""

from __future__ import annotations

from typing import Generic, NamedTuple, Protocol, TypeVar

from agent.core.codec import Refusal
from agent.core.savepoint import Revertible
from agent.core.transit import CLOCKS_NS, Transit

SAID_HZ = 100  # messages of a neighbour on one key, at most: five times what a fleet file can ask for
AHEAD_S = 10  # of such messages that may be missing at any time
INSISTS = 3  # messages in a row whose numbers fell back: a neighbour that had told a wrong one
TWIN_NS = 10_000_000_000  # two starts of one robot that take turns within this time are two robots


class Addressed(Protocol):
    """The head that all messages between robots have in common."""

    @property
    def fleet(self) -> str: ...
    @property
    def src(self) -> str: ...
    @property
    def dst(self) -> str: ...
    @property
    def incarnation(self) -> int: ...
    @property
    def seq(self) -> int: ...
    @property
    def sent_ns(self) -> int: ...


M = TypeVar("M", bound=Addressed)


class Letter(NamedTuple, Generic[M]):
    """A believed message with its time of arrival on this robot's clock."""

    message: M
    arrived_ns: int
    late_ns: int  # queued on the way, beyond the quickest message of the last minute


class Sender(NamedTuple, Generic[M]):
    """What is kept of one neighbour."""

    heard: int = 0
    gaps: int = 0
    newest: Letter[M] | None = None
    before: tuple[int, int] | None = None  # the incarnation before, and when it was last heard
    fallen: tuple[int, int] = (0, 0)  # messages in a row that went back, and the number of the last of them
    doubled_ns: int | None = None  # when two incarnations last took turns


class Letters(Revertible, Generic[M]):
    """Newest letter per neighbour; refuses what cannot be a neighbour's next word."""

    def __init__(self, fleet: str, me: str, neighbours: tuple[str, ...]) -> None:
        self._fleet, self._me = fleet, me
        self.senders: dict[str, Sender[M]] = {name: Sender() for name in sorted(neighbours)}
        self._transit: dict[str, Transit] = {name: Transit() for name in self.senders}

    def put(self, src: str, message: M, arrived_ns: int) -> Letter[M]:
        """Keep a decoded message that came on the key of `src`. Raises Refusal when it does not belong there."""
        if src not in self.senders:
            raise Refusal("address", "not a neighbour")
        if message.src != src:
            raise Refusal("address", "sender differs from its key")
        if not self._addressed(message):
            raise Refusal("address", "not addressed to us")
        if message.incarnation > arrived_ns + CLOCKS_NS:
            raise Refusal("clock", "its clock is more than three hours ahead of ours; set the clocks")
        sender = self._numbered(src, message, arrived_ns)
        late_ns = self._transit[src].late_ns(arrived_ns - message.sent_ns, arrived_ns)
        letter = Letter(message, arrived_ns, late_ns)
        self.senders[src] = sender._replace(heard=sender.heard + 1, newest=letter, fallen=(0, 0))
        return letter

    def age_ns(self, src: str, now_ns: int) -> int | None:
        """How old the newest word of a neighbour is; None when it never spoke."""
        letter = self.senders[src].newest
        return None if letter is None else now_ns - letter.arrived_ns + letter.late_ns

    def doubled(self, now_ns: int) -> tuple[str, ...]:
        """Names under which two robots speak."""
        times = {name: sender.doubled_ns for name, sender in self.senders.items()}
        return tuple(name for name, at_ns in times.items() if at_ns is not None and now_ns - at_ns <= TWIN_NS)

    def _addressed(self, message: M) -> bool:
        """Whether it is meant for us."""
        return (message.fleet, message.dst) == (self._fleet, self._me)

    def _numbered(self, src: str, message: M, arrived_ns: int) -> Sender[M]:
        """The neighbour with what the number of this message tells. Raises Refusal where it cannot be the next one."""
        sender = self.senders[src]
        if sender.newest is None or sender.newest.message.incarnation != message.incarnation:
            up_s = max(0, message.sent_ns - message.incarnation) // 10**9
            if message.seq > SAID_HZ * (up_s + AHEAD_S):
                raise Refusal("order", "its first number is beyond what it can have said since it started")
            self._transit[src] = Transit()
            return _restarted(sender, message.incarnation, arrived_ns)
        newest = sender.newest
        gap = message.seq - newest.message.seq - 1
        if gap < 0:
            count, last = sender.fallen
            count = count + 1 if message.seq > last or count == 0 else 1
            if count < INSISTS:
                self.senders[src] = sender._replace(fallen=(count, message.seq))
                raise Refusal("order", "repeated or out of order")
            gap = 0
        elif gap > SAID_HZ * ((arrived_ns - newest.arrived_ns) // 10**9 + AHEAD_S):
            raise Refusal("order", "its number runs ahead of what it can have said")
        return sender._replace(gaps=sender.gaps + gap)


def _restarted(sender: Sender[M], incarnation: int, now_ns: int) -> Sender[M]:
    """A neighbour with a new incarnation; one that returns to the incarnation before is two robots of one name."""
    newest, before = sender.newest, sender.before
    returned = before is not None and before[0] == incarnation and now_ns - before[1] <= TWIN_NS
    return sender._replace(
        before=None if newest is None else (newest.message.incarnation, newest.arrived_ns),
        doubled_ns=now_ns if returned else sender.doubled_ns,
    )
