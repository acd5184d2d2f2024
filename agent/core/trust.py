"""Which messages count, and as whose: message-source authorisation, epochs, and the clocks of other robots.

With keys: evidence and keyframes of a robot count from any sender as long as its signature is right. Verifying costs a
tenth of a millisecond, so each neighbour has a budget of it; a wrong signature empties the budget of the robot that
passed it on, for honest robots verify before they pass on.

Without keys: while a robot is heard directly, only its own messages count about it. About robots that are out of reach
a relay is believed: nothing is known against it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Generic, NamedTuple, Protocol, TypeVar

import msgpack
import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from agent.core.capability_messages import Frame
from agent.core.codec import Refusal
from agent.core.messages import Entry, Epoch, Proposal, Sample
from agent.core.step_transaction import Revertible

# --- signatures ---
# What an origin signs, and whether a signature is its own. Ed25519 (RFC 8032): verifying needs no clock and no random
# number.
#
# A relay may carry an entry, a sample or a keyframe anywhere; it cannot change one, nor make one up. All that gives the
# evidence its meaning is signed: fleet, target and epoch too, so that nothing old or foreign can be shown again
# elsewhere.

KEY_BYTES = 32  # of a public key
SIGNATURE_BYTES = 64


def entry_bytes(fleet: str, target: str, epoch: Epoch, entry: Entry) -> bytes:
    """What the origin of an entry signs."""
    when = [epoch.counter, epoch.moving, epoch.proposer]
    sums = [_floats(entry.information), _floats(entry.vector), _floats(entry.systematic_m2)]
    who = [entry.origin, entry.incarnation, entry.count]
    return bytes(msgpack.packb(["aucamp.entry.1", fleet, target, when, *who, *sums]))


def sample_bytes(fleet: str, target: str, epoch: Epoch, sample: Sample) -> bytes:
    """What the origin of a sample signs; its age is the relays' business, and no part of it."""
    when = [epoch.counter, epoch.moving, epoch.proposer]
    who = [sample.origin, sample.incarnation, sample.number, sample.t_ns]
    what = [_floats(sample.information), _floats(sample.vector)]
    return bytes(msgpack.packb(["aucamp.sample.1", fleet, target, when, *who, *what]))


def proposal_bytes(fleet: str, target: str, proposal: Proposal) -> bytes:
    """What the proposer of an epoch signs."""
    what = [proposal.proposer, proposal.since_ns, proposal.counter, proposal.moving]
    return bytes(msgpack.packb(["aucamp.epoch.1", fleet, target, *what]))


def keyframe_bytes(fleet: str, frame: Frame) -> bytes:
    """What the origin of a keyframe signs."""
    return bytes(msgpack.packb(["aucamp.keyframe.1", fleet, msgspec.to_builtins(frame, builtin_types=(bytes,))]))


def _floats(numbers: Iterable[float]) -> list[float]:
    """Numbers as they come out of a message: a 0 that was written as an integer has arrived as 0.0."""
    return list(map(float, numbers))


def verify_signature(public: bytes, signature: bytes, signed: bytes) -> bool:
    """Whether this signature was made with the private half of `public`, KEY_BYTES long."""
    if len(signature) != SIGNATURE_BYTES or len(public) != KEY_BYTES:
        return False
    try:
        Ed25519PublicKey.from_public_bytes(public).verify(signature, signed)
    except (InvalidSignature, ValueError):
        return False
    return True


# --- message-source authorisation ---

DIRECT_NS = 3_000_000_000  # a robot heard directly this lately speaks for itself
VERIFIED_HZ = 20.0  # signatures of each neighbour, at most; a swarm of ten needs ten a second of all together
BURST = 20.0

Verify = Callable[[bytes, bytes, bytes], bool]  # public key, signature, what was signed
OVERDRAWN = "not yet verified"  # it comes again: a neighbour sends again what we do not show that we hold
HEARSAY = "hearsay"  # no fault of the relay: it cannot know which robots we hear ourselves


class Authority(Revertible):
    """One robot's judgement of message sources, for one target, or for keyframes."""

    def __init__(self, neighbours: tuple[str, ...], verify: Verify = verify_signature) -> None:
        self._verify = verify
        self.keys: Mapping[str, bytes] | None = None  # public, by robot; None: a fleet without keys
        self._heard_ns: dict[str, int] = {}  # directly
        self._budget: dict[str, tuple[float, int]] = {name: (BURST, 0) for name in neighbours}  # at a time

    def replace_keys(self, keys: Mapping[str, bytes]) -> Mapping[str, bytes] | None:
        """Take over public keys; returns those of before."""
        before, self.keys = self.keys, dict(keys)
        return before

    def heard(self, src: str, now_ns: int) -> None:
        """A message of this neighbour came."""
        self._heard_ns[src] = now_ns
        budget, at_ns = self._budget[src]
        self._budget[src] = min(BURST, budget + VERIFIED_HZ * max(0, now_ns - at_ns) * 1e-9), now_ns

    def speaks_for_itself(self, origin: str, now_ns: int) -> bool:
        """Whether a robot was heard directly of late."""
        heard_ns = self._heard_ns.get(origin)
        return heard_ns is not None and now_ns - heard_ns <= DIRECT_NS

    def fault(self, src: str, origin: str, signature: bytes, says: Callable[[], bytes], now_ns: int) -> str | None:
        """Why what `src` passes on as the word of `origin` does not count, as a kind to count by; None: it counts.

        says: what the origin signed, made only if it is looked at.
        """
        if self.keys is None:
            return HEARSAY if src != origin and self.speaks_for_itself(origin, now_ns) else None
        key = self.keys.get(origin)
        if key is None:
            return "no key"
        if not signature:
            return "unsigned"
        budget, at_ns = self._budget[src]
        if budget < 1.0:
            return OVERDRAWN
        self._budget[src] = budget - 1.0, at_ns
        if self._verify(key, signature, says()):
            return None
        self._budget[src] = 0.0, at_ns
        return "bad signature"


# --- vote on epochs ---
# A new epoch needs two robots: one that was knocked, or lies, must not empty the tables of all.
#
# A robot whose own samples say that the target started or stopped moving proposes the next epoch. It begins when two
# have proposed it, or where two neighbours are in it already: one of two is honest. Where fewer than three robots see
# the target no robot could second, and one proposal is enough, but not more often than every ten seconds. A robot that
# has just started joins the epoch of those that it hears, as soon as it has had the time to hear them all.
#
# Epochs at rest have even counters, those in motion odd ones; every robot names the same epoch by the same counter.

ALARM_NS = 20_000_000_000  # a proposal that no robot seconds for so long was a knock
WITNESSES = 2  # one more than may lie
LEAST_NS = 10_000_000_000  # an epoch lasts so long before a single proposal ends it
BESIDE_NS = 3_000_000_000  # how long a neighbour counts as being in the epoch that it spoke of; all speak within it
JUMP = 1000  # epochs that a swarm may be ahead of a robot that has just started
LAST = 10**8  # no honest swarm gets there


def epoch_of(counter: int) -> Epoch:
    """The epoch with this number."""
    return Epoch(counter, counter % 2 == 1)


class EpochVote(Revertible):
    """Which robot proposes which epoch, as one robot knows it."""

    def __init__(self, me: str) -> None:
        self._me = me
        self._woke_ns: int | None = None  # since when we listen
        self._proposals: dict[str, tuple[Proposal, int]] = {}  # of each robot its newest, and when we first heard it
        self._witnesses: tuple[Proposal, ...] = ()  # for the epoch that we are in
        self._beside: dict[str, tuple[int, int]] = {}  # neighbour -> counter of its epoch, and when it said so
        self._began_ns: int | None = None  # the epoch that we are in; none: we just started, and met no robot in it

    def is_news(self, proposal: Proposal, epoch: Epoch) -> bool:
        """Whether a proposal could matter and was not heard before."""
        if proposal.moving != epoch_of(proposal.counter).moving or not epoch.counter < proposal.counter <= LAST:
            return False
        old = self._proposals.get(proposal.proposer)
        return old is None or (proposal.counter, proposal.since_ns) > (old[0].counter, old[0].since_ns)

    def hear(self, proposal: Proposal, now_ns: int) -> None:
        """Take note of a proposal that is news and is believed."""
        self._proposals[proposal.proposer] = (proposal, now_ns)

    def neighbour(self, src: str, epoch: Epoch, now_ns: int) -> None:
        """Take note of the epoch that a neighbour is in."""
        self._beside[src] = (epoch.counter, now_ns)

    def propose(self, epoch: Epoch, now_ns: int) -> None:
        """Our own samples say that this epoch is over."""
        if not self._mine(epoch.counter + 1):
            self._proposals[self._me] = (Proposal(self._me, now_ns, epoch.counter + 1, not epoch.moving), now_ns)

    def unseconded(self, epoch: Epoch, now_ns: int) -> bool:
        """Whether no robot seconded a proposal of ours; the proposal is taken back with this answer."""
        mine = self._mine(epoch.counter + 1)
        if mine is None or now_ns - mine[1] <= ALARM_NS:
            return False
        del self._proposals[self._me]
        return True

    def next(self, epoch: Epoch, seeing: int, now_ns: int) -> Epoch | None:
        """The epoch to begin now; None: the present one goes on. seeing: robots known to see the target."""
        self._woke_ns = now_ns if self._woke_ns is None else self._woke_ns
        fresh = [p for p, heard_ns in self._proposals.values() if now_ns - heard_ns <= ALARM_NS]
        beside = [counter for counter, at_ns in self._beside.values() if now_ns - at_ns <= BESIDE_NS]
        if self._began_ns is None and epoch.counter in beside:
            self._began_ns = now_ns
        joins = self._began_ns is None and now_ns - self._woke_ns >= BESIDE_NS
        for counter in sorted({p.counter for p in fresh} | set(beside), reverse=True):
            if counter <= epoch.counter or counter > LAST:
                continue
            proposals = sum(p.counter == counter for p in fresh)
            there = sum(c >= counter for c in beside)
            if proposals >= WITNESSES or there >= WITNESSES:
                return epoch_of(counter)
            if joins and 0 < there == len(beside) and counter <= JUMP:
                return epoch_of(counter)
            if proposals and 0 < seeing <= WITNESSES and self._may_end_alone(epoch, counter, now_ns):
                return epoch_of(counter)
        return None

    def begin(self, epoch: Epoch, now_ns: int) -> None:
        """We are in this epoch from now on."""
        self._witnesses = tuple(p for p, _ in self._proposals.values() if p.counter == epoch.counter)[:WITNESSES]
        self._proposals = {n: held for n, held in self._proposals.items() if held[0].counter > epoch.counter}
        self._began_ns = now_ns

    def shown(self, now_ns: int) -> tuple[Proposal, ...]:
        """What to tell a neighbour: the proposals that began our epoch, and fresh ones for another."""
        fresh = (p for _, (p, heard_ns) in sorted(self._proposals.items()) if now_ns - heard_ns <= ALARM_NS)
        return (*self._witnesses, *fresh)

    def _mine(self, counter: int) -> tuple[Proposal, int] | None:
        held = self._proposals.get(self._me)
        return held if held is not None and held[0].counter == counter else None

    def _may_end_alone(self, epoch: Epoch, counter: int, now_ns: int) -> bool:
        """Whether one proposal is enough now: the proposals of a single robot lead on by one epoch in ten seconds."""
        if self._began_ns is None:
            return counter == epoch.counter + 1
        elapsed_ns = now_ns - self._began_ns
        return elapsed_ns >= LEAST_NS and counter <= epoch.counter + 1 + elapsed_ns // LEAST_NS


# --- time in transit ---
# How long messages of one neighbour are on their way, beyond the quickest of them: clocks that differ cancel.

CLOCKS_NS = 3 * 3600 * 10**9  # by which the clocks of two robots may differ: nothing sets them to a common time
WINDOW_NS = 60_000_000_000  # over which the quickest message is remembered
BIN_NS = 1_000_000_000  # resolution of that memory: 60 numbers a neighbour
STEP_NS = 200_000_000  # a message that was quicker by more than this tells of another clock, or lies
LOST_NS = 60_000_000_000  # so does one that was slower by more than this: links give up long before
INSISTS = 3  # such messages in a row, after which it is another clock
STEADY_NS = 50_000_000  # queues do not hold all messages up alike: where all are late by the same, to within this, ...
STEADY_FOR_NS = 3_000_000_000  # ... for so long, the clock of the sender was wrong before


class Late(NamedTuple):
    """Messages in a row that were late, since the first of them."""

    since_ns: int
    least_ns: int  # transit
    most_ns: int


class Transit(Revertible):
    """The quickest messages of one neighbour since its start."""

    def __init__(self) -> None:
        self._bins: dict[int, int] = {}  # the quickest of each second
        self._stepped = 0  # messages in a row that were too quick, or too slow to be true
        self._late: Late | None = None

    def late_ns(self, transit_ns: int, arrived_ns: int) -> int:
        """How long a message was queued; transit_ns: its arrival on our clock less its stamp on the sender's."""
        late_ns = transit_ns - min(self._bins.values(), default=transit_ns)
        self._stepped = self._stepped + 1 if not -STEP_NS <= late_ns <= LOST_NS else 0
        if 0 < self._stepped < INSISTS:
            return max(0, late_ns)
        if self._stepped or (late_ns > STEP_NS and self._steady(transit_ns, arrived_ns)):
            self._bins, self._stepped = {}, 0
        if late_ns <= STEP_NS:
            self._late = None
        now_bin = arrived_ns // BIN_NS
        self._bins[now_bin] = min(transit_ns, self._bins.get(now_bin, transit_ns))
        for old in [b for b in self._bins if b < now_bin - WINDOW_NS // BIN_NS]:
            del self._bins[old]
        return transit_ns - min(self._bins.values())

    def _steady(self, transit_ns: int, arrived_ns: int) -> bool:
        """Whether all messages have long been late by the same."""
        since_ns, least_ns, most_ns = self._late or Late(arrived_ns, transit_ns, transit_ns)
        least_ns, most_ns = min(least_ns, transit_ns), max(most_ns, transit_ns)
        if most_ns - least_ns > STEADY_NS:
            since_ns, least_ns, most_ns = arrived_ns, transit_ns, transit_ns
        self._late = Late(since_ns, least_ns, most_ns)
        return arrived_ns - since_ns >= STEADY_FOR_NS


# --- latest-message cache ---
# The newest message of each neighbour, and how far it can be trusted to be fresh.
#
# Clocks of different robots need not agree. The smallest (arrival - sent) of the last minute stands for the constant
# part of that difference; what a message took beyond it is time it spent queued, and counts as age.
#
# Numbers and stamps may run ahead by what clocks and rates allow, and no more. What is beyond is refused and not
# remembered, so that one wrong number does not silence a neighbour; a sender that repeats it is believed after INSISTS
# messages, as in `Transit`.

SAID_HZ = 100  # messages of a neighbour on one key, at most: five times what a fleet file can ask for
AHEAD_S = 10  # of such messages that may be missing at any time
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


class CachedMessage(NamedTuple, Generic[M]):
    """A believed message with its time of arrival on this robot's clock."""

    message: M
    arrived_ns: int
    late_ns: int  # queued on the way, beyond the quickest message of the last minute


class Sender(NamedTuple, Generic[M]):
    """What is kept of one neighbour."""

    heard: int = 0
    gaps: int = 0
    newest: CachedMessage[M] | None = None
    before: tuple[int, int] | None = None  # the incarnation before, and when it was last heard
    fallen: tuple[int, int] = (0, 0)  # messages in a row that went back, and the number of the last of them
    doubled_ns: int | None = None  # when two incarnations last took turns


class MessageCache(Revertible, Generic[M]):
    """The newest message of each neighbour; refuses what cannot be its next one."""

    def __init__(self, fleet: str, me: str, neighbours: tuple[str, ...]) -> None:
        self._fleet, self._me = fleet, me
        self.senders: dict[str, Sender[M]] = {name: Sender() for name in sorted(neighbours)}
        self._transit: dict[str, Transit] = {name: Transit() for name in self.senders}

    def put(self, src: str, message: M, arrived_ns: int) -> CachedMessage[M]:
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
        letter = CachedMessage(message, arrived_ns, late_ns)
        self.senders[src] = sender._replace(heard=sender.heard + 1, newest=letter, fallen=(0, 0))
        return letter

    def age_ns(self, src: str, now_ns: int) -> int | None:
        """How old the newest message of a neighbour is; None where none came."""
        letter = self.senders[src].newest
        return None if letter is None else now_ns - letter.arrived_ns + letter.late_ns

    def doubled(self, now_ns: int) -> tuple[str, ...]:
        """Names that two robots use at once."""
        times = {name: sender.doubled_ns for name, sender in self.senders.items()}
        return tuple(name for name, at_ns in times.items() if at_ns is not None and now_ns - at_ns <= TWIN_NS)

    def _addressed(self, message: M) -> bool:
        """Whether it is meant for us."""
        return (message.fleet, message.dst) == (self._fleet, self._me)

    def _numbered(self, src: str, message: M, arrived_ns: int) -> Sender[M]:
        """What is kept of the neighbour after this number of a message. Raises Refusal where it cannot be the next."""
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
    """The neighbour with a new incarnation; a return to the incarnation before shows two robots of one name."""
    newest, before = sender.newest, sender.before
    returned = before is not None and before[0] == incarnation and now_ns - before[1] <= TWIN_NS
    return sender._replace(
        before=None if newest is None else (newest.message.incarnation, newest.arrived_ns),
        doubled_ns=now_ns if returned else sender.doubled_ns,
    )


# --- clocks of origins ---
# When a sample was taken, on our clock: what its origin's clock said then, plus how far that clock is from ours.
#
# Each copy of a sample tells an offset of its own: its time of arrival less its age less its origin's stamp. Delays
# that are unaccounted for make it too large, a relay that lies may make it anything. So the first copy that comes from
# the origin itself decides, else the first relay; from then on the offset moves no faster than clocks drift.

DRIFT = 1e-3  # the offset falls no faster than this, as shorter delays are found; no quartz is as bad
RISE = 1e-4  # it rises so fast where all delays seem to have become longer: the worst drift of two quartzes


class Offset(NamedTuple):
    """Our clock minus the origin's."""

    offset_ns: int
    at_ns: int
    direct: bool  # by a message of the origin itself


class OriginClocks(Revertible):
    """What one robot knows of the clocks of all origins."""

    def __init__(self) -> None:
        self._offsets: dict[str, Offset] = {}

    def offset_ns(self, origin: str, said_ns: int, direct: bool, now_ns: int) -> int:
        """The offset to count with, after a copy that says `said_ns` came."""
        old = self._offsets.get(origin)
        if old is None or (direct and not old.direct):
            new = Offset(said_ns, now_ns, direct)
        else:
            elapsed_ns = max(0, now_ns - old.at_ns)
            highest = old.offset_ns + round(RISE * elapsed_ns)
            lowest = old.offset_ns - round(DRIFT * elapsed_ns)
            new = Offset(max(lowest, min(highest, said_ns)), now_ns, old.direct)
        self._offsets[origin] = new
        return new.offset_ns
