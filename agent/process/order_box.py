"""Orders between two steps: queries are kept until the step that took them has been recorded, and then answered.

Zenoh's threads only judge a query by its outside and keep it. One is answered there, at once: it asks what time it is,
and whoever compares clocks wants no step in between.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections import Counter, deque
from collections.abc import Callable, Sequence

from agent.core import topics
from agent.core.codec import Refusal, decode, encode, encoding
from agent.core.config import Fleet
from agent.core.messages import MAX_ORDER, Answer, Order
from agent.core.step_io import Ordered
from agent.robot.rights import CONSOLE, why_closed
from agent.robot.verbs import CLOCK
from router_config.door import Query

logger = logging.getLogger(__name__)

WAITING = 16  # of one console
ALL_WAITING = 64


class OrderBox:
    """Of one robot; filled by Zenoh's threads and emptied by the loop."""

    def __init__(self, fleet: Fleet, robot: str, clock: Callable[[], int]) -> None:
        self._fleet, self._robot, self._clock = fleet, robot, clock
        self._waiting: deque[tuple[Ordered, Query]] = deque()
        self._held: list[tuple[Ordered, Query]] = []  # those of the step under way
        self._refused: Counter[str] = Counter()
        self._lock = threading.Lock()  # guards `_waiting` and `_refused`: Zenoh has a thread per link

    def asked(self, query: Query) -> None:
        """Keep an order, or turn it away."""
        at_ns = self._clock()
        who = topics.chunks(topics.ORDER, query.key)
        console = "" if who is None else who["console"]
        why = self._unusable(query, console)
        if why is None:
            ordered = Ordered(arrived_ns=at_ns, console=console, payload=query.payload())
            if self._says_time(ordered, query):
                return
            why = self._keep(ordered, query)
        if why is not None:
            with self._lock:
                self._refused[why] += 1
            with contextlib.suppress(Exception):  # whoever asked is gone
                query.refuse(why)
            query.drop()

    def take(self) -> tuple[Ordered, ...]:
        """What arrived since the last call. Who was not answered since then will not be."""
        self.drop()
        with self._lock:
            self._held = list(self._waiting)
            self._waiting.clear()
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
        if CONSOLE.fullmatch(console) is None:
            return "order of nobody"
        if query.encoding != encoding(Order):
            return "order in a wrong encoding"
        return "order too large" if query.size > MAX_ORDER else None

    def _keep(self, ordered: Ordered, query: Query) -> str | None:
        """Why it is turned away; None: it is kept."""
        with self._lock:
            own = sum(waiting.console == ordered.console for waiting, _ in self._waiting)
            if own >= WAITING or len(self._waiting) >= ALL_WAITING:
                return "too many orders at once"
            self._waiting.append((ordered, query))
        return None

    def _says_time(self, ordered: Ordered, query: Query) -> bool:
        """Answer at once where that is asked, and by somebody who may."""
        try:
            order = decode(ordered.payload, Order, MAX_ORDER)
        except Refusal:
            return False
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
        except Exception as error:  # noqa: BLE001 - whoever asked is gone, or asked for what no reply may answer
            logger.warning("an order of %s could not be answered: %s", answer.console, str(error)[:200])
        finally:
            query.drop()
