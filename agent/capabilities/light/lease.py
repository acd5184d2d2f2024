"""Who has the light: one robot of a fleet at a time, as a state machine without a clock, pictures or lamps.

    free --ask--> asks --all answered, or guard over--> holds --release--> free
    free, asks --a neighbour's lease--> obeys --it is over--> free

Whoever asks is told by each neighbour that it obeys, or that it obeys another ("busy"). Of two that ask at the same
time the one counts that has waited longer, then the one whose name comes first; the other gives up and obeys it. Who
obeys takes no lease of a third before this one is over: its holder says so, or its time has run out.

None of this makes sure that no lamp changes in a sweep: words get lost, lenders fall silent or are switched off. That
is `proof`'s, which believes nothing but numbers that go up. So a fault here costs light and time, never truth.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from msgspec import UNSET

from agent.core.capability_messages import MOST_HOLDS_S, Lease, LeaseAck, Light, Why

SILENT_NS = 3_000_000_000  # who was not heard for so long is not waited for
GONE_NS = 10_000_000_000  # whose lamp is dark, or as it was: nobody who is there is silent for so long

Phase = Literal["free", "asks", "holds", "obeys"]


class Word(NamedTuple):
    """The newest of one neighbour."""

    said: Light
    arrived_ns: int


class Mine(NamedTuple):
    """The lease that this robot asks for or holds."""

    lease: Lease  # as asked for; left_s is that of the beginning
    asked_ns: int
    ends_ns: int
    granted: bool = False


class Bound(NamedTuple):
    """The lease of a neighbour that this robot obeys."""

    holder: str
    incarnation: int
    lease: Lease  # as it came first: its aims and powers stay
    ends_ns: int


class Party(NamedTuple):
    """One robot, between steps."""

    me: str
    incarnation: int
    neighbours: tuple[str, ...] = ()
    since_ns: int = 0  # when it began to listen
    number: int = 0  # of its newest lease
    mine: Mine | None = None
    bound: Bound | None = None
    words: tuple[tuple[str, Word], ...] = ()  # by neighbour, in the order of names

    @property
    def phase(self) -> Phase:
        if self.bound is not None:
            return "obeys"
        return "free" if self.mine is None else "holds" if self.mine.granted else "asks"

    def word(self, name: str) -> Word | None:
        return next((word for src, word in self.words if src == name), None)

    def answer(self, src: str) -> LeaseAck | None:
        """The ack of a neighbour to the lease that this robot asks for or holds."""
        word = self.word(src)
        ack = UNSET if word is None else word.said.ack
        if self.mine is None or ack is UNSET:
            return None
        mine = (self.incarnation, self.mine.lease.number)
        return ack if (ack.incarnation, ack.number) == mine else None


def acquainted(party: Party, now_ns: int) -> bool:
    """Whether each neighbour was heard since the start, or there was time enough for it. Until then a lamp may burn, or
    go out, of which this robot knows nothing; nobody asks for light before."""
    return now_ns - party.since_ns > GONE_NS or all(party.word(name) is not None for name in party.neighbours)


def ask(party: Party, lease: Lease, now_ns: int) -> Party:
    """Ask for light; only who is free can. The lease gets the next number."""
    assert party.phase == "free"
    number = party.number + 1
    numbered = Lease(number, lease.waited, lease.left_s, False, lease.at_m, lease.lamps)
    ends_ns = now_ns + round(lease.left_s * 1e9)
    return party._replace(number=number, mine=Mine(numbered, now_ns, ends_ns))


def release(party: Party) -> Party:
    """Give up the own lease, whether it was granted or not."""
    return party._replace(mine=None)


def hear(party: Party, said: Light, arrived_ns: int) -> Party:
    """A believed word of a neighbour; words of one neighbour come in the order in which they were said."""
    others = [(name, word) for name, word in party.words if name != said.src]
    party = party._replace(words=tuple(sorted([*others, (said.src, Word(said, arrived_ns))])))
    bound, lease = party.bound, said.lease
    if bound is not None and bound.holder == said.src:
        if lease is not UNSET and (said.incarnation, lease.number) == (bound.incarnation, bound.lease.number):
            # What is left of it is counted from when that was said: the quickest word knows best.
            ends_ns = min(bound.ends_ns, arrived_ns + round(lease.left_s * 1e9))
            return party._replace(bound=bound._replace(ends_ns=ends_ns))
        party = party._replace(bound=None)
    return party if lease is UNSET else _offered(party, said, lease, arrived_ns)


def _offered(party: Party, said: Light, lease: Lease, arrived_ns: int) -> Party:
    """A neighbour's lease, which this robot obeys unless its own or a third's counts more."""
    if party.bound is not None or not lease.left_s:
        return party
    if (mine := party.mine) is not None:
        if mine.granted:
            return party
        if not lease.granted and _before(mine.lease, party.me, lease, said.src):
            return party
    ends_ns = arrived_ns + round(min(lease.left_s, MOST_HOLDS_S) * 1e9)
    return party._replace(mine=None, bound=Bound(said.src, said.incarnation, lease, ends_ns))


def _before(lease: Lease, holder: str, other: Lease, others: str) -> bool:
    """Whether the first of two that are asked for counts."""
    return (-lease.waited, holder) < (-other.waited, others)


def tick(party: Party, guard_ns: int, now_ns: int) -> Party:
    """What time does: leases end, and whoever asked has been answered or has waited for long enough.

    All who were heard of late obey, or the guard is over and nobody busy: the own lease is in force. Somebody busy
    when the guard is over: it is given up.
    """
    if party.bound is not None and now_ns >= party.bound.ends_ns:
        party = party._replace(bound=None)
    mine = party.mine
    if mine is None:
        return party
    if now_ns >= mine.ends_ns:
        return release(party)
    if mine.granted:
        return party
    answers = [party.answer(name) for name in listeners(party, now_ns)]
    if all(ack is not None and ack.obeys for ack in answers):
        return party._replace(mine=mine._replace(granted=True))
    if now_ns < mine.asked_ns + guard_ns:
        return party
    if any(ack is not None and not ack.obeys for ack in answers):
        return release(party)
    return party._replace(mine=mine._replace(granted=True))


def listeners(party: Party, now_ns: int) -> tuple[str, ...]:
    """Neighbours that were heard of late."""
    return tuple(name for name, word in party.words if now_ns - word.arrived_ns <= SILENT_NS)


def lit_by(party: Party) -> tuple[str, ...]:
    """Whose lamps burn by the own lease: those that say so, and the own one where it is named or nobody else does."""
    if party.mine is None:
        return ()
    asked = {name for name, power in party.mine.lease.lamps if power > 0.0}
    answers = {name: party.answer(name) for name in asked if name != party.me}
    burning = {name for name, ack in answers.items() if ack is not None and ack.obeys and not ack.why}
    return tuple(sorted(burning | ({party.me} if party.me in asked or not burning else set())))


def ack_to(party: Party, src: str, dark: Why) -> LeaseAck | None:
    """What to answer a neighbour. dark: why the own lamp stays dark though it is named; empty: it burns."""
    word = party.word(src)
    lease = UNSET if word is None else word.said.lease
    if word is None or lease is UNSET:
        return None
    incarnation, bound = word.said.incarnation, party.bound
    if bound is not None and (bound.holder, bound.incarnation, bound.lease.number) == (src, incarnation, lease.number):
        named = any(name == party.me and power > 0.0 for name, power in bound.lease.lamps)
        return LeaseAck(incarnation, lease.number, True, dark if named else "")
    whose = party.me if bound is None else bound.holder
    return LeaseAck(incarnation, lease.number, False, "busy", whose)


def said_lease(party: Party, now_ns: int) -> Lease | None:
    """The own lease as it is told now."""
    mine = party.mine
    if mine is None:
        return None
    left_s = max(mine.ends_ns - now_ns, 0) * 1e-9
    was = mine.lease
    return Lease(was.number, was.waited, left_s, mine.granted, was.at_m, was.lamps)
