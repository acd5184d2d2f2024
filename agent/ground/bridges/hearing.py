"""What a robot says in its own name."""

from __future__ import annotations

from contextlib import suppress

from agent.core.codec import Refusal, decode
from agent.core.messages import Message
from agent.process.transport import Received


def own_word(received: Received) -> Message | None:
    """The message; None for what cannot be read, and for what says that it is of another than its key does."""
    topic = received.topic
    with suppress(Refusal):
        message = decode(received.payload, topic.message, topic.limit)
        if getattr(message, topic.writer) == received.chunks[topic.writer]:
            return message
    return None
