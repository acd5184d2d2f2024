"""Keyframes between robots: what came is checked and taken in, and what a neighbour lacks is sent again.

Each says twice a second what it holds. A keyframe goes to a neighbour once when it is made, and again when a word of
the neighbour that is later than that shows that it is still lacking. So maps become equal whatever is lost, and a
fleet that has all says nothing but which robot has what.

The robot that measured speaks for itself: of an origin that is a neighbour and was heard of late its own word alone is
taken. Of one that is silent, or beyond the neighbours, any robot's is, for keyframes are not signed: a robot that lies
can invent what such a one saw, and the price is that no robot looks there.
"""

from __future__ import annotations

from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.survey.coverage_map import CoverageMap, Key
from agent.core.capability_messages import SHORT_MASK, Claim, Frame, Has, Keyframe, View, claim_fault, frame_fault
from agent.core.codec import Refusal
from agent.core.config import Fleet
from agent.core.link_clocks import CLOCKS_NS
from agent.core.step_transaction import Revertible
from agent.core.trust import MessageCache

SILENT_NS = 3_000_000_000  # by then an origin no longer speaks for itself
CLAIM_NS = 500_000_000  # twice a second each says what it holds
SEND_NS = 100_000_000  # from one keyframe to the next
ANSWER_NS = 300_000_000  # a word that shows what is lacking is so much later than what was sent
LONGEST_NS = 60_000_000_000  # a claim on a view ends by itself
FOLDS = 4  # keyframes taken in in one step; those beyond are sent again
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
        self._sent: dict[tuple[str, Key], int] = {}  # when it was last sent
        self._seqs = {neighbour: 0 for neighbour in self.cache.senders}
        self._said = self._due_ns = self._send_due_ns = self._folds = 0

    def end_step(self) -> None:
        self._folds = 0

    def hear_claim(self, src: str, claim: Claim, arrived_ns: int) -> None:
        """A decoded message that came on the key of `src`. Raises Refusal where it cannot be so."""
        if (fault := claim_fault(claim, self._tank_m)) is not None:
            raise Refusal("content", fault)
        self.cache.put(src, claim, arrived_ns)

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
        if frame.origin == self._name and frame.incarnation >= self._incarnation:
            return
        mine = frame.origin == self._name  # of a start before this one: any robot that has it may bring it back
        if frame.origin != src and not mine and self._speaks(frame.origin, arrived_ns):
            return
        if self._folds < FOLDS:
            self._folds += 1
            self.known.add(frame)

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
            self._sent[neighbour, key] = now_ns
            self._seqs[neighbour] += 1
            found.append(self._word(neighbour, self.known.held[key].frame, now_ns))
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

    def _speaks(self, origin: str, now_ns: int) -> bool:
        """Whether an origin is a neighbour of which a word was heard of late."""
        if origin not in self.cache.senders:
            return False
        age_ns = self.cache.age_ns(origin, now_ns)
        return age_ns is not None and age_ns <= SILENT_NS

    def _lacks(self, neighbour: str, now_ns: int) -> Key | None:
        newest = self.cache.senders[neighbour].newest
        heard_ns = -1 if newest is None else newest.arrived_ns - newest.late_ns
        has = {} if newest is None else {(h.origin, h.incarnation): h for h in newest.message.has}
        for key in self.known.held:
            if not self._passes_on(key, neighbour, now_ns) or _is_in(has.get(key[:2]), key[2]):
                continue
            sent_ns = self._sent.get((neighbour, key))
            if sent_ns is None or heard_ns > sent_ns + ANSWER_NS:
                return key
        return None

    def _passes_on(self, key: Key, neighbour: str, now_ns: int) -> bool:
        """Whether that neighbour would take this keyframe from this robot."""
        origin, newest = key[0], self.cache.senders[neighbour].newest
        if origin == self._name:
            return True
        if origin == neighbour:
            return newest is not None and key[1] < newest.message.incarnation
        return origin not in self._neighbours_of[neighbour] or not self._speaks(origin, now_ns)

    def _word(self, neighbour: str, frame: Frame, now_ns: int) -> Keyframe:
        return Keyframe(
            fleet=self._fleet,
            src=self._name,
            dst=neighbour,
            incarnation=self._incarnation,
            seq=self._seqs[neighbour],
            sent_ns=now_ns,
            frame=frame,
        )


def holdings(known: CoverageMap) -> tuple[Has, ...]:
    """What a map holds, by origin and start."""
    numbers: dict[tuple[str, int], set[int]] = {}
    for origin, incarnation, number in known.held:
        numbers.setdefault((origin, incarnation), set()).add(number)
    found = []
    for (origin, incarnation), held in sorted(numbers.items()):
        upto = 0
        while upto + 1 in held:
            upto += 1
        beyond = sum(1 << k for k in range(SHORT_MASK) if upto + 2 + k in held)
        found.append(Has(origin, incarnation, upto, beyond))
    return tuple(found[-MOST_HAS:])


def _is_in(has: Has | None, number: int) -> bool:
    if has is None:
        return False
    beyond = number - has.upto - 2
    return number <= has.upto or (0 <= beyond < SHORT_MASK and has.beyond >> beyond & 1 == 1)
