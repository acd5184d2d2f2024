"""Which robot has the light: one robot of a fleet at a time, by a state machine without a clock, pictures or lamps. And
the check that no lamp changed in a sweep, and the messages of both.

    free --ask--> asks --all answered, or guard over--> holds --release--> free
    free, asks --a neighbour's lease--> obeys --it is over--> free

Each neighbour answers a robot that asks: it obeys, or it obeys another ("busy"). Of two that ask at the same time the
one counts that has waited longer, then the one whose name comes first; the other gives up and obeys it. A robot that
obeys takes no lease of a third before this one is over: its holder says so, or its time has run out.

No robot keeps the light. After a lease its holder waits behind those that asked, whatever it says. Each obeys nobody
for more than MOST_NS of a minute. One that says that it is busy is believed while the lease that it names can be one.

None of this makes sure that no lamp changes in a sweep: words get lost, lenders fall silent or are switched off. The
lamp-constancy check below does that, by monotonic counters alone. So a fault here costs light and time, never truth.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from msgspec import UNSET
from msgspec.structs import replace

from agent.core.capability import Spoiled
from agent.core.capability_messages import MOST_HOLDS_S, LampNow, Lease, LeaseAck, Light, Why, light_fault
from agent.core.codec import Refusal
from agent.core.config import Fleet
from agent.core.step_transaction import Revertible
from agent.core.topics import LIGHT, next_due_ns
from agent.core.trust import MessageCache

SILENT_NS = 3_000_000_000  # who was not heard for so long is not waited for
GONE_NS = 10_000_000_000  # whose lamp is dark, or as it was: nobody who is there is silent for so long

PAUSE_NS = 100_000_000  # after a lease, in which its holder has no other: those that waited ask now
MINUTE_NS, MOST_NS = 60_000_000_000, 50_000_000_000  # of the last minute one robot has the light for so long at most
TENTH_NS = 100_000_000  # the unit of Lease.waited

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
    lease: Lease  # as it came first, its aims and powers stay; granted: as soon as it was so once
    began_ns: int
    ends_ns: int


class Had(NamedTuple):
    """A stretch of time in which a robot had the light, or nobody else because of it."""

    holder: str
    began_ns: int
    ended_ns: int
    granted: bool = True  # else it was given up while it was asked for, and the holder has had no turn


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
    had: tuple[Had, ...] = ()  # in the last minute, in the order in which they ended

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


def release(party: Party, now_ns: int) -> Party:
    """Give up the own lease, whether it was granted or not."""
    mine, party = party.mine, party._replace(mine=None)
    return party if mine is None or not mine.granted else _noted(party, Had(party.me, mine.asked_ns, now_ns))


def may_have(party: Party, name: str, left_s: float, now_ns: int) -> bool:
    """Whether it is a robot's turn for a lease of that length, by what it has had of the last minute."""
    last_ns = next((each.ended_ns for each in reversed(party.had) if each.holder == name and each.granted), None)
    if last_ns is not None and now_ns - last_ns < PAUSE_NS:
        return False
    return _had_ns(party, (name,), now_ns) + round(min(left_s, MOST_HOLDS_S) * 1e9) <= MOST_NS


def _had_ns(party: Party, names: tuple[str, ...], now_ns: int) -> int:
    """How much of the last minute robots have had together."""
    since_ns = now_ns - MINUTE_NS
    return sum(max(each.ended_ns - max(each.began_ns, since_ns), 0) for each in party.had if each.holder in names)


def _noted(party: Party, had: Had) -> Party:
    recent = (each for each in party.had if had.ended_ns - each.ended_ns < MINUTE_NS)
    return party._replace(had=(*recent, had))


def _unbound(party: Party, now_ns: int) -> Party:
    """The lease that it obeyed is over."""
    bound = party.bound
    assert bound is not None
    return _noted(party._replace(bound=None), Had(bound.holder, bound.began_ns, now_ns, bound.lease.granted))


def hear(party: Party, said: Light, arrived_ns: int) -> Party:
    """A believed word of a neighbour; words of one neighbour come in the order in which they were said."""
    others = [(name, word) for name, word in party.words if name != said.src]
    party = party._replace(words=tuple(sorted([*others, (said.src, Word(said, arrived_ns))])))
    bound, lease = party.bound, said.lease
    if bound is not None and bound.holder == said.src:
        if lease is not UNSET and (said.incarnation, lease.number) == (bound.incarnation, bound.lease.number):
            # What is left of it is counted from when that was said: the quickest word knows best.
            ends_ns = min(bound.ends_ns, arrived_ns + round(lease.left_s * 1e9))
            known = replace(bound.lease, granted=bound.lease.granted or lease.granted)
            return party._replace(bound=bound._replace(lease=known, ends_ns=ends_ns))
        party = _unbound(party, arrived_ns)
    return party if lease is UNSET else _offered(party, said, lease, arrived_ns)


def _offered(party: Party, said: Light, lease: Lease, arrived_ns: int) -> Party:
    """A neighbour's lease, which this robot obeys unless its own or a third's counts more."""
    if party.bound is not None or not _counts(party, said.src, lease, arrived_ns):
        return party
    if (mine := party.mine) is not None:
        if mine.granted:
            return party
        if not lease.granted and _before(mine.lease, party.me, lease, said.src):
            return party
    ends_ns = arrived_ns + round(min(lease.left_s, MOST_HOLDS_S) * 1e9)
    bound = Bound(said.src, said.incarnation, lease, arrived_ns, ends_ns)
    return party._replace(mine=None, bound=bound)


def _counts(party: Party, holder: str, lease: Lease, now_ns: int) -> bool:
    """Whether a neighbour can have this lease: it has had neither its share of the last minute, nor a turn since this
    robot began to wait for what it asks for. What a neighbour gave up counts as share, for those who obeyed it had no
    light, and as no turn: it goes on asking, and both would believe that the other has none."""
    if not lease.left_s or not may_have(party, holder, lease.left_s, now_ns):
        return False
    if (mine := party.mine) is None:
        return True
    waits_ns = mine.asked_ns - mine.lease.waited * TENTH_NS
    return not any(each.holder == holder and each.granted and each.ended_ns > waits_ns for each in party.had)


def _before(lease: Lease, holder: str, other: Lease, others: str) -> bool:
    """Whether the first of two that are asked for counts."""
    return (-lease.waited, holder) < (-other.waited, others)


def tick(party: Party, guard_ns: int, now_ns: int) -> Party:
    """What time does: leases end, and a robot that asked has been answered or has waited for long enough.

    All who were heard of late obey, or the guard is over and nobody busy: the own lease is in force. Somebody busy
    when the guard is over, with a lease that can be one: it is given up.
    """
    if party.bound is not None and now_ns >= party.bound.ends_ns:
        party = _unbound(party, now_ns)
    mine = party.mine
    if mine is None:
        return party
    if now_ns >= mine.ends_ns:
        return release(party, now_ns)
    if mine.granted:
        return party
    answers = {name: party.answer(name) for name in listeners(party, now_ns)}
    if all(ack is not None and ack.obeys for ack in answers.values()):
        return party._replace(mine=mine._replace(granted=True))
    if now_ns < mine.asked_ns + guard_ns:
        return party
    for name, ack in answers.items():
        if ack is not None and not ack.obeys and (whose := _busy_with(party, name, ack, now_ns)) is not None:
            party = release(party, now_ns)
            # From one wish to the next there is less than the guard: of somebody always busy all of a minute counts.
            return _noted(party, Had(whose, mine.asked_ns - guard_ns, now_ns)) if party.word(whose) is None else party
    return party._replace(mine=mine._replace(granted=True))


def _busy_with(party: Party, name: str, ack: LeaseAck, now_ns: int) -> str | None:
    """Whose lease a neighbour obeys, or has; None: that cannot be. Of a robot out of reach its word counts,
    for as much of a minute as its own leases leave."""
    whose = ack.whose or name
    if whose not in (*party.neighbours, party.me, name):
        via = f"via {name}"
        return via if _had_ns(party, (name, via), now_ns) < MOST_NS else None
    word = party.word(whose)
    lease = UNSET if word is None else word.said.lease
    if word is None or lease is UNSET or now_ns >= word.arrived_ns + round(lease.left_s * 1e9):
        return None
    return whose if _counts(party, whose, lease, now_ns) else None


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


# --- lamp-constancy check by monotonic counters ---
# Whether any lamp changed while a sweep ran: by numbers that go up alone, never by a clock.
#
# Before the sweep: of each neighbour that was heard of late the newest word, which says that its lamp is steady, and
# how often it had changed. After it: a word of the same start, with the same count, of somebody who had heard what
# this robot said after the last frame. What lies between has then seen no change. A lamp that was told to change and
# did not yet is not steady, and one that will change has counted it before it does.

Verdict = Literal["pending", "kept"]


class Mark(NamedTuple):
    """A neighbour's lamp as it was before the sweep."""

    incarnation: int
    changes: int
    power: float


class Baseline(NamedTuple):
    """All lamps as a sweep begins."""

    since_ns: int
    own_changes: int
    marks: tuple[tuple[str, Mark], ...]  # by name


def baseline(party: Party, own: LampNow, now_ns: int) -> Baseline | str:
    """What a sweep that begins now starts from; or whose lamp is still to come to rest."""
    if not own.steady:
        return party.me
    if not acquainted(party, now_ns):
        return next(name for name in party.neighbours if party.word(name) is None)
    marks = []
    for name, word in party.words:
        if now_ns - word.arrived_ns > GONE_NS:
            continue
        lamp = word.said.lamp
        if not lamp.steady:
            return name
        marks.append((name, Mark(word.said.incarnation, lamp.changes, lamp.power)))
    return Baseline(now_ns, own.changes, tuple(marks))


def verdict(party: Party, before: Baseline, own: LampNow, after_seq: int) -> Verdict | Spoiled:
    """Whether a sweep counts that ended before this robot said its word number `after_seq`."""
    if own.changes != before.own_changes:
        return Spoiled("its own lamp changed")
    marks, pending = dict(before.marks), False
    for name, word in party.words:
        mark, said = marks.get(name), word.said
        if said.lamp.cannot == "no lamp":
            continue
        if mark is None:
            if word.arrived_ns > before.since_ns:
                return Spoiled(f"{name} was not heard of before, and its lamp may have changed")
            continue
        if said.incarnation != mark.incarnation:
            return Spoiled(f"{name} was started anew")
        if said.lamp.changes != mark.changes:
            whose = said.lamp.burns_for
            return Spoiled(f"the lamp of {name} changed" + (f", for {whose}" if whose not in (None, party.me) else ""))
        heard = said.heard
        pending = pending or heard is None or heard[0] != party.incarnation or heard[1] < after_seq
    return "pending" if pending else "kept"


# --- messages in and out ---
# One robot's part in who has the light, between steps: words in and out, the lease, and the check of its sweeps.

SLOW_NS = round(1e9 / LIGHT.hz)
JUDGE_NS = 1_500_000_000  # after a sweep: by then all have been heard, or it does not count


class Talk(Revertible):
    """Of one robot of a fleet with [lighting]."""

    def __init__(self, fleet: Fleet, name: str, incarnation: int) -> None:
        assert fleet.lighting is not None
        self._fleet, self._tank_m, self._guard_ns = fleet.fleet, fleet.tank.size_m, round(fleet.lighting.guard_s * 1e9)
        self.party = Party(name, incarnation, tuple(sorted(fleet.robot[name].neighbours)))
        self.cache = MessageCache[Light](fleet.fleet, name, fleet.robot[name].neighbours)
        self._seq = 0
        self._due_ns = 0
        self._before: Baseline | None = None  # of the sweep that runs, or is judged
        self._after: tuple[int, int] | None = None  # of one that is judged: the word after it, and since when

    def hear(self, src: str, said: Light, arrived_ns: int) -> None:
        """A decoded message that came on the key of `src`. Raises Refusal where it cannot be so."""
        if (fault := light_fault(said, self._tank_m)) is not None:
            raise Refusal("content", fault)
        letter = self.cache.put(src, said, arrived_ns)
        self.party = hear(self.party, said, arrived_ns - letter.late_ns)

    def tick(self, now_ns: int) -> None:
        if not self.party.since_ns:
            self.party = self.party._replace(since_ns=now_ns)
        self.party = tick(self.party, self._guard_ns, now_ns)

    def acquainted(self, now_ns: int) -> bool:
        """Whether it knows of all neighbours by now who is there."""
        return acquainted(self.party, now_ns)

    def may_have(self, lease: Lease, now_ns: int) -> bool:
        """Whether neighbours can be asked for it: it has left them their share of the last minute."""
        return not self.party.neighbours or may_have(self.party, self.party.me, lease.left_s, now_ns)

    def ask(self, lease: Lease, now_ns: int) -> None:
        """Ask for light; only who is free can."""
        self.party = ask(self.party, lease, now_ns)

    def release(self, now_ns: int) -> None:
        """The own lease is over, and a sweep by it; neighbours are told at once."""
        self.party, self._before, self._after = release(self.party, now_ns), None, None
        self._due_ns = 0

    def rests(self, own: LampNow, now_ns: int) -> bool:
        """Whether all lamps are at rest that this robot knows of."""
        return not isinstance(baseline(self.party, own, now_ns), str)

    def begin(self, own: LampNow, now_ns: int) -> None:
        """A sweep begins now; while a lamp is not at rest nothing can prove that it counts."""
        found = baseline(self.party, own, now_ns)
        self._before, self._after = None if isinstance(found, str) else found, None

    def end(self, now_ns: int) -> None:
        """Its last frame is in."""
        self._after = self._seq + 1, now_ns

    def verdict(self, own: LampNow, now_ns: int) -> Spoiled | bool | None:
        """What became of the sweep that ended: True, it counts; None: not known yet."""
        if self._after is None or self._before is None:
            return Spoiled("nobody was asked for light")
        after_seq, since_ns = self._after
        found = verdict(self.party, self._before, own, after_seq)
        if found == "pending":
            return Spoiled("not all lamps were heard of after it") if now_ns - since_ns > JUDGE_NS else None
        return True if found == "kept" else found

    def burned(self, own: LampNow) -> tuple[str, ...]:
        """Whose lamps burned when the sweep began, as their robots said."""
        before = self._before
        others = () if before is None else (name for name, mark in before.marks if mark.power > 0.0)
        return tuple(sorted((*others, *((self.party.me,) if own.power > 0.0 else ()))))

    def say(self, own: LampNow, dark: Why, now_ns: int) -> tuple[Light, ...]:
        """To each neighbour: in each step while there is a lease, else ten times a second. dark: why the own lamp does
        not burn for the lease that it obeys."""
        at_leisure = self.party.phase == "free"
        if not self.cache.senders or (at_leisure and now_ns < self._due_ns):
            return ()
        self._due_ns = next_due_ns(self._due_ns, SLOW_NS, now_ns)
        self._seq += 1
        said = Light(
            fleet=self._fleet,
            src=self.party.me,
            dst=self.party.me,
            incarnation=self.party.incarnation,
            seq=self._seq,
            sent_ns=now_ns,
            lamp=own,
            lease=said_lease(self.party, now_ns) or UNSET,
        )
        return tuple(self._to(said, neighbour, dark) for neighbour in self.cache.senders)

    def _to(self, said: Light, neighbour: str, dark: Why) -> Light:
        word = self.party.word(neighbour)
        heard = None if word is None else (word.said.incarnation, word.said.seq)
        ack = ack_to(self.party, neighbour, dark)
        return replace(said, dst=neighbour, heard=heard, ack=UNSET if ack is None else ack)
