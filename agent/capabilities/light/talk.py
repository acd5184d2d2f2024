"""One robot's part in who has the light, between steps: words in and out, the lease, and the proof for its sweeps."""

from __future__ import annotations

from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.light.lease import Party, ack_to, acquainted, ask, hear, release, said_lease, tick
from agent.capabilities.light.proof import Baseline, Spoiled, baseline, verdict
from agent.core.capability_messages import LampNow, Lease, Light, Why, light_fault
from agent.core.codec import Refusal
from agent.core.config import Fleet
from agent.core.step_transaction import Revertible
from agent.core.topics import LIGHT, next_due_ns
from agent.core.trust import Letters

SLOW_NS = round(1e9 / LIGHT.hz)
JUDGE_NS = 1_500_000_000  # after a sweep: by then all have been heard, or it does not count


class Talk(Revertible):
    """Of one robot of a fleet with [lighting]."""

    def __init__(self, fleet: Fleet, name: str, incarnation: int) -> None:
        assert fleet.lighting is not None
        self._fleet, self._tank_m, self._guard_ns = fleet.fleet, fleet.tank.size_m, round(fleet.lighting.guard_s * 1e9)
        self.party = Party(name, incarnation, tuple(sorted(fleet.robot[name].neighbours)))
        self.letters = Letters[Light](fleet.fleet, name, fleet.robot[name].neighbours)
        self._seq = 0
        self._due_ns = 0
        self._before: Baseline | None = None  # of the sweep that runs, or is judged
        self._after: tuple[int, int] | None = None  # of one that is judged: the word after it, and since when

    def hear(self, src: str, said: Light, arrived_ns: int) -> None:
        """A decoded message that came on the key of `src`. Raises Refusal where it cannot be so."""
        if (fault := light_fault(said, self._tank_m)) is not None:
            raise Refusal("content", fault)
        letter = self.letters.put(src, said, arrived_ns)
        self.party = hear(self.party, said, arrived_ns - letter.late_ns)

    def tick(self, now_ns: int) -> None:
        if not self.party.since_ns:
            self.party = self.party._replace(since_ns=now_ns)
        self.party = tick(self.party, self._guard_ns, now_ns)

    def acquainted(self, now_ns: int) -> bool:
        """Whether it knows of all neighbours by now who is there."""
        return acquainted(self.party, now_ns)

    def ask(self, lease: Lease, now_ns: int) -> None:
        """Ask for light; only who is free can."""
        self.party = ask(self.party, lease, now_ns)

    def release(self) -> None:
        """The own lease is over, and a sweep by it; neighbours are told at once."""
        self.party, self._before, self._after = release(self.party), None, None
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
        if not self.letters.senders or (at_leisure and now_ns < self._due_ns):
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
        return tuple(self._to(said, neighbour, dark) for neighbour in self.letters.senders)

    def _to(self, said: Light, neighbour: str, dark: Why) -> Light:
        word = self.party.word(neighbour)
        heard = None if word is None else (word.said.incarnation, word.said.seq)
        ack = ack_to(self.party, neighbour, dark)
        return replace(said, dst=neighbour, heard=heard, ack=UNSET if ack is None else ack)
