"""Which messages count, and as whose: message-source authorisation, epochs, and the newest message of each neighbour.

With keys: evidence and keyframes of a robot count from any sender as long as its signature is right. Verifying costs a
tenth of a millisecond, so each neighbour has a budget of it; a wrong signature empties the budget of the robot that
passed it on, for honest robots verify before they pass on.

Without keys: while a robot is heard directly, only its own messages count about it. About robots that are out of reach
a relay is believed: nothing is known against it.

A message counts of a robot whose fleet file has the same digest, `common`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import msgpack
import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from agent.core.capability_messages import Frame
from agent.core.codec import Refusal
from agent.core.config import CAREFUL, Fleet, Landmarks, Target
from agent.core.link_clocks import CLOCKS_NS, INSISTS, LinkClock, Transit, Way
from agent.core.messages import Entry, Epoch, Proposal, Sample, Vector
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
    sums = [_floats(of) for of in (entry.information, entry.vector, entry.systematic_m2, entry.lever_m)]
    who = [entry.origin, entry.incarnation, entry.count]
    return bytes(msgpack.packb(["aucamp.entry.2", fleet, target, when, *who, *sums]))


def sample_bytes(fleet: str, target: str, epoch: Epoch, sample: Sample) -> bytes:
    """What the origin of a sample signs; its age is the relays' business, and no part of it."""
    when = [epoch.counter, epoch.moving, epoch.proposer]
    who = [sample.origin, sample.incarnation, sample.number, sample.t_ns]
    what = [_floats(sample.information), _floats(sample.vector)]
    return bytes(msgpack.packb(["aucamp.sample.1", fleet, target, when, *who, *what]))


def proposal_bytes(fleet: str, target: str, proposal: Proposal) -> bytes:
    """What the proposer of an epoch signs."""
    step_m = None if proposal.step_m is None else _floats(proposal.step_m)
    what = [proposal.proposer, proposal.since_ns, proposal.counter, proposal.moving, step_m, proposal.against]
    return bytes(msgpack.packb(["aucamp.epoch.2", fleet, target, *what]))


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
# A robot whose own samples say that the target started or stopped moving proposes the next epoch, and says by how far
# the target moved. The others look again, and propose as well or speak against it. The epoch begins when two have
# proposed it, or where two neighbours are in it already: one of two is honest. Where two speak against it the proposer
# was knocked. Where no other robot has measured the target since, none could second, and one proposal is enough, but
# not more often than every ten seconds. A robot that has just started joins the epoch of those that it hears, as soon
# as it has had the time to hear them all.
#
# Epochs at rest have even counters, those in motion odd ones; every robot names the same epoch by the same counter.

SEEN_NS = 20_000_000_000  # a robot that measured this lately sees the target
ALARM_NS = 20_000_000_000  # a proposal that no robot seconds for so long was a knock
WITNESSES = 2  # one more than may lie
ALONE_NS = 3_000_000_000  # so long the others have had the time to look
LEAST_NS = 10_000_000_000  # an epoch lasts so long before a single proposal ends it
BESIDE_NS = 3_000_000_000  # how long a neighbour counts as being in the epoch that it spoke of; all speak within it
QUIET_NS, QUIETEST = 20_000_000_000, 6  # a robot proposes no more for so long after it was refuted, doubled so often
JUMP = 1000  # epochs that a swarm may be ahead of a robot that has just started
LAST = 10**8  # no honest swarm gets there


def epoch_of(counter: int) -> Epoch:
    """The epoch with this number."""
    return Epoch(counter, counter % 2 == 1)


class Told(NamedTuple):
    """A proposal, and when this robot first heard it."""

    proposal: Proposal
    heard_ns: int


class EpochVote(Revertible):
    """Which robot proposes which epoch, as one robot knows it."""

    def __init__(self, me: str) -> None:
        self._me = me
        self._woke_ns: int | None = None  # since when we listen
        self._proposals: dict[str, Told] = {}  # of each robot its newest
        self.witnesses: tuple[Proposal, ...] = ()  # those that began the epoch that we are in
        self._beside: dict[str, tuple[int, int]] = {}  # neighbour -> counter of its epoch, and when it said so
        self._began_ns: int | None = None  # the epoch that we are in; none: we just started, and met no robot in it
        self._refuted, self._quiet_until_ns = 0, 0  # own proposals in a row, and until when we make no other

    def is_news(self, proposal: Proposal, epoch: Epoch) -> bool:
        """Whether a proposal could matter and was not heard before."""
        if proposal.moving != epoch_of(proposal.counter).moving or not epoch.counter < proposal.counter <= LAST:
            return False
        old = self._proposals.get(proposal.proposer)
        new = proposal.counter, proposal.since_ns
        return old is None or new > (old.proposal.counter, old.proposal.since_ns)

    def hear(self, proposal: Proposal, now_ns: int) -> None:
        """Take note of a proposal that is news and is believed."""
        self._proposals[proposal.proposer] = Told(proposal, now_ns)

    def neighbour(self, src: str, epoch: Epoch, now_ns: int) -> None:
        """Take note of the epoch that a neighbour is in."""
        self._beside[src] = (epoch.counter, now_ns)

    def propose(self, epoch: Epoch, now_ns: int, step_m: Vector | None = None, against: bool = False) -> None:
        """Our own samples say that this epoch is over; or, against another robot's word, that it is not."""
        mine = self._mine(epoch.counter + 1)
        repeats = mine is not None and mine.proposal.against == against
        if not repeats and (against or now_ns >= self._quiet_until_ns):
            said = Proposal(self._me, now_ns, epoch.counter + 1, not epoch.moving, step_m=step_m, against=against)
            self._proposals[self._me] = Told(said, now_ns)

    def pending(self, epoch: Epoch, now_ns: int) -> Told | None:
        """The first word that the target moved which is neither seconded nor refuted yet."""
        told = [each for each in self._fresh(now_ns) if each.proposal.counter == epoch.counter + 1]
        if sum(each.proposal.against for each in told) >= WITNESSES:
            return None
        words = [each for each in told if each.proposal.step_m is not None and not each.proposal.against]
        return min(words, key=lambda each: each.heard_ns, default=None)

    def unseconded(self, epoch: Epoch, now_ns: int) -> bool:
        """Whether no robot seconded a proposal of ours, or two refuted it; it is taken back with this answer."""
        mine = self._mine(epoch.counter + 1)
        if mine is None or mine.proposal.against:
            return False
        against = [
            each for each in self._fresh(now_ns) if each.proposal.against and each.proposal.counter > epoch.counter
        ]
        if now_ns - mine.heard_ns <= ALARM_NS and len(against) < WITNESSES:
            return False
        del self._proposals[self._me]
        self._quiet_until_ns = now_ns + (QUIET_NS << self._refuted)
        self._refuted = min(self._refuted + 1, QUIETEST)
        return True

    def next(self, epoch: Epoch, measured_ns: Mapping[str, int], now_ns: int) -> Epoch | None:
        """The epoch to begin now; None: the present one goes on. measured_ns: when each robot last saw the target."""
        self._woke_ns = now_ns if self._woke_ns is None else self._woke_ns
        fresh = [each for each in self._fresh(now_ns) if not each.proposal.against]
        beside = [counter for counter, at_ns in self._beside.values() if now_ns - at_ns <= BESIDE_NS]
        if self._began_ns is None and epoch.counter in beside:
            self._began_ns = now_ns
        joins = self._began_ns is None and now_ns - self._woke_ns >= BESIDE_NS
        for counter in sorted({each.proposal.counter for each in fresh} | set(beside), reverse=True):
            if counter <= epoch.counter or counter > LAST:
                continue
            proposals = [each for each in fresh if each.proposal.counter == counter]
            there = sum(c >= counter for c in beside)
            if len(proposals) >= WITNESSES or there >= WITNESSES:
                return epoch_of(counter)
            if joins and 0 < there == len(beside) and counter <= JUMP:
                return epoch_of(counter)
            alone = bool(proposals) and _alone(proposals[0], measured_ns, now_ns)
            if alone and self._may_end_alone(epoch, counter, now_ns):
                return epoch_of(counter)
        return None

    def begin(self, epoch: Epoch, now_ns: int) -> None:
        """We are in this epoch from now on."""
        told = [each.proposal for each in self._proposals.values() if not each.proposal.against]
        self.witnesses = tuple(each for each in told if each.counter == epoch.counter)[:WITNESSES]
        self._proposals = {n: each for n, each in self._proposals.items() if each.proposal.counter > epoch.counter}
        self._began_ns, self._refuted = now_ns, 0

    def shown(self, now_ns: int) -> tuple[Proposal, ...]:
        """What to tell a neighbour: the proposals that began our epoch, and fresh ones for another."""
        return (*self.witnesses, *(each.proposal for each in self._fresh(now_ns)))

    def _fresh(self, now_ns: int) -> list[Told]:
        """In the order of the robots' names."""
        return [each for _, each in sorted(self._proposals.items()) if now_ns - each.heard_ns <= ALARM_NS]

    def _mine(self, counter: int) -> Told | None:
        told = self._proposals.get(self._me)
        return told if told is not None and told.proposal.counter == counter else None

    def _may_end_alone(self, epoch: Epoch, counter: int, now_ns: int) -> bool:
        """Whether one proposal is enough now: the proposals of a single robot lead on by one epoch in ten seconds."""
        if self._began_ns is None:
            return counter == epoch.counter + 1
        elapsed_ns = now_ns - self._began_ns
        return elapsed_ns >= LEAST_NS and counter <= epoch.counter + 1 + elapsed_ns // LEAST_NS


def _alone(told: Told, measured_ns: Mapping[str, int], now_ns: int) -> bool:
    """Whether no robot can second a proposal: fewer than three see the target, or, of one that moved, no other robot
    has measured it since it was told."""
    if told.proposal.step_m is None:
        return 0 < sum(now_ns - at_ns <= SEEN_NS for at_ns in measured_ns.values()) <= WITNESSES
    others = (at_ns for name, at_ns in measured_ns.items() if name != told.proposal.proposer)
    return now_ns - told.heard_ns >= ALONE_NS and all(at_ns <= told.heard_ns for at_ns in others)


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
    way: Way | None = None  # how long it took in all; None: no stamp of ours was echoed yet


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
        self._clocks: dict[str, LinkClock] = {name: LinkClock() for name in self.senders}

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
        transit_ns = arrived_ns - message.sent_ns
        late_ns, clock = self._transit[src].late_ns(transit_ns, arrived_ns), self._clocks[src]
        clock.hear(self._echo_of(message), transit_ns, arrived_ns)
        letter = CachedMessage(message, arrived_ns, late_ns, self._way(message, clock.way(transit_ns), late_ns))
        self.senders[src] = sender._replace(heard=sender.heard + 1, newest=letter, fallen=(0, 0))
        return letter

    def echo(self, src: str, now_ns: int) -> tuple[int, int] | None:
        """For a message to this neighbour: its newest stamp that was heard, and how long ago; None: it never spoke."""
        letter = self.senders[src].newest
        return None if letter is None else (letter.message.sent_ns, max(0, now_ns - letter.arrived_ns))

    def age_ns(self, src: str, now_ns: int) -> int | None:
        """How old the newest message of a neighbour is; None where none came."""
        letter = self.senders[src].newest
        return None if letter is None else now_ns - letter.arrived_ns + letter.late_ns

    def doubled(self, now_ns: int) -> tuple[str, ...]:
        """Names that two robots use at once."""
        times = {name: sender.doubled_ns for name, sender in self.senders.items()}
        return tuple(name for name, at_ns in times.items() if at_ns is not None and now_ns - at_ns <= TWIN_NS)

    def _echo_of(self, message: M) -> tuple[int, int] | None:
        """What a message echoes, of the kinds that do."""
        return None

    def _way(self, message: M, known: Way | None, late_ns: int) -> Way | None:
        """How long a message took; known: by the clock of the link."""
        return known

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
            self._transit[src], self._clocks[src] = Transit(), LinkClock()
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


# --- fleet digest ---
# What all fleet files of a fleet have to share, in sixteen characters that travel with every message. Robots whose
# files differ here would add up what does not belong together, or wait for each other in vain. What a robot has for
# itself is left out: its place, depth, look, devices, camera and body, where its files lie, how often it speaks.


def common(fleet: Fleet) -> str:
    """Digest of what the robots of a fleet have to agree on: 16 hexadecimal digits of SHA-256.

    The order of tables, of robots, of neighbours and of landmarks does not count, nor does 1 for 1.0.
    """
    shared = {
        "fleet": fleet.fleet,
        "tank": msgspec.to_builtins(fleet.tank),
        "refractive_index": fleet.water.refractive_index,  # how murky the water is, only the twin uses
        "estimation": msgspec.to_builtins(fleet.estimation),
        "target": {name: _target(target) for name, target in fleet.target.items()},
        "robot": {name: sorted(set(robot.neighbours)) for name, robot in fleet.robot.items()},
    }
    if fleet.budget != CAREFUL:
        shared["budget"] = msgspec.to_builtins(fleet.budget)
    if fleet.landmarks is not None:
        shared["landmarks"] = _landmarks(fleet.landmarks)
    if fleet.coverage is not None:
        shared["coverage"] = msgspec.to_builtins(fleet.coverage)  # maps of other cells never come out equal
    if fleet.lighting is not None:  # which robots have a lamp, and when it is lent
        shared["lighting"] = msgspec.to_builtins(fleet.lighting)
        shared["lamp"] = sorted(name for name, robot in fleet.robot.items() if robot.lamp)
    if fleet.extend is not None:  # only the capabilities know which of it robots have to agree on
        shared["extend"] = fleet.extend
    text = msgspec.json.encode(_plain(shared), order="sorted")
    return hashlib.sha256(text).hexdigest()[:16]


def _target(target: Target) -> dict[str, Any]:
    """What the target is. Pictures, the boxes in them and models are files, and each robot may have its own."""
    swims = {} if target.speed_m_s is None else {"speed_m_s": target.speed_m_s, "turn_s": target.turn_s}
    if target.detector == "box":
        return {"detector": target.detector, **swims}
    size: dict[str, Any] = {"length_m": target.length_m}
    if target.detector == "ball":
        size = {"radius_m": target.radius_m, "radius_sigma_m": target.radius_sigma_m}
    return {"detector": target.detector, "colour": "sampled" if target.picture else target.ball_colour, **size, **swims}


def _landmarks(landmarks: Landmarks) -> dict[str, Any]:
    """One map for all: places that robots computed from different maps do not belong together."""
    return {**msgspec.to_builtins(landmarks), "tag": msgspec.to_builtins(sorted(landmarks.tag, key=lambda tag: tag.id))}


def _plain(value: Any) -> Any:
    """The same with every number as a float: a Fleet that is made in Python may have 1 for 1.0."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value
