"""The table of what is on the network: key, message, rate, QoS. No other file spells a key."""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal, NamedTuple

from agent.core.capability_messages import Claim, Keyframe, Light
from agent.core.messages import MAX_JPEG, MAX_PAYLOAD, Answer, Estimate, Image, LogLine, Message, Presence, State


class QoS(NamedTuple):
    priority: Literal["INTERACTIVE_HIGH", "DATA", "DATA_LOW"]
    reliability: Literal["RELIABLE", "BEST_EFFORT"]
    buffer: int  # samples kept for the reader, oldest dropped first


class Topic(NamedTuple):
    name: str
    key: str  # {fleet}, {src}, {robot} and so on are filled in; [..] is left off where there is nothing to fill in
    message: type[Message]
    hz: float  # nominal; 0: on events
    qos: QoS
    writer: str  # the chunk of the key that names the writer
    limit: int = MAX_PAYLOAD  # bytes of a message; larger ones are turned away unread


# Congestion control is DROP on every row: a put never blocks a control loop, the next message replaces a lost one.
# The target stands in the key of a fleet that has several, and is left off where there is only one.
# Of each neighbour and target the two newest links are kept: a message holds all that the ones before it held.
LINK = Topic(
    "link", "aucamp/{fleet}/link/{src}/{dst}[/{target}]", Estimate, 10.0, QoS("INTERACTIVE_HIGH", "RELIABLE", 2), "src"
)
# Of robots that swim: where each is. The newest replaces those before it.
NEAR = Topic(
    "near", "aucamp/{fleet}/near/{src}/{dst}", Presence, 10.0, QoS("INTERACTIVE_HIGH", "RELIABLE", 2), "src", limit=1024
)
# Of a survey. Where a robot looks next stands until it says another; each message lists all that it holds.
CLAIM = Topic(
    "claim", "aucamp/{fleet}/claim/{src}/{dst}", Claim, 2.0, QoS("DATA", "RELIABLE", 2), "src", limit=8 * 1024
)
# A keyframe goes to a neighbour once, and again where the claims of the neighbour show that it was lost.
KEYFRAME = Topic(
    "keyframe", "aucamp/{fleet}/keyframe/{src}/{dst}", Keyframe, 0.0, QoS("DATA", "RELIABLE", 2), "src", limit=2048
)
# Of a fleet with [lighting]: whose lamps burn. The newest replaces those before it. Twice as often about a sweep.
LIGHT = Topic(
    "light", "aucamp/{fleet}/light/{src}/{dst}", Light, 10.0, QoS("INTERACTIVE_HIGH", "RELIABLE", 2), "src", limit=1024
)
STATE = Topic(
    "state", "aucamp/{fleet}/robot/{robot}/state[/{target}]", State, 5.0, QoS("DATA", "RELIABLE", 64), "robot"
)
LOG = Topic("log", "aucamp/{fleet}/robot/{robot}/log", LogLine, 0.0, QoS("DATA", "RELIABLE", 256), "robot")
# Behind all else in a queue of its own: on a thin cable previews wait, and are lost, before a state is. The rate is
# `[link] preview_hz` at most, from whole frames alone.
IMAGE = Topic(
    "image",
    "aucamp/{fleet}/robot/{robot}/image",
    Image,
    0.0,
    QoS("DATA_LOW", "BEST_EFFORT", 4),
    "robot",
    limit=MAX_JPEG + 1024,
)
# What became of an order, for all but the console that gave it: that one has the same as the reply to its query.
ANSWER = Topic(
    "answer",
    "aucamp/{fleet}/robot/{robot}/answer/{console}",
    Answer,
    0.0,
    QoS("DATA", "RELIABLE", 64),
    "robot",
    limit=2048,
)

TOPICS = (LINK, NEAR, CLAIM, KEYFRAME, LIGHT, STATE, LOG, IMAGE, ANSWER)

# An order is a query, answered by each robot on this key with its own name; '*' as the robot is all of them.
ORDER = "aucamp/{fleet}/robot/{robot}/order/{console}"

# Liveliness tokens: they list robots, and never decide whose word counts. Two agents of one name differ in their
# sessions.
ALIVE = "aucamp/{fleet}/alive/{robot}/{session}"
TWICE = "aucamp/{fleet}/twice/{robot}/{witness}"  # the witness is linked to two of this name
ANYBODY = {"src": "*", "dst": "*", "robot": "*", "target": "**", "console": "*", "session": "*"}  # as chunks of a key
ALL = "aucamp/{fleet}/**"
EVERY_FLEET = "aucamp/**"


def key(topic: Topic, **chunks: str) -> str:
    """The key of one stream. '*' is allowed as a chunk, and '**' as the target: any target, or none in the key."""
    required, _, optional = topic.key.rstrip("]").partition("[")
    return (required + optional if "target" in chunks else required).format(**chunks)


def match(key_text: str) -> tuple[Topic, dict[str, str]] | None:
    """Which row a key belongs to and the values of its chunks; None for any other key."""
    parts = key_text.split("/")
    for topic in TOPICS:
        required, _, optional = topic.key.rstrip("]").partition("[")
        for pattern in (required, required + optional) if optional else (required,):
            chunks = _match(pattern.split("/"), parts)
            if chunks is not None:
                return topic, chunks
    return None


def chunks(pattern: str, key_text: str) -> dict[str, str] | None:
    """The values of the chunks of a token's or an order's key, of ALIVE, TWICE or ORDER; None for another key."""
    return _match(pattern.split("/"), key_text.split("/"))


def _match(pattern: list[str], parts: list[str]) -> dict[str, str] | None:
    if len(pattern) != len(parts):
        return None
    chunks: dict[str, str] = {}
    for want, got in zip(pattern, parts, strict=True):
        if want.startswith("{"):
            chunks[want[1:-1]] = got
        elif want != got:
            return None
    return chunks


def target_chunk(targets: Collection[str], target: str) -> dict[str, str]:
    """The chunk of a key that names the target, for `key`; empty in a fleet of one target."""
    return {"target": target} if len(targets) > 1 else {}


def next_due_ns(due_ns: int, period_ns: int, now_ns: int) -> int:
    """The next time on a period's grid, so that steps that come a little late do not lower the rate; a grid that is
    more than a period behind starts anew."""
    return due_ns + period_ns if now_ns - due_ns < period_ns else now_ns + period_ns
