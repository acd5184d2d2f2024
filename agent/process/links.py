"""What links bring between two steps: the newest messages of each neighbour, operator orders until they are answered,
liveliness tokens, and links of strangers.

What one neighbour says about one target may fill KEPT places and no more: the newest stay. That loses nothing, as
evidence is a sum, and the newest estimate stands for those before it; a gap in the numbers tells of the rest. No
neighbour can take another's places, or come before another by speaking more often.
"""

from __future__ import annotations

import contextlib
import logging
import math
import re
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from msgspec import UNSET

from agent.core import topics
from agent.core.codec import Refusal, decode, encode, encoding
from agent.core.config import Fleet
from agent.core.messages import MAX_ORDER, NAME, Answer, Order
from agent.core.step_io import DroppedPayloads, Heard, Ordered
from agent.core.topics import LINK, Topic
from agent.core.verbs import CLOCK, URGENT
from agent.robot.arbiter import CAPABILITIES, table_of
from agent.robot.operator import why_closed
from router_config.session import Link, Query, Sample, Withdraw, unusable

KEPT = LINK.qos.buffer
FASTEST_HZ = 40.0  # twice what a fleet file may ask for: who speaks more often for long floods
BURST = 64.0  # messages that may come at once after a cable was out: links are given up after two seconds of silence

STRANGER = "unknown sender"
FLOOD = "flood"


def rows_of(fleet: Fleet) -> tuple[Topic, ...]:
    """What neighbours of this fleet tell each other beside estimates."""
    present = (kind for kind in CAPABILITIES if table_of(fleet, kind) is not None)
    return tuple(topic for kind in present for topic in kind.topics)


class _Inbox:
    """Places for what one neighbour says about one target, or about where it is itself."""

    __slots__ = ("arrived", "credit", "kept", "src", "topic")

    def __init__(self, src: str, topic: Topic = LINK) -> None:
        self.src, self.topic = src, topic
        self.kept: deque[tuple[int, bytes]] = deque(maxlen=KEPT)
        self.arrived = 0  # since the last drain
        self.credit = BURST  # messages that may come without being called a flood


class Inboxes:
    """All neighbours' places, filled by Zenoh's threads and emptied by the loop."""

    def __init__(self, fleet: Fleet, robot: str) -> None:
        neighbours, targets = fleet.robot[robot].neighbours, fleet.target
        self._by_key = {
            topics.key(LINK, fleet=fleet.fleet, src=src, dst=robot, **topics.target_chunk(targets, target)): _Inbox(src)
            for target in targets
            for src in neighbours
        }
        self._by_key |= {
            topics.key(row, fleet=fleet.fleet, src=src, dst=robot): _Inbox(src, row)
            for row in rows_of(fleet)
            for src in neighbours
        }
        # Who speaks of a target that our file lacks has another fleet file. One place for all such: the step says so.
        self._elsewhere: Mapping[str, _Inbox] = {src: _Inbox(src) for src in neighbours}
        self._inboxes = (*self._by_key.values(), *self._elsewhere.values())  # by target, then by neighbour
        self._refused: Counter[tuple[str, str]] = Counter()  # reason and neighbour: few, whatever arrives
        self._lock = threading.Lock()  # Zenoh has a thread per link
        self._drained_ns: int | None = None

    def put(self, sample: Sample, at_ns: int) -> None:
        """Judge a sample by its outside, and keep a copy if it can be a neighbour's word."""
        inbox = self._by_key.get(key := sample.key)
        if inbox is None:
            inbox = self._unusual(key)
        reason = STRANGER if inbox is None else unusable(sample, inbox.topic)
        payload = b"" if reason else sample.payload()
        with self._lock:
            if inbox is None or reason is not None:
                self._refused[reason or STRANGER, inbox.src if inbox else ""] += 1
            else:
                inbox.arrived += 1
                inbox.kept.append((at_ns, payload))

    def drain(self, now_ns: int) -> tuple[tuple[Heard, ...], tuple[DroppedPayloads, ...]]:
        """What was kept since the last call, and how much was turned away, by reason and neighbour.

        First the older one of each neighbour, then the newer. What a step that came late could not take is turned away
        in silence; more than a neighbour can have to say is counted as a flood.
        """
        # Before the first step neighbours may have spoken for as long as they like.
        elapsed_s = math.inf if self._drained_ns is None else max(0, now_ns - self._drained_ns) * 1e-9
        self._drained_ns = now_ns
        with self._lock:
            kept = [(inbox, list(inbox.kept)) for inbox in self._inboxes]
            for inbox in self._inboxes:
                self._settle(inbox, elapsed_s)
            refused = sorted(self._refused.items())
            self._refused.clear()
        heard = tuple(
            Heard(
                arrived_ns=payloads[k][0],
                src=inbox.src,
                payload=payloads[k][1],
                topic=UNSET if inbox.topic is LINK else inbox.topic.name,
            )
            for k in range(KEPT)
            for inbox, payloads in kept
            if k < len(payloads)
        )
        return heard, tuple(
            DroppedPayloads(reason=reason, count=count, src=src or UNSET) for (reason, src), count in refused
        )

    def _settle(self, inbox: _Inbox, elapsed_s: float) -> None:
        """Empty it, and count what was beyond all measure."""
        credit = inbox.credit + FASTEST_HZ * elapsed_s
        inbox.credit = max(0.0, min(BURST, credit - inbox.arrived))
        if inbox.arrived:
            beyond = min(inbox.arrived - credit, inbox.arrived - len(inbox.kept))
            if beyond > 0:
                self._refused[FLOOD, inbox.src] += round(beyond)
            inbox.arrived = 0
            inbox.kept.clear()

    def _unusual(self, key: str) -> _Inbox | None:
        """The place of a neighbour's word on a key that is not among the expected ones."""
        row = topics.match(key)
        return self._elsewhere.get(row[1]["src"]) if row and row[0] is LINK else None


# --- operator orders ---
# Orders between two steps: queries are kept until the step that took them has been recorded, and then answered.
#
# Zenoh's threads only judge a query by its outside and keep it. One is answered there, at once: it asks what time it
# is, and a comparison of clocks wants no step in between.

logger = logging.getLogger(__name__)

WAITING = 16  # of one console
ALL_WAITING = 64


class _Waiting(NamedTuple):
    ordered: Ordered
    query: Query


class OrderBox:
    """Of one robot; filled by Zenoh's threads and emptied by the loop. Urgent orders have places of their own, so that
    no flood of others takes them, and come first."""

    def __init__(self, fleet: Fleet, robot: str, clock: Callable[[], int]) -> None:
        self._fleet, self._robot, self._clock = fleet, robot, clock
        self._urgent: deque[_Waiting] = deque()
        self._others: deque[_Waiting] = deque()
        self._held: list[_Waiting] = []  # those of the step under way
        self._refused: Counter[str] = Counter()
        self._lock = threading.Lock()  # guards what waits and what was refused: Zenoh has a thread per link

    def asked(self, query: Query) -> None:
        """Keep an order, or turn it away."""
        at_ns = self._clock()
        who = topics.chunks(topics.ORDER, query.key)
        console = "" if who is None else who["console"]
        why = self._unusable(query, console)
        if why is None:
            waiting = _Waiting(Ordered(arrived_ns=at_ns, console=console, payload=query.payload()), query)
            order = _read(waiting.ordered)
            if order is not None and self._says_time(order, waiting):
                return
            why = self._keep(waiting, self._urgent if order is not None and order.verb in URGENT else self._others)
        if why is not None:
            with self._lock:
                self._refused[why] += 1
            with contextlib.suppress(Exception):  # the asker is gone
                query.refuse(why)
            query.drop()

    def take(self) -> tuple[Ordered, ...]:
        """What arrived since the last call. Who was not answered since then will not be."""
        self.drop()
        with self._lock:
            self._held = [*self._urgent, *self._others]
            self._urgent.clear()
            self._others.clear()
        return tuple(ordered for ordered, _ in self._held)

    def refused(self) -> list[tuple[str, int]]:
        """What was turned away since the last call, by reason."""
        with self._lock:
            counts = sorted(self._refused.items())
            self._refused.clear()
        return counts

    def answer(self, answers: Sequence[Answer]) -> None:
        """Answer what was taken last, one by one."""
        held, self._held = self._held, []
        for (_, query), answer in zip(held, answers, strict=False):
            self._reply(query, answer)
        for _, query in held[len(answers) :]:
            query.drop()

    def drop(self) -> None:
        """Let those go who wait for an answer to what was taken."""
        held, self._held = self._held, []
        for _, query in held:
            query.drop()

    def close(self) -> None:
        """Let everybody go."""
        self.take()
        self.drop()

    def _unusable(self, query: Query, console: str) -> str | None:
        if NAME.fullmatch(console) is None:
            return "order of nobody"
        if query.encoding != encoding(Order):
            return "order in a wrong encoding"
        return "order too large" if query.size > MAX_ORDER else None

    def _keep(self, waiting: _Waiting, places: deque[_Waiting]) -> str | None:
        """Why it is turned away; None: it is kept."""
        with self._lock:
            own = sum(one.ordered.console == waiting.ordered.console for one in places)
            if own >= WAITING or len(places) >= ALL_WAITING:
                return "too many orders at once"
            places.append(waiting)
        return None

    def _says_time(self, order: Order, waiting: _Waiting) -> bool:
        """Answer at once where that is asked, and by somebody who may."""
        ordered, query = waiting
        if order.verb != CLOCK or order.args or why_closed(self._fleet, ordered.console):
            return False
        answer = Answer(
            robot=self._robot,
            console=ordered.console,
            id=order.id,
            order=CLOCK,
            ok=True,
            arrived_ns=ordered.arrived_ns,
            sent_ns=self._clock(),
        )
        self._reply(query, answer)
        return True

    def _reply(self, query: Query, answer: Answer) -> None:
        key = topics.ORDER.format(fleet=self._fleet.fleet, robot=self._robot, console=answer.console)
        try:
            query.reply(Answer, key, encode(answer))
        except Exception as error:  # noqa: BLE001 - the asker is gone, or asked for what no reply may answer
            logger.warning("an order of %s could not be answered: %s", answer.console, str(error)[:200])
        finally:
            query.drop()


def _read(ordered: Ordered) -> Order | None:
    """None: it cannot be read, which the step answers."""
    with contextlib.suppress(Refusal):
        return decode(ordered.payload, Order, MAX_ORDER)
    return None


# --- liveliness tokens ---
# Who stands at the other ends of our links: two agents of one name, robots of another fleet, and robots of ours that
# our file lacks.
#
# Each agent shows a token with its fleet, its name and its session. Tokens reach those that are linked and nobody
# beyond, so two of one name do not see each other where no link joins them; a neighbour that sees both says so, by a
# token too. Nothing is believed or refused for it: people at the tank are told.

LASTING_S = 5.0  # a link that was lost keeps its token for as long as its lease, which is 2 s
SESSIONS = 4  # remembered of each name: two are one too many
FOREIGN = 4  # robots of other fleets, and of ours that our file lacks, that are remembered
SESSION = re.compile(r"[0-9a-f]{1,32}")

Announce = Callable[[str], Withdraw]  # a token's key -> how to take it back


class _Foreign(NamedTuple):
    fleet: str
    robot: str
    session: str


TWO, END_ONE = "two agents: two linked to us are called ", "; end one"


UNLISTED, ONE_FILE = "another file: ", " of our fleet is linked to us, and is not in our file; give all robots one file"


def called_twice(faults: Iterable[str]) -> set[str]:
    """Of which neighbours a robot with these faults is linked to two."""
    return _named(faults, TWO, END_ONE)


def unlisted(faults: Iterable[str]) -> set[str]:
    """Robots of its fleet that a robot with these faults is linked to, and that its file lacks."""
    return _named(faults, UNLISTED, ONE_FILE)


def _named(faults: Iterable[str], before: str, behind: str) -> set[str]:
    """The names that stand between these words in what somebody says of himself."""
    found = (fault.removeprefix(before).removesuffix(behind) for fault in faults if fault.startswith(before))
    return {name for name in found if NAME.fullmatch(name)}


class Tokens:
    """What tokens say, as far as it concerns one robot. `token` is called in Zenoh's threads, `faults` in the loop."""

    def __init__(self, fleet: Fleet, robot: str) -> None:
        self._fleet, self._robot, self._listed = fleet.fleet, robot, frozenset(fleet.robot)
        names = (robot, *fleet.robot[robot].neighbours)
        self._since_s: dict[str, dict[str, float]] = {name: {} for name in names}  # session -> when it was first seen
        self._foreign: set[_Foreign] = set()
        self._witnesses: set[str] = set()  # neighbours that see two of our name
        self._announced: dict[str, Withdraw] = {}  # neighbours that we see two of
        self._lock = threading.Lock()

    def token(self, sample: Sample, now_s: float) -> None:
        """An agent came or went, or a neighbour began or ceased to see two of one name."""
        if (seen := topics.chunks(topics.ALIVE, sample.key)) is not None:
            self._agent(seen["fleet"], seen["robot"], seen["session"], sample.is_put, now_s)
        elif (seen := topics.chunks(topics.TWICE, sample.key)) is not None and seen["robot"] == self._robot:
            with self._lock:
                if seen["witness"] not in self._since_s:
                    return
                (self._witnesses.add if sample.is_put else self._witnesses.discard)(seen["witness"])

    def faults(self, own_session: str, announce: Announce, now_s: float) -> tuple[str, ...]:
        """What is wrong now, each as "kind: what to do"; also tells neighbours of whom there are two. Never waits."""
        with self._lock:
            twice = [
                name for name, since_s in self._since_s.items() if self._lasting(name, since_s, own_session, now_s)
            ]
            witnesses, foreign = sorted(self._witnesses), sorted(self._foreign)
        self._tell(twice, announce)
        return (
            *(f"{TWO}{name}{END_ONE}" for name in twice if name != self._robot),
            *(
                f"two agents: another one called {name} is linked to us; end one"
                for name in twice
                if name == self._robot
            ),
            *(f"two agents: {name} is linked to two called {self._robot}; end one" for name in witnesses),
            *(
                f"another fleet: {robot} is of fleet {fleet}, not {self._fleet}; write one name in both fleet files"
                if fleet != self._fleet
                else f"{UNLISTED}{robot}{ONE_FILE}"
                for fleet, robot in dict.fromkeys((item.fleet, item.robot) for item in foreign)
            ),
        )

    def _agent(self, fleet: str, robot: str, session: str, came: bool, now_s: float) -> None:
        if not (NAME.fullmatch(fleet) and NAME.fullmatch(robot) and SESSION.fullmatch(session)):
            return
        with self._lock:
            if fleet != self._fleet or robot not in self._listed:
                item = _Foreign(fleet, robot, session)
                if not came:
                    self._foreign.discard(item)
                elif len(self._foreign) < FOREIGN:
                    self._foreign.add(item)
            elif (since_s := self._since_s.get(robot)) is not None:
                if not came:
                    since_s.pop(session, None)
                elif len(since_s) < SESSIONS:
                    since_s.setdefault(session, now_s)

    def _lasting(self, name: str, since_s: dict[str, float], own_session: str, now_s: float) -> bool:
        """Whether there have long been two of a name; of our own, ourselves are the first."""
        others = sorted(at_s for session, at_s in since_s.items() if session != own_session)
        second = 0 if name == self._robot else 1
        return len(others) > second and now_s - others[second] >= LASTING_S

    def _tell(self, twice: list[str], announce: Announce) -> None:
        for name in self._announced.keys() - set(twice):
            self._announced.pop(name)()
        for name in twice:
            if name != self._robot and name not in self._announced:
                self._announced[name] = announce(
                    topics.TWICE.format(fleet=self._fleet, robot=name, witness=self._robot)
                )


# --- links of strangers ---
# Who is linked to a robot of a secured fleet and has no business there: somebody with a certificate of our authority.
#
# The access rules believe them nothing and tell them nothing, and say so to nobody: people are told here.

LOOK_S = 1.0  # between two looks: one costs 0.01 ms with ten links
NAMED = 4


class Strangers:
    """`faults` is called in the loop, and looks once a second."""

    def __init__(self, fleet: Fleet, robot: str) -> None:
        access = fleet.access
        self._known = {*fleet.robot[robot].neighbours, *access.observers, *access.consoles} if fleet.secured else None
        self._robots = frozenset(fleet.robot)
        self._told: tuple[str, ...] = ()
        self._look_s: float | None = None

    def faults(self, links: Callable[[], Sequence[Link]], now_s: float) -> tuple[str, ...]:
        """What is wrong, as "kind: what to do", by the links that there are now; nothing in an open fleet."""
        if self._known is None or (self._look_s is not None and now_s - self._look_s < LOOK_S):
            return self._told
        self._look_s = now_s
        strangers = sorted({link.name or "somebody without a name" for link in links()} - self._known)
        self._told = tuple(f"stranger: {self._what(name)}" for name in strangers[:NAMED])
        return self._told

    def _what(self, name: str) -> str:
        linked = f"{name} is linked to us, is believed nothing and told nothing"
        if name in self._robots:
            return f"{linked}, for it is no neighbour; look who dials with its certificate, or whose file differs"
        return f"{linked}: its certificate is ours, its name in no fleet file; end it, or add the name to [access]"
