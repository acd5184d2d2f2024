"""What the doctor sees of a running fleet in three seconds: links, tokens, states, what robots say of their own links,
and how far their clocks are off.

Nothing is judged here.
"""

from __future__ import annotations

import threading
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from agent.clock import machine
from agent.core import topics
from agent.core.codec import Refusal, decode, encode
from agent.core.config import Fleet
from agent.core.messages import Answer, Order, State
from agent.core.robot_view import in_own_name
from agent.core.topics import STATE
from agent.ground.check_files import Finding
from agent.process.launch import addresses_of
from router_config.session import Link, Reply, Sample, Session, unusable

# --- offsets of clocks ---
# How far away robots are, and how far their clocks are from ours. Pure, but for asking.

ASKED = 5  # times; the fastest answer is the truest
APART_S = 0.1  # clocks that are further apart are told of, where both ways were measured
ONE_WAY_S = 1.0  # and where only one was: a state is that late on no link of ours


class Stamps(NamedTuple):
    """Of a question and its answer, ns: the outer two by our clock, the inner two by the robot's."""

    asked_ns: int
    arrived_ns: int
    answered_ns: int
    back_ns: int


class Offset(NamedTuple):
    """What stamps come to."""

    way_s: float  # there and back, without the wait at the robot
    ahead_s: float  # the robot's clock minus ours; wrong by half of `way_s` at most


def best(stamps: Sequence[Stamps]) -> Offset:
    """As NTP reckons (RFC 5905, section 8), of the answer with the shortest way."""
    way_ns, ahead_ns = min(
        (
            (s.back_ns - s.asked_ns) - (s.answered_ns - s.arrived_ns),
            ((s.arrived_ns - s.asked_ns) + (s.answered_ns - s.back_ns)) / 2,
        )
        for s in stamps
    )
    return Offset(way_ns * 1e-9, ahead_ns * 1e-9)


def clock_finding(name: str, measured: Offset | None, late_ns: int) -> Finding | None:
    """Whether a robot's clock is ours. `late_ns`: how late, by both clocks, its fastest state was."""
    if measured is not None:
        wrong, ahead_s = abs(measured.ahead_s) - measured.way_s / 2 > APART_S, measured.ahead_s
    else:
        ahead_s = -late_ns * 1e-9
        wrong = abs(ahead_s) > ONE_WAY_S
    if not wrong:
        return None
    where = "ahead of" if ahead_s > 0 else "behind"
    text = f"its clock is {_long(abs(ahead_s))} {where} this computer's: certificates are judged by it, and recordings"
    cure = "set both by one server (chrony, or timedatectl), then start it again"
    return Finding("warning", name, f"{text} lie side by side by it; {cure}")


def _long(seconds: float) -> str:
    if seconds >= 7200:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.1f} s"


# --- asking robots for their clocks ---
# What robots' clocks say: asked by orders of the verb `clock`, which change nothing and are answered at once.

ANSWER_S = 0.5  # of the wall, for all robots together


def ask_clocks(
    session: Session, fleet: Fleet, console: str, robots: Collection[str], now_ns: Callable[[], int]
) -> Mapping[str, Sequence[Stamps]]:
    """Stamps of each robot that answered, ASKED of them where nothing is lost. All are asked at the same time."""
    stamps: dict[str, list[Stamps]] = defaultdict(list)
    for _ in range(ASKED):
        for robot, stamp in _ask_once(session, fleet, console, robots, now_ns).items():
            stamps[robot].append(stamp)
    return stamps


def _ask_once(
    session: Session, fleet: Fleet, console: str, robots: Collection[str], now_ns: Callable[[], int]
) -> dict[str, Stamps]:
    found: dict[str, Stamps] = {}
    over: list[threading.Event] = []
    for robot in robots:
        asked_ns = now_ns()

        key = topics.ORDER.format(fleet=fleet.fleet, robot=robot, console=console)

        def replied(reply: Reply, robot: str = robot, asked_ns: int = asked_ns, key: str = key) -> None:
            back_ns = now_ns()
            try:
                answer = decode(reply.payload, Answer)
            except Refusal:  # an error, or of another version
                return
            if (reply.key, answer.robot, answer.id) == (key, robot, asked_ns) and answer.ok:
                found[robot] = Stamps(asked_ns, answer.arrived_ns, answer.sent_ns, back_ns)

        done = threading.Event()
        over.append(done)
        session.ask(Order, key, encode(Order(id=asked_ns, verb="clock")), ANSWER_S, replied, done.set)
    deadline_s = machine.monotonic_s() + ANSWER_S
    for done in over:
        machine.wait(done, max(0.0, deadline_s - machine.monotonic_s()))
    return found


# --- three seconds of listening ---

LISTEN_S = 3.0  # of the wall and of the fleet's own time, for who stays silent; states come five times a second
SLOWEST_S = 15.0  # of the wall, for a dive in the twin whose time hardly passes
ENOUGH_S = 1.0  # for a fleet in which all are heard: links that come and go need a while to show
ADMIN_S = 0.5  # for what robots say of their own links, which takes a millisecond
LOOK_S = 0.02
KEPT = 4096  # of what arrives between two looks


class Agent(NamedTuple):
    """One that has announced itself."""

    fleet: str
    robot: str
    session: str


class Shown(NamedTuple):
    """What a session says of itself to who may look."""

    metadata: Mapping[str, str]
    linked: frozenset[str]  # sessions


class Looker(NamedTuple):
    """As whom it is looked."""

    config: str  # of an observer's session
    name: str
    asks: bool  # it may ask robots for their links
    orders: bool  # and what their clocks say


class Facts(NamedTuple):
    links: Mapping[str, Link]  # of each robot: the link to where it listens
    lost: Mapping[str, int]  # links to a robot that went while we listened
    agents: frozenset[Agent]
    states: Mapping[str, State]  # the newest of each robot
    missed: Mapping[tuple[str, str], int]  # messages that a robot missed of another while we listened
    late_ns: Mapping[str, int]  # arrival by our clock minus sending by the robot's, the smallest of all its states
    unreadable: Mapping[str, str]  # states that cannot be read: why
    shown: Mapping[str, Shown]  # by session
    stamps: Mapping[str, Sequence[Stamps]]  # of what each robot's clock said


def listen(fleet: Fleet, looker: Looker, robots: Collection[str], now_ns: Callable[[], int]) -> Facts:
    """Link to all robots of a fleet and note what shows until all of `robots` were heard; as a rule for LISTEN_S at
    most. `now_ns` stamps what arrives."""
    ears = _Ears(now_ns)
    with Session(looker.config, f"fleet '{fleet.fleet}'") as session:
        session.watch_links(ears.lost.append)
        session.subscribe(topics.key(STATE, fleet=fleet.fleet, **topics.ANYBODY), ears.state)
        session.watch_tokens(topics.ALIVE.format(fleet="*", **topics.ANYBODY), ears.token)
        began_s, began_ns = machine.monotonic_s(), now_ns()
        while True:
            machine.sleep(LOOK_S)
            ears.read()
            waited_s, lived_s = machine.monotonic_s() - began_s, (now_ns() - began_ns) * 1e-9
            if waited_s >= ENOUGH_S and ears.states.keys() | ears.unreadable.keys() >= set(robots):
                break
            if (waited_s >= LISTEN_S and lived_s >= LISTEN_S) or waited_s >= SLOWEST_S:
                break
        shown = _shown(session.who_is_linked(ADMIN_S)) if looker.asks else {}
        stamps = ask_clocks(session, fleet, looker.name, ears.states.keys(), now_ns) if looker.orders else {}
        links = _by_robot(fleet, session.links())
    whose = {address: name for name, robot in fleet.robot.items() for address in endpoints(robot.listen)}
    return Facts(
        links=links,
        lost=Counter(whose[link.address] for link in ears.lost if link.address in whose),
        agents=frozenset(agent for agent, is_there in dict(ears.tokens).items() if is_there),
        states=ears.states,
        missed=ears.missed(),
        late_ns=ears.late_ns,
        unreadable=ears.unreadable,
        shown=shown,
        stamps=stamps,
    )


class _Ears:
    """What arrives, put down in Zenoh's threads and read in ours."""

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self.states: dict[str, State] = {}
        self.late_ns: dict[str, int] = {}
        self.unreadable: dict[str, str] = {}
        self.tokens: deque[tuple[Agent, bool]] = deque(maxlen=KEPT)  # and whether it came or went
        self.lost: deque[Link] = deque(maxlen=KEPT)
        self._now_ns = now_ns
        self._arrived: deque[tuple[str, bytes, int]] = deque(maxlen=KEPT)
        self._gaps: dict[tuple[str, str, str], tuple[int, int]] = {}  # robot, target, neighbour -> at first, at last

    def state(self, sample: Sample) -> None:
        at_ns = self._now_ns()
        if not unusable(sample, STATE):
            self._arrived.append((sample.key, sample.payload(), at_ns))

    def token(self, sample: Sample) -> None:
        if (chunks := topics.chunks(topics.ALIVE, sample.key)) is not None:
            self.tokens.append((Agent(**chunks), sample.is_put))

    def read(self) -> None:
        """Take in what has arrived since the last call."""
        while self._arrived:
            key, payload, at_ns = self._arrived.popleft()
            row = topics.match(key)
            if row is None:
                continue
            robot = row[1]["robot"]
            try:
                said: State = in_own_name(*row, payload)
            except Refusal as refusal:
                self.unreadable[robot] = str(refusal)
                continue
            self.states[robot] = said
            self.late_ns[robot] = min(at_ns - said.sent_ns, self.late_ns.get(robot, at_ns - said.sent_ns))
            for near in said.neighbours:
                stream = robot, said.target, near.robot
                self._gaps[stream] = self._gaps.get(stream, (near.gaps, 0))[0], near.gaps

    def missed(self) -> Counter[tuple[str, str]]:
        """Messages by who missed them, and of whom."""
        counts = Counter[tuple[str, str]]()
        for (robot, _, other), (first, last) in self._gaps.items():
            counts[robot, other] += last - first
        return counts


def endpoints(listen: str) -> list[str]:
    """An endpoint as Zenoh writes it in a link: with the host's address, of a name with several all of them."""
    protocol = listen.partition("/")[0]
    found = [(str(host), int(port)) for _, (host, port, *_rest) in addresses_of(listen)]
    return [f"{protocol}/[{host}]:{port}" if ":" in host else f"{protocol}/{host}:{port}" for host, port in found]


def _by_robot(fleet: Fleet, links: Collection[Link]) -> dict[str, Link]:
    by_address = {link.address: link for link in links}
    found = {
        name: next((by_address[place] for place in endpoints(robot.listen) if place in by_address), None)
        for name, robot in fleet.robot.items()
    }
    return {name: link for name, link in found.items() if link is not None}


def _shown(replies: Collection[bytes]) -> dict[str, Shown]:
    """What sessions say, as far as it has the shape that Zenoh gives it."""
    found = {}
    for reply in replies:
        try:
            said: dict[str, Any] = msgspec.json.decode(reply)
            peers = frozenset(str(other["peer"]) for other in said["sessions"])
            texts = {str(key): str(value) for key, value in (said["metadata"] or {}).items()}
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, KeyError, TypeError, AttributeError):
            continue
        found[str(said.get("zid"))] = Shown(texts, peers)
    return found
