"""Zenoh <-> messages. The only file of the agent that imports zenoh: bytes, keys and integers cross its border.

On arrival it is checked who sent, how it is encoded and how long it is; decoding and believing are the kernel's.
A callback does no more than stamp, check and append: a slow one holds up every other subscription of its session.
"""

from __future__ import annotations

import contextlib
import logging
import random
import re
import threading
from collections import Counter, deque
from collections.abc import Callable
from types import TracebackType
from typing import Any, NamedTuple, Self

import zenoh

from agent import topics
from agent.config import ConfigError, Fleet
from agent.messages import Estimate, Heard, Image, LogLine, Message, Refused, State, encode, encoding
from agent.session import observer_config, peer_config
from agent.topics import IMAGE, LINK, LOG, STATE, TOPICS, Topic

logger = logging.getLogger(__name__)

# What zenoh says when it cannot listen, and what a person can do about it.
REMEDIES = {
    "Address already in use": "the address is in use; end that process or take another port",
    "Cannot assign requested address": "no address of this computer; write one of its own",
    "failed to lookup address": "no such host; write the computer's address as a number",
}
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
        self._links: dict[tuple[str, str], Any] = {}  # neighbour, target -> publisher
        self._shows: dict[tuple[type[Message], str], Any] = {}  # kind, target -> publisher
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        where = f"robot '{self._robot}': {self._fleet.robot[self._robot].listen}"
        names = {"fleet": self._fleet.fleet, "robot": self._robot}
        targets = self._fleet.target
        with contextlib.ExitStack() as stack:
            session = stack.enter_context(open_session(peer_config(self._fleet, self._robot), where))
            for target in targets:
                chunk = topics.target_chunk(targets, target)
                for name in self._inbox:
                    key = topics.key(LINK, fleet=self._fleet.fleet, src=self._robot, dst=name, **chunk)
                    self._links[name, target] = _publisher(session, LINK, key)
                self._shows[State, target] = _publisher(session, STATE, topics.key(STATE, **names, **chunk))
            self._shows[LogLine, ""] = _publisher(session, LOG, topics.key(LOG, **names))
            self._shows[Image, ""] = _publisher(session, IMAGE, topics.key(IMAGE, **names))
            heard = topics.key(LINK, fleet=self._fleet.fleet, src="*", dst=self._robot, target="**")
            _subscribe(session, heard, self._arrived)
            stack.enter_context(session.liveliness().declare_token(topics.ALIVE.format(**names)))
            self._open = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        _close(self._open)

    def drain(self) -> tuple[tuple[Heard, ...], tuple[Refused, ...]]:
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
            tuple(Refused(reason=reason, count=count) for reason, count in refused),
        )

    def say(self, estimate: Estimate) -> None:
        """Send to the neighbour `estimate.dst`. Never blocks; under pressure, or by fault injection, it is lost."""
        if self._random.random() < self._fleet.link.loss:
            self.lost += 1
            return
        self._links[estimate.dst, estimate.target].put(encode(estimate))

    def show(self, message: State | LogLine | Image) -> None:
        """Publish to whoever looks. Never blocks; previews come from vision's thread."""
        self._shows[type(message), message.target if isinstance(message, State) else ""].put(encode(message))

    def _arrived(self, sample: zenoh.Sample) -> None:
        at_ns = self._clock()
        row = topics.match(str(sample.key_expr))
        name = row[1].get("src", "") if row else ""
        reason = unusable(sample, LINK) if name in self._inbox else "unknown sender"
        payload = b"" if reason else sample.payload.to_bytes()
        with self._lock:
            if reason:
                self._refused[reason] += 1
                return
            inbox = self._inbox[name]
            if len(inbox) == inbox.maxlen:
                self._refused["inbox full"] += 1  # the oldest makes room
            inbox.append((at_ns, payload))


class Seen(NamedTuple):
    topic: Topic
    chunks: dict[str, str]  # what the key says: fleet, and robot or src and dst; target where there are several
    payload: bytes  # not yet decoded
    arrived_ns: int


class Observer:
    """Looks at every robot of a fleet without being known to any. Context manager; `rows` choose what it hears."""

    def __init__(self, fleet: Fleet, clock: Callable[[], int], rows: tuple[Topic, ...] = TOPICS) -> None:
        self._fleet, self._clock, self._rows = fleet, clock, rows
        self._seen: deque[Seen] = deque(maxlen=OBSERVED)
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            session = stack.enter_context(open_session(observer_config(self._fleet), f"fleet '{self._fleet.fleet}'"))
            anyone = {"fleet": self._fleet.fleet, "src": "*", "dst": "*", "robot": "*", "target": "**"}
            for row in self._rows:
                _subscribe(session, topics.key(row, **anyone), self._arrived)
            self._open = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        _close(self._open)

    def drain(self) -> list[Seen]:
        """What arrived since the last call, in order of arrival."""
        seen = []
        while self._seen:
            seen.append(self._seen.popleft())
        return seen

    def _arrived(self, sample: zenoh.Sample) -> None:
        at_ns = self._clock()
        row = topics.match(str(sample.key_expr))
        if row and not unusable(sample, row[0]):
            self._seen.append(Seen(*row, sample.payload.to_bytes(), at_ns))


def open_session(config: str, where: str) -> zenoh.Session:
    """Open a session, to be used with `with`. Raises ConfigError that starts with `where`."""
    try:
        return zenoh.open(zenoh.Config.from_json5(config))
    except zenoh.ZError as error:
        for sign, remedy in REMEDIES.items():
            if sign in str(error):
                raise ConfigError(f"{where}: {remedy}") from None
        reason = re.sub(r" at /\S+", "", str(error))  # zenoh names the places in its own source
        raise ConfigError(f"{where}: zenoh cannot open it: {reason}") from None


def unusable(sample: zenoh.Sample, row: Topic) -> str | None:
    """Why a sample cannot be a message of this row, judged before its payload is copied; None if it can."""
    if sample.kind != zenoh.SampleKind.PUT:
        return "not a put"
    if str(sample.encoding) != encoding(row.message):
        return "wrong encoding"
    if len(sample.payload) > row.limit:
        return "too large"
    return None


def _publisher(session: zenoh.Session, row: Topic, key: str) -> zenoh.Publisher:
    return session.declare_publisher(
        key,
        encoding=encoding(row.message),
        congestion_control=zenoh.CongestionControl.DROP,
        priority=getattr(zenoh.Priority, row.qos.priority),
        reliability=getattr(zenoh.Reliability, row.qos.reliability),
    )


def _subscribe(session: zenoh.Session, key: str, arrived: Callable[[zenoh.Sample], None]) -> None:
    # Called in zenoh's own thread: a thread of Python's in between would stamp later, and keeps a process from ending.
    handler = zenoh.handlers.Callback(arrived, indirect=False)
    session.declare_subscriber(key, handler, allowed_origin=zenoh.Locality.REMOTE)


def _close(session: contextlib.ExitStack) -> None:
    try:
        session.close()
    except zenoh.ZError as error:
        logger.warning("zenoh did not close cleanly: %s", error)  # the process is ending: nothing is left to do
