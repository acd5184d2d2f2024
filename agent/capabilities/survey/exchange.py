"""Keyframes between robots: what came is checked and taken in, and what a neighbour lacks is sent again.

Each says twice a second what it holds. A keyframe goes to a neighbour once when it is made, and again when a word of
the neighbour that is later than that shows that it is still lacking. So maps become equal whatever is lost, and a
fleet that has all says nothing but which robot has what. Of each start a neighbour gets no more than it can say of
which it has: what follows the first that it lacks, by SHORT_MASK numbers.

In a fleet with keys a keyframe counts by the signature of its origin, by whatever way it came. Without keys the robot
that measured speaks for itself: of an origin that is a neighbour and was heard of late its own word alone is taken. Of
one that is silent, or beyond the neighbours, any robot's is. So a robot that lies can invent what such a one saw, and
the price is that no robot looks there; what is held already it cannot push out (coverage_map.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.survey.coverage_map import STARTS, SUMS, CoverageMap, Held, Key, Start
from agent.core.capability_messages import SHORT_MASK, Claim, Frame, Has, Keyframe, View, claim_fault, frame_fault
from agent.core.codec import Refusal
from agent.core.config import Fleet
from agent.core.link_clocks import CLOCKS_NS
from agent.core.step_transaction import Revertible
from agent.core.trust import HEARSAY, OVERDRAWN, Authority, MessageCache, keyframe_bytes

CLAIM_NS = 500_000_000  # twice a second each says what it holds
SEND_NS = 100_000_000  # from one keyframe to the next
ANSWER_NS = 300_000_000  # a word that shows what is lacking is so much later than what was sent
LONGEST_NS = 60_000_000_000  # a claim on a view ends by itself
MOST_HAS = 128


class Exchange(Revertible):
    """Of one robot, between steps."""

    def __init__(self, fleet: Fleet, name: str, incarnation: int, known: CoverageMap) -> None:
        self._fleet, self._name, self._incarnation, self._tank_m = fleet.fleet, name, incarnation, fleet.tank.size_m
        self._robots = frozenset(fleet.robot)
        self._neighbours_of = {robot: frozenset(fleet.robot[robot].neighbours) for robot in fleet.robot}
        neighbours = fleet.robot[name].neighbours
        self.cache = MessageCache[Claim](fleet.fleet, name, neighbours)
        self._keyframes = MessageCache[Keyframe](fleet.fleet, name, neighbours)
        self.known = known
        self._authority = Authority(neighbours)
        if fleet.access.keys is not None:
            self.trust({})  # until they are read nothing counts
        self._took: tuple[str, ...] = ()  # neighbours of which a keyframe was taken in in this step
        self._before: tuple[str, ...] = ()  # and in the one before
        # Of each neighbour what it lacks, and when that was last sent.
        self._sent: dict[str, dict[Key, int]] = {neighbour: {} for neighbour in self.cache.senders}
        self._seqs = {neighbour: 0 for neighbour in self.cache.senders}
        self._said = self._due_ns = self._send_due_ns = 0

    def trust(self, keys: Mapping[str, bytes]) -> None:
        """Public keys of the robots, when they were read or changed."""
        self._authority.replace_keys(keys)

    def end_step(self) -> None:
        """What there is left of SUMS goes to what has to leave the map."""
        self.known.let_go(SUMS - self.known.sums)
        self._before, self._took = self._took, ()

    def hear_claim(self, src: str, claim: Claim, arrived_ns: int) -> None:
        """A decoded message that came on the key of `src`. Raises Refusal where it cannot be so."""
        if (fault := claim_fault(claim, self._tank_m)) is not None:
            raise Refusal("content", fault)
        self.cache.put(src, claim, arrived_ns)
        self._authority.heard(src, arrived_ns)

    def hear_keyframe(self, src: str, said: Keyframe, arrived_ns: int) -> None:
        """Likewise. One that is held already, or that its origin has to say itself, changes nothing."""
        frame = said.frame
        if (fault := frame_fault(frame, self._tank_m)) is not None:
            raise Refusal("content", fault)
        if frame.origin not in self._robots:
            raise Refusal("content", "measured by a robot that is not in our fleet file")
        if frame.incarnation > arrived_ns + CLOCKS_NS:
            raise Refusal("clock", "its clock is more than three hours ahead of ours; set the clocks")
        self._keyframes.put(src, said, arrived_ns)
        self._authority.heard(src, arrived_ns)
        if (frame.origin == self._name and frame.incarnation >= self._incarnation) or not self._has_room(src, frame):
            return
        signature = said.signature or b""
        by = self._authority.fault(src, frame.origin, signature, lambda: keyframe_bytes(self._fleet, frame), arrived_ns)
        if by not in (None, HEARSAY, OVERDRAWN):
            raise Refusal("signature", f"keyframe of {frame.origin}: {by}")
        if by is None and self.known.add(frame, self._signed or src == frame.origin, signature):
            self._took = *self._took, src

    def claims(self, now_ns: int) -> tuple[tuple[str, View], ...]:
        """Views that others are about to take, in the order of their names."""
        found = []
        for name, sender in self.cache.senders.items():
            letter = sender.newest
            view = UNSET if letter is None else letter.message.view
            if letter is None or view is UNSET:
                continue
            lasts_ns = min(letter.message.until_ns - letter.message.sent_ns, LONGEST_NS)
            if now_ns < letter.arrived_ns - letter.late_ns + lasts_ns:
                found.append((name, view))
        return tuple(found)

    def send(self, now_ns: int) -> tuple[Keyframe, ...]:
        """At most one keyframe to each neighbour: the first that it lacks and was not sent, or that was lost."""
        found: list[Keyframe] = []
        if now_ns < self._send_due_ns:
            return ()
        self._send_due_ns = now_ns + SEND_NS
        for neighbour in self.cache.senders:
            key = self._lacks(neighbour, now_ns)
            if key is None:
                continue
            self._sent[neighbour][key] = now_ns
            self._seqs[neighbour] += 1
            found.append(self._word(neighbour, self.known.held[key[:2]][key[2]], now_ns))
        return tuple(found)

    def say(self, view: View | None, until_ns: int, now_ns: int) -> tuple[Claim, ...]:
        """What it holds and where it looks, to each neighbour, twice a second."""
        if now_ns < self._due_ns or not self.cache.senders:
            return ()
        self._due_ns = now_ns + CLAIM_NS
        self._said += 1
        said = Claim(
            fleet=self._fleet,
            src=self._name,
            dst=self._name,
            incarnation=self._incarnation,
            seq=self._said,
            sent_ns=now_ns,
            view=UNSET if view is None else view,
            until_ns=0 if view is None else until_ns,
            has=holdings(self.known),
            share=self.known.share(),
            digest=self.known.digest(),
        )
        return tuple(replace(said, dst=neighbour) for neighbour in self.cache.senders)

    @property
    def _signed(self) -> bool:
        return self._authority.keys is not None

    def _has_room(self, src: str, frame: Frame) -> bool:
        """Whether a keyframe of this neighbour can be added in this step: one of each, and while others leave the map
        one of all in turn."""
        if self.known.leaving:
            return not self.known.sums and src not in self._before
        takes = 2 if self.known.has(frame) else 1  # that one goes out, this one comes in
        return src not in self._took and self.known.sums + takes <= SUMS

    def _lacks(self, neighbour: str, now_ns: int) -> Key | None:
        """The first keyframe that it is to be sent now."""
        newest = self.cache.senders[neighbour].newest
        heard_ns = -1 if newest is None else newest.arrived_ns - newest.late_ns
        has = {} if newest is None else {(h.origin, h.incarnation): h for h in newest.message.has}
        sent, self._sent[neighbour] = self._sent[neighbour], {}
        found: Key | None = None
        for start, frames in self.known.held.items():
            if not self._passes_on(start, neighbour, has, now_ns):
                continue
            for number in _missing(has.get(start)):
                if number not in frames:
                    continue
                key = *start, number
                sent_ns = sent.get(key)
                if sent_ns is not None:
                    self._sent[neighbour][key] = sent_ns
                if found is None and (sent_ns is None or heard_ns > sent_ns + ANSWER_NS):
                    found = key
        return found

    def _passes_on(self, start: Start, neighbour: str, has: Mapping[Start, Has], now_ns: int) -> bool:
        """Whether that neighbour would take keyframes of this start from this robot."""
        origin, incarnation = start
        if origin == self._name:
            return True
        if origin == neighbour:
            newest = self.cache.senders[neighbour].newest
            if newest is None or incarnation >= newest.message.incarnation:
                return False
        elif origin in self._neighbours_of[neighbour] and self._authority.speaks_for_itself(origin, now_ns):
            return False
        theirs = [began for name, began in has if name == origin]
        return start in has or len(theirs) < STARTS or (self._signed and incarnation > min(theirs))

    def _word(self, neighbour: str, held: Held, now_ns: int) -> Keyframe:
        return Keyframe(
            fleet=self._fleet,
            src=self._name,
            dst=neighbour,
            incarnation=self._incarnation,
            seq=self._seqs[neighbour],
            sent_ns=now_ns,
            frame=held.frame,
            signature=held.signature or UNSET,
        )


def holdings(known: CoverageMap) -> tuple[Has, ...]:
    """What a map holds, by origin and start."""
    found = []
    for (origin, incarnation), held in sorted(known.held.items()):
        upto = 0
        while upto + 1 in held:
            upto += 1
        beyond = sum(1 << k for k in range(SHORT_MASK) if upto + 2 + k in held)
        found.append(Has(origin, incarnation, upto, beyond))
    return tuple(found[-MOST_HAS:])


def _missing(has: Has | None) -> Iterator[int]:
    """Numbers of one start that a robot lacks, as far as it can say which it has."""
    upto, beyond = (0, 0) if has is None else (has.upto, has.beyond)
    yield upto + 1
    yield from (upto + 2 + k for k in range(SHORT_MASK) if not beyond >> k & 1)
