"""A robot's turns at the light, whatever it wants it for: when it may ask, how long it may look, what became of it."""

from __future__ import annotations

from agent.capabilities.light.lease import Phase, lit_by
from agent.capabilities.light.own_lamp import OwnLamp
from agent.capabilities.light.proof import Spoiled
from agent.capabilities.light.talk import Talk
from agent.core.capability_messages import Lease
from agent.core.step_transaction import Revertible

LOOK_NS = 3_500_000_000  # from the grant to the sweep: lamps and gimbal come to rest, the target comes into the middle
MARGIN_NS = 2_000_000_000  # of a lease, beyond that and the sweep: until all have said that nothing changed
AGAIN_NS, LONGEST_AGAIN_NS = 400_000_000, 6_400_000_000  # after light that gave nothing, the next time twice as long
RETRY_NS = 200_000_000  # after a lease that was not given, and after one that was


class Turn(Revertible):
    """Of one robot of a fleet with [lighting], between steps."""

    def __init__(self, talk: Talk, own: OwnLamp) -> None:
        self.talk, self.own = talk, own
        self.granted_ns = self._served_ns = self._retry_ns = 0
        self.swept = False  # a sweep began by the lease
        self.judging = False  # one has ended whose light is not known to have stayed
        self.spoiled = 0  # sweeps so far whose light did not
        self._fruitless = 0  # leases in a row without one
        self.assumed, self.burned = tuple[str, ...](), tuple[str, ...]()  # whose lamps a sweep took to, and that did

    @property
    def phase(self) -> Phase:
        return self.talk.party.phase

    def tick(self, now_ns: int) -> bool:
        """Leases end and are granted; returns whether the own one has lasted for too long without a sweep."""
        self._served_ns = self._served_ns or now_ns
        before = self.phase
        self.talk.tick(now_ns)
        phase = self.phase
        if phase == "holds" != before:
            self.granted_ns, self.swept = now_ns, False
        elif phase == "free" and before == "asks":
            self._retry_ns = now_ns + RETRY_NS
        return phase == "holds" and not self.swept and now_ns - self.granted_ns > LOOK_NS

    def idle(self, now_ns: int) -> bool:
        """It may ask."""
        known = now_ns >= self._retry_ns and self.talk.acquainted(now_ns)
        return self.phase == "free" and known and not self.judging

    def rests(self, now_ns: int) -> bool:
        """All lamps that this robot knows of are at rest, its own by the own lease."""
        return self.own.by_own_lease and self.talk.rests(self.own.now, now_ns)

    def ask(self, lease: Lease, now_ns: int) -> None:
        self.talk.ask(lease, now_ns)

    def waited_ns(self, now_ns: int) -> int:
        return now_ns - self._served_ns

    def began(self, now_ns: int) -> None:
        """A sweep begins with this step."""
        self.talk.begin(self.own.now, now_ns)
        self.swept = True
        self.assumed, self.burned = lit_by(self.talk.party), self.talk.burned(self.own.now)

    def ended(self, now_ns: int) -> None:
        """Its last frame is in."""
        self.judging = True
        self.talk.end(now_ns)

    def verdict(self, now_ns: int) -> Spoiled | bool | None:
        """What became of the sweep that ended: True, it counts; None: not known yet. The lease ends with it."""
        if (found := self.talk.verdict(self.own.now, now_ns)) is None:
            return None
        self.judging = False
        if isinstance(found, Spoiled):
            self.spoiled += 1
        else:
            self._fruitless = 0
        return found

    def over(self, now_ns: int) -> None:
        """The own lease is at its end."""
        if self.talk.party.mine is not None:
            self._served_ns = now_ns
            self._retry_ns = max(self._retry_ns, now_ns + RETRY_NS)  # others were waiting, and shall be heard first
        self.talk.release()
        self.swept = False

    def fail(self, now_ns: int) -> None:
        """The own lease showed nothing: the next one has more time to come, for others are waiting."""
        self._fruitless += 1
        self.over(now_ns)
        self._retry_ns = now_ns + min(AGAIN_NS << min(self._fruitless, 9), LONGEST_AGAIN_NS)
