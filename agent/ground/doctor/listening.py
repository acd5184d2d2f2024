"""What a look of three seconds at a running fleet shows: links, tokens, states, and what robots say of their own links.

Nothing is judged here.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from agent.clock import machine
from agent.ground.doctor.asking import ask_clocks
from agent.ground.doctor.clocks import Stamps
from agent.kernel import topics
from agent.kernel.codec import Refusal, decode
from agent.kernel.config import Fleet
from agent.kernel.messages import State
from agent.kernel.topics import STATE
from agent.ports import addresses_of
from router_config.door import Link, Sample, Session, unusable

LISTEN_S = 3.0  # of the wall, for who stays silent; states come five times a second
ENOUGH_S = 1.0  # for a fleet in which all are heard: links that come and go need a while to show
ADMIN_S = 0.5  # for what robots say of their own links, which takes a millisecond
LOOK_S = 0.02


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
    late_ns: Mapping[str, int]  # arrival by our clock minus sending by the robot's, the smallest of all its states
    unreadable: Mapping[str, str]  # states that cannot be read: why
    shown: Mapping[str, Shown]  # by session
    stamps: Mapping[str, Sequence[Stamps]]  # of what each robot's clock said


def listen(fleet: Fleet, looker: Looker, robots: Collection[str], now_ns: Callable[[], int]) -> Facts:
    """Link to all robots of a fleet and note what shows until all of `robots` were heard, LISTEN_S at most. `now_ns`
    stamps what arrives."""
    arrived: deque[tuple[str, bytes, int]] = deque(maxlen=4096)
    tokens: deque[tuple[Agent, bool]] = deque(maxlen=4096)
    lost: list[Link] = []
    states, late_ns, unreadable = dict[str, State](), dict[str, int](), dict[str, str]()

    def state(sample: Sample) -> None:
        at_ns = now_ns()
        if not unusable(sample, STATE):
            arrived.append((sample.key, sample.payload(), at_ns))

    def token(sample: Sample) -> None:
        if (chunks := topics.chunks(topics.ALIVE, sample.key)) is not None:
            tokens.append((Agent(**chunks), sample.is_put))

    def read() -> None:
        while arrived:
            key, payload, at_ns = arrived.popleft()
            row = topics.match(key)
            robot = row[1]["robot"] if row else ""
            try:
                states[robot] = said = decode(payload, State)
            except Refusal as refusal:
                unreadable[robot] = str(refusal)
                continue
            late_ns[robot] = min(at_ns - said.sent_ns, late_ns.get(robot, at_ns - said.sent_ns))

    with Session(looker.config, f"fleet '{fleet.fleet}'") as session:
        session.watch_links(lost.append)
        session.subscribe(topics.key(STATE, fleet=fleet.fleet, **topics.ANYBODY), state)
        session.watch_tokens(topics.ALIVE.format(fleet="*", **topics.ANYBODY), token)
        began_s = machine.monotonic_s()
        while (waited_s := machine.monotonic_s() - began_s) < LISTEN_S:
            machine.sleep(LOOK_S)
            read()
            if waited_s >= ENOUGH_S and states.keys() | unreadable.keys() >= set(robots):
                break
        shown = _shown(session.who_is_linked(ADMIN_S)) if looker.asks else {}
        stamps = ask_clocks(session, fleet, looker.name, states.keys(), now_ns) if looker.orders else {}
        links = _by_robot(fleet, session.links())
    whose = {address: name for name, robot in fleet.robot.items() for address in endpoints(robot.listen)}
    went = Counter(whose[link.address] for link in lost if link.address in whose)
    return Facts(links, went, _there(tokens), states, late_ns, unreadable, shown, stamps)


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


def _there(tokens: Collection[tuple[Agent, bool]]) -> frozenset[Agent]:
    newest = dict(tokens)
    return frozenset(agent for agent, came in newest.items() if came)


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
