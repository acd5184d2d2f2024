"""What is said between a console and a robot: an order, and the robot's answer to it.

An order is a query, so that whoever asks hears an answer or that there was none; who asks stands in its key, where
rules of access see it. Observers cannot see queries: the same answer is published as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from msgspec import Meta

from agent.core.messages import NUMBER, SCHEMA, SENT, Count, Id, Message, means

MAX_ORDER = 4096  # bytes; larger ones are turned away unread
MAX_WORDS = 200  # characters of an order in words

Arg = bool | int | float | str


class Order(Message, frozen=True, kw_only=True):
    """What somebody at a console wants of a robot. All values are absolute: heard twice is as heard once."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    id: Annotated[Count, means("counts the orders of this console, from the ns of its start on")]
    verb: Annotated[str, Meta(max_length=16), means("what to do: docs/orders.md")]
    args: Annotated[Mapping[str, Arg], Meta(max_length=16), means("how, by the names in docs/orders.md")] = {}
    seen: Annotated[
        tuple[Count, Count] | None,
        means("incarnation and sent_ns of the robot's State that was looked at; null: for what may come late"),
    ] = None


class Answer(Message, frozen=True, kw_only=True):
    """What became of an order, to whoever looks. The reply to the query is the same."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    robot: Annotated[Id, means("the robot that says it")]
    console: Annotated[str, Meta(max_length=16), means("who ordered, by the key of the order")]
    id: Annotated[Count, means("of the order; 0: it could not be read")]
    order: Annotated[str, Meta(max_length=MAX_WORDS), means("what was ordered, in words; empty: it could not be read")]
    ok: Annotated[bool, means("whether it is done, or under way")]
    why: Annotated[str, Meta(max_length=MAX_WORDS), means("why not, and what to do; or what is to be known beside")] = (
        ""
    )
    arrived_ns: Annotated[Count, means("when the order arrived: ns since the Unix epoch, by the robot's clock")]
    sent_ns: Annotated[Count, means(SENT)]
