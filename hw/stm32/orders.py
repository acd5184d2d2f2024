"""Orders to the control module under way: asked, sent, repeated, answered. No port, no clock, no thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future
from types import MappingProxyType
from typing import NamedTuple

from hw.firmware import parameters, wire

ATTEMPTS = 4  # without an answer; they reach 99.4 % at 15 % loss each way
REPEAT_AFTER_NS = 100_000_000
LIST_AFTER_NS = 500_000_000  # a whole list takes the board 200 ms
POLL_AFTER_NS = 500_000_000  # the board is at it, and said so; a tare takes 2 s

# Results beside those of the board, which are wire.RESULTS
NO_BOARD, NO_ANSWER, OVERTAKEN = "no board", "no answer", "overtaken by a stop"


class Outcome(NamedTuple):
    """What came of an order: result "ok", or why not; and the parameters that the answer brought, by name."""

    result: str
    values: Mapping[str, float] = MappingProxyType({})

    @property
    def ok(self) -> bool:
        return bool(self.result == wire.RESULTS[wire.OK])


class Order:
    """One order, and when it is to be said again."""

    def __init__(self, kind: int, fields: tuple[float, ...] = ()) -> None:
        self.kind, self.fields = kind, fields
        self.req_id = 0
        self.future: Future[Outcome] = Future()
        self.values: dict[str, float] = {}
        self.attempts_left = ATTEMPTS
        self.due_ns = 0

    def sent(self, now_ns: int) -> None:
        self.attempts_left -= 1
        self.due_ns = now_ns + (LIST_AFTER_NS if self.kind == wire.PARAM_LIST else REPEAT_AFTER_NS)

    def running(self, now_ns: int) -> None:
        if self.kind != wire.PARAM_LIST:  # whose values are its answer, and follow at once
            self.attempts_left = ATTEMPTS
            self.due_ns = now_ns + POLL_AFTER_NS

    def end(self, result: str) -> None:
        if self.future.set_running_or_notify_cancel():
            self.future.set_result(Outcome(result, MappingProxyType(self.values)))


class Orders:
    """One order is under way at a time, the others wait their turn."""

    def __init__(self) -> None:
        self.current: Order | None = None
        self._waiting: deque[Order] = deque()
        self._req_id = 0

    @property
    def idle(self) -> bool:
        return self.current is None and not self._waiting

    def ask(self, order: Order) -> Future[Outcome]:
        """Put an order at the end of the queue."""
        self._waiting.append(order)
        return order.future

    def overtake(self, order: Order) -> None:
        """Put an order before all others, which end here: a stop leaves nothing to be done."""
        self.drop(OVERTAKEN)
        self._begin(order)

    def drop(self, result: str) -> None:
        """End all orders with this result."""
        orders = [*([self.current] if self.current else []), *self._waiting]
        self.current = None
        self._waiting.clear()
        for order in orders:
            order.end(result)

    def due(self, now_ns: int, ready: bool) -> Order | None:
        """The order that it is time to say, new ones only if `ready`. One without an answer ends here."""
        if self.current is None and ready and self._waiting:
            self._begin(self._waiting.popleft())
        order = self.current
        if order is None or now_ns < order.due_ns:
            return None
        if order.attempts_left:
            order.sent(now_ns)
            return order
        self.current = None
        order.end(NO_ANSWER)
        return None

    def on_ack(self, req_id: int, kind: int, result: int, now_ns: int) -> Order | None:
        """Take an acknowledgement; the order that it ends, if it ends one."""
        order = self.current
        if order is None or (req_id, kind) != (order.req_id, order.kind):
            return None
        if result == wire.RUNNING:
            order.running(now_ns)
            return None
        if result == wire.STALE_BOOT and kind == wire.REBOOT:
            result = wire.OK  # its first answer was lost, and it has rebooted since
        return self._end(order, wire.RESULTS[min(result, len(wire.RESULTS) - 1)])

    def on_value(self, req_id: int, i: int, value: float) -> Order | None:
        """Take a parameter; the order that it ends, if it ends one."""
        order = self.current
        if order is None or req_id != order.req_id or i >= len(parameters.NAMES):
            return None
        order.values[parameters.NAMES[i]] = float(f"{value:.6g}")  # float32 makes 0.1 into 0.10000000149
        if order.kind == wire.PARAM_LIST and len(order.values) < len(parameters.NAMES):
            return None
        return self._end(order, wire.RESULTS[wire.OK])

    def _begin(self, order: Order) -> None:
        self._req_id = (self._req_id + 1) & 0xFFFF
        order.req_id = self._req_id
        self.current = order

    def _end(self, order: Order, result: str) -> Order:
        self.current = None
        order.end(result)
        return order
