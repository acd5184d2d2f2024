"""The network <-> messages: what an agent and an observer publish and receive, the clock a fleet lives by, and the
router.

On arrival it is checked who sent, how it is encoded and how long it is; decoding and believing are the kernel's.
"""

from __future__ import annotations

import contextlib
import random
import threading
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from agent.clock import machine
from agent.clock.clock import Clock, RunClock, SystemClock
from agent.core import topics
from agent.core.codec import encode
from agent.core.config import ConfigError, Fleet
from agent.core.messages import Answer, Estimate, Image, LogLine, Message, State
from agent.core.step_io import DroppedPayloads, Heard, Ordered, Said
from agent.core.topics import ANSWER, IMAGE, LINK, LOG, STATE, TOPICS, Topic
from agent.core.verbs import prepare_all
from agent.process.certificates import certificate_file, hosts_of, read_certificate
from agent.process.links import Inboxes, OrderBox, Strangers, Tokens, rows_of
from agent.robot.fleet_reader import two_worlds
from hw.twin.twin_folder import clock_path
from router_config.session import Publish, Sample, Session, unusable
from router_config.settings import (
    ROUTER,
    ROUTER_LISTEN,
    ROUTER_LISTEN_SECURED,
    observer_config,
    peer_config,
    router_config,
)

LOOKER = "view"  # as whom people look at a secured fleet, by the name that every fleet file has for it
OBSERVED = 4096  # messages an observer keeps between two drains, oldest dropped first: a minute of three robots


class Transport:
    """A robot's links to its neighbours and what it shows to observers. Context manager.

    `clock` gives integer nanoseconds that never step back; it stamps messages on arrival. `keys`: folder of a secured
    fleet's certificates.
    Entering raises ConfigError, one line, when the endpoint of the fleet file cannot be used.
    """

    def __init__(self, fleet: Fleet, robot: str, clock: Callable[[], int], keys: Path | None = None) -> None:
        self._keys = keys
        self.lost = 0  # outgoing link messages thrown away by fault injection
        self._fleet, self._robot, self._clock = fleet, robot, clock
        self._random = random.Random(f"{fleet.link.loss_seed} {robot}")
        self._inboxes, self._tokens = Inboxes(fleet, robot), Tokens(fleet, robot)
        self._strangers = Strangers(fleet, robot)
        self._box = OrderBox(fleet, robot, clock)
        self._links: dict[tuple[str, str], Publish] = {}  # neighbour, target
        self._tell: dict[tuple[str, str], Publish] = {}  # neighbour, topic of what it is told beside estimates
        self._shows: dict[tuple[type[Message], str], Publish] = {}  # kind, target
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        where = f"robot '{self._robot}': {self._fleet.robot[self._robot].listen}"
        names = {"fleet": self._fleet.fleet, "robot": self._robot}
        targets = self._fleet.target
        prepare_all()
        with contextlib.ExitStack() as stack:
            session = stack.enter_context(Session(peer_config(self._fleet, self._robot, self._keys), where))
            for target in targets:
                chunk = topics.target_chunk(targets, target)
                for name in self._fleet.robot[self._robot].neighbours:
                    key = topics.key(LINK, fleet=self._fleet.fleet, src=self._robot, dst=name, **chunk)
                    self._links[name, target] = session.publisher(LINK, key)
                self._shows[State, target] = session.publisher(STATE, topics.key(STATE, **names, **chunk))
            self._shows[LogLine, ""] = session.publisher(LOG, topics.key(LOG, **names))
            self._shows[Image, ""] = session.publisher(IMAGE, topics.key(IMAGE, **names))
            heard = topics.key(LINK, fleet=self._fleet.fleet, src="*", dst=self._robot, target="**")
            session.subscribe(heard, self._arrived)
            for row in rows_of(self._fleet):
                self._tells(session, row)
            session.answer(topics.ORDER.format(**names, console="*"), self._box.asked)
            stack.callback(self._box.close)
            session.announce(topics.ALIVE.format(**names, session=session.id))
            session.watch_tokens(topics.ALIVE.format(fleet="*", robot="*", session="*"), self._token)
            session.watch_tokens(topics.TWICE.format(**names, witness="*"), self._token)
            self._session = session
            self._open = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._open.close()

    def drain(self) -> tuple[tuple[Heard, ...], tuple[DroppedPayloads, ...]]:
        """The newest link messages since the last call, neighbours in turn, and how many were turned away."""
        heard, refused = self._inboxes.drain(self._clock())
        orders = (DroppedPayloads(reason=reason, count=count) for reason, count in self._box.refused())
        return heard, (*refused, *orders)

    def orders(self) -> tuple[Ordered, ...]:
        """What people have ordered since the last call: what is urgent first, then in order of arrival."""
        return self._box.take()

    def answer(self, answers: Sequence[Answer]) -> None:
        """Answer the orders that were taken last, one by one, and show the answers to people who look."""
        self._box.answer(answers)
        for answer in answers:
            names = {"fleet": self._fleet.fleet, "robot": self._robot, "console": answer.console}
            self._session.put(ANSWER, topics.key(ANSWER, **names), encode(answer))

    def _tells(self, session: Session, row: Topic) -> None:
        """What neighbours tell each other on a topic of a capability."""
        for name in self._fleet.robot[self._robot].neighbours:
            key = topics.key(row, fleet=self._fleet.fleet, src=self._robot, dst=name)
            self._tell[name, row.name] = session.publisher(row, key)
        session.subscribe(topics.key(row, fleet=self._fleet.fleet, src="*", dst=self._robot), self._arrived)

    def say(self, message: Estimate | Said) -> None:
        """Send to the neighbour that it is for. Never blocks; under pressure, or by fault injection, it is lost."""
        if self._random.random() < self._fleet.link.loss:
            self.lost += 1
            return
        if isinstance(message, Estimate):
            self._links[message.dst, message.target](encode(message))
        else:
            self._tell[message.to, message.topic](message.payload)

    def show(self, message: State | LogLine | Image) -> None:
        """Publish to people who look. Never blocks; previews come from vision's thread."""
        self._shows[type(message), message.target if isinstance(message, State) else ""](encode(message))

    def faults(self) -> tuple[str, ...]:
        """What is wrong with who is linked to us, each as "kind: what to do". Never waits; for the loop."""
        now_s = machine.monotonic_s()
        tokens = self._tokens.faults(self._session.id, self._session.announce, now_s)
        return (*tokens, *self._strangers.faults(self._session.links, now_s))

    def _token(self, sample: Sample) -> None:
        self._tokens.token(sample, machine.monotonic_s())  # links and their leases are the wall's

    def _arrived(self, sample: Sample) -> None:
        self._inboxes.put(sample, self._clock())


class Received(NamedTuple):
    """One message that an observer got."""

    topic: Topic
    chunks: dict[str, str]  # what the key says: fleet, and robot or src and dst; target where there are several
    payload: bytes  # not yet decoded
    arrived_ns: int


class Observer:
    """Looks at every robot of a fleet without being known to any. Context manager; `rows` choose what it hears.

    In a secured fleet it looks as `name`, an observer or a console, whose certificate lies in the folder `keys`. What a
    robot tells each of its neighbours alike it hears once where `once` is set: a fleet of five says it four times.
    """

    def __init__(
        self,
        fleet: Fleet,
        clock: Callable[[], int],
        rows: tuple[Topic, ...] = TOPICS,
        name: str = LOOKER,
        keys: Path | None = None,
        once: bool = False,
    ) -> None:
        self._config = observer_config(fleet, name, keys)
        self._fleet, self._clock, self._rows, self._once = fleet, clock, rows, once
        self._received: deque[Received] = deque(maxlen=OBSERVED)
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            session = stack.enter_context(Session(self._config, f"fleet '{self._fleet.fleet}'"))
            for row in self._rows:
                for key in self._keys_of(row):
                    session.subscribe(key, self._arrived)
            self._open = stack.pop_all()
        return self

    def _keys_of(self, row: Topic) -> list[str]:
        anyone = {"fleet": self._fleet.fleet, **topics.ANYBODY}
        if not self._once or row.writer != "src":
            return [topics.key(row, **anyone)]
        told = told_first(self._fleet).items()
        return [topics.key(row, **{**anyone, "src": src, "dst": dst}) for src, dst in told]

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


def told_first(fleet: Fleet) -> dict[str, str]:
    """Of each robot with neighbours the one whose copy stands for what all of them are told alike."""
    return {name: robot.neighbours[0] for name, robot in fleet.robot.items() if robot.neighbours}


# --- fleet clock ---
# Which clock a fleet lives by: that of its dive in the twin, or the system's.


def fleet_clock(fleet: Fleet) -> Clock:
    """The one clock of all robots. Raises ConfigError for a fleet of which only a part is in the twin."""
    if (why := two_worlds(fleet)) is not None:
        raise ConfigError(f"fleet '{fleet.fleet}': {why}")
    in_twin = any(robot.serial.startswith("twin:") for robot in fleet.robot.values())
    return RunClock(clock_path(fleet)) if in_twin else SystemClock()


# --- router ---
# The router: a place to look from. The swarm runs without it, and no link of the swarm passes through it.

PERIOD_S = 0.1  # between two looks who is there


def run_router(
    fleet: Fleet,
    stop: threading.Event,
    listen: str | None = None,
    say: Callable[[str], None] = lambda line: None,
    keys: Path | None = None,
) -> None:
    """Dial every robot and serve clients on `listen` until `stop` is set; `say` gets lines for a person: where to look,
    and who is not heard. `keys`: the folder of a secured fleet's certificates; its clients need one, too.

    Raises ConfigError if it cannot listen.
    """
    listen = listen or (ROUTER_LISTEN if keys is None else ROUTER_LISTEN_SECURED)
    heard: set[str] = set()

    def came(token: Sample) -> None:
        if (seen := topics.chunks(topics.ALIVE, token.key)) is not None:
            heard.add(seen["robot"])

    from replay.recorder import RollCall  # here: no agent needs the recorder

    check_listen(listen, keys)
    with Session(router_config(fleet, listen, keys), f"--listen {listen}") as session:
        session.watch_tokens(topics.ALIVE.format(fleet=fleet.fleet, robot="*", session="*"), came)
        say(f"consoles attach to {listen}; Ctrl-C ends it")
        roll = RollCall(fleet, say)
        while not machine.wait(stop, PERIOD_S):
            roll.look(frozenset(heard))
        roll.end()


def check_listen(listen: str, keys: Path | None) -> None:
    """Raises ConfigError where clients could not attach, or everybody could."""
    if keys is None:
        if not listen.startswith("tcp/"):
            raise ConfigError(f"--listen {listen}: no endpoint; write tcp/HOST:PORT, such as {ROUTER_LISTEN}")
        return
    if not listen.startswith("tls/"):
        raise ConfigError(
            f"--listen {listen}: the fleet is secured; write tls/HOST:PORT, such as {ROUTER_LISTEN_SECURED}"
        )
    host, good = listen.partition("/")[2].rpartition(":")[0], hosts_of(read_certificate(certificate_file(keys, ROUTER)))
    if host not in good:
        raise ConfigError(
            f"--listen {listen}: the router's certificate is good at {' and '.join(good)} alone; "
            f"listen there, and come from elsewhere through ssh -L"
        )
