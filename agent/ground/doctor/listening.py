"""What a look of three seconds at a running fleet shows: links, tokens, states, and what robots say of their own links.

Nothing is judged here.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from agent.clock import machine
from agent.core import topics
from agent.core.codec import Refusal, decode
from agent.core.config import Fleet
from agent.core.messages import State
from agent.core.topics import STATE
from agent.ground.doctor.asking import ask_clocks
from agent.ground.doctor.clocks import Stamps
from agent.process.ports import addresses_of
from router_config.door import Link, Sample, Session, unusable

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
            robot = row[1]["robot"] if row else ""
            try:
                said = decode(payload, State)
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
        except (msgspec.DecodeError, KeyError, TypeError, AttributeError):
            continue
        found[str(said.get("zid"))] = Shown(texts, peers)
    return found
