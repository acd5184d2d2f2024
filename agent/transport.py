"""The network <-> messages.

On arrival it is checked who sent, how it is encoded and how long it is; decoding and believing are the kernel's.
"""

from __future__ import annotations

import contextlib
import random
import threading
from collections import Counter, deque
from collections.abc import Callable
from types import TracebackType
from typing import NamedTuple, Self

from agent.kernel import topics
from agent.kernel.codec import encode
from agent.kernel.config import Fleet
from agent.kernel.messages import Estimate, Image, LogLine, Message, State
from agent.kernel.step_io import DroppedPayloads, Heard
from agent.kernel.topics import IMAGE, LINK, LOG, STATE, TOPICS, Topic
from router_config.door import Publish, Sample, Session, unusable
from router_config.session import observer_config, peer_config

OBSERVED = 4096  # messages an observer keeps between two drains, oldest dropped first: a minute of three robots


class Transport:
    """A robot's links to its neighbours and what it shows to observers. Context manager.

    `clock` gives integer nanoseconds that never step back; it stamps messages on arrival.
    Entering raises ConfigError, one line, when the endpoint of the fleet file cannot be used.
    """

    def __init__(self, fleet: Fleet, robot: str, clock: Callable[[], int]) -> None:
        self.lost = 0  # outgoing link messages thrown away by fault injection
        self._fleet, self._robot, self._clock = fleet, robot, clock
        self._random = random.Random(f"{fleet.link.loss_seed} {robot}")
        self._inbox: dict[str, deque[tuple[int, bytes]]] = {
            name: deque(maxlen=LINK.qos.buffer) for name in fleet.robot[robot].neighbours
        }
        self._refused: Counter[str] = Counter()
        self._lock = threading.Lock()  # guards the inboxes and the counts: zenoh's threads against the loop's
        self._links: dict[tuple[str, str], Publish] = {}  # neighbour, target
        self._shows: dict[tuple[type[Message], str], Publish] = {}  # kind, target
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        where = f"robot '{self._robot}': {self._fleet.robot[self._robot].listen}"
        names = {"fleet": self._fleet.fleet, "robot": self._robot}
        targets = self._fleet.target
        with contextlib.ExitStack() as stack:
            session = stack.enter_context(Session(peer_config(self._fleet, self._robot), where))
            for target in targets:
                chunk = topics.target_chunk(targets, target)
                for name in self._inbox:
                    key = topics.key(LINK, fleet=self._fleet.fleet, src=self._robot, dst=name, **chunk)
                    self._links[name, target] = session.publisher(LINK, key)
                self._shows[State, target] = session.publisher(STATE, topics.key(STATE, **names, **chunk))
            self._shows[LogLine, ""] = session.publisher(LOG, topics.key(LOG, **names))
            self._shows[Image, ""] = session.publisher(IMAGE, topics.key(IMAGE, **names))
            heard = topics.key(LINK, fleet=self._fleet.fleet, src="*", dst=self._robot, target="**")
            session.subscribe(heard, self._arrived)
            session.announce(topics.ALIVE.format(**names))
            self._open = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._open.close()

    def drain(self) -> tuple[tuple[Heard, ...], tuple[DroppedPayloads, ...]]:
        """Link messages since the last call in order of arrival, and how many were turned away, by reason."""
        with self._lock:
            arrived = [(at_ns, name, payload) for name, inbox in self._inbox.items() for at_ns, payload in inbox]
            refused = sorted(self._refused.items())
            for inbox in self._inbox.values():
                inbox.clear()
            self._refused.clear()
        arrived.sort(key=lambda item: item[0])  # stable: equal stamps of one neighbour keep their order
        return (
            tuple(Heard(arrived_ns=at_ns, src=name, payload=payload) for at_ns, name, payload in arrived),
            tuple(DroppedPayloads(reason=reason, count=count) for reason, count in refused),
        )

    def say(self, estimate: Estimate) -> None:
        """Send to the neighbour `estimate.dst`. Never blocks; under pressure, or by fault injection, it is lost."""
        if self._random.random() < self._fleet.link.loss:
            self.lost += 1
            return
        self._links[estimate.dst, estimate.target](encode(estimate))

    def show(self, message: State | LogLine | Image) -> None:
        """Publish to whoever looks. Never blocks; previews come from vision's thread."""
        self._shows[type(message), message.target if isinstance(message, State) else ""](encode(message))

    def _arrived(self, sample: Sample) -> None:
        at_ns = self._clock()
        row = topics.match(sample.key)
        name = row[1].get("src", "") if row else ""
        reason = unusable(sample, LINK) if name in self._inbox else "unknown sender"
        payload = b"" if reason else sample.payload()
        with self._lock:
            if reason:
                self._refused[reason] += 1
                return
            inbox = self._inbox[name]
            if len(inbox) == inbox.maxlen:
                self._refused["inbox full"] += 1  # the oldest makes room
            inbox.append((at_ns, payload))


class Received(NamedTuple):
    """One message that an observer got."""

    topic: Topic
    chunks: dict[str, str]  # what the key says: fleet, and robot or src and dst; target where there are several
    payload: bytes  # not yet decoded
    arrived_ns: int


class Observer:
    """Looks at every robot of a fleet without being known to any. Context manager; `rows` choose what it hears."""

    def __init__(self, fleet: Fleet, clock: Callable[[], int], rows: tuple[Topic, ...] = TOPICS) -> None:
        self._fleet, self._clock, self._rows = fleet, clock, rows
        self._received: deque[Received] = deque(maxlen=OBSERVED)
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            session = stack.enter_context(Session(observer_config(self._fleet), f"fleet '{self._fleet.fleet}'"))
            anyone = {"fleet": self._fleet.fleet, "src": "*", "dst": "*", "robot": "*", "target": "**"}
            for row in self._rows:
                session.subscribe(topics.key(row, **anyone), self._arrived)
            self._open = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._open.close()

    def drain(self) -> list[Received]:
        """What arrived since the last call, in order of arrival."""
        received = []
        while self._received:
            received.append(self._received.popleft())
        return received

    def _arrived(self, sample: Sample) -> None:
        at_ns = self._clock()
        row = topics.match(sample.key)
        if row and not unusable(sample, row[0]):
            self._received.append(Received(*row, sample.payload(), at_ns))
