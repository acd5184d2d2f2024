"""What orders were answered, so that one that comes again is answered again and carried out once."""

from __future__ import annotations

from typing import NamedTuple

from agent.core.messages import Answer, Order
from agent.core.step_transaction import Revertible
from agent.robot.verbs import URGENT

ORDERS = 64  # of each console
CONSOLES = 16  # a fleet file names fewer; where everybody may order, the one that was silent for longest is forgotten


class Answered(NamedTuple):
    order: Order
    answer: Answer


class Memory(Revertible):
    """Of one robot, since its start; what came before that is refused by its State's incarnation."""

    def __init__(self) -> None:
        self._by_console: dict[str, dict[int, Answered]] = {}  # the one that ordered last stands last

    def again(self, console: str, order: Order) -> Answer | str:
        """The answer that the same order was given; else why it cannot be told from one that was; empty: it is new.

        A stop is never taken for another order, nor for one that is forgotten.
        """
        known = self._by_console.get(console, {})
        if (before := known.get(order.id)) is not None:
            same = (before.order.verb, before.order.args) == (order.verb, order.args)
            if same:
                return before.answer
            return "" if order.verb in URGENT else f"another order had this id, {order.id}; order again"
        if order.verb not in URGENT and len(known) >= ORDERS and order.id < min(known):
            return "it came after many later ones of the same console; order again"
        return ""

    def keep(self, console: str, order: Order, answer: Answer) -> None:
        known = self._by_console.pop(console, {})
        known[order.id] = Answered(order, answer)
        while len(known) > ORDERS:
            del known[min(known)]
        self._by_console[console] = known
        while len(self._by_console) > CONSOLES:
            del self._by_console[next(iter(self._by_console))]
