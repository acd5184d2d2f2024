"""The Zenoh session adapter: keys, bytes and integers pass it. No other file of ours imports zenoh.

What arrives is handed over in Zenoh's own threads. A callback does no more than stamp, judge and append: a slow one
holds up every other subscription of its session.
"""

from __future__ import annotations

import contextlib
import logging
import re
from collections.abc import Callable
from types import TracebackType
from typing import Any, NamedTuple, Self

import zenoh
from zenoh.handlers import Callback

from agent.core.codec import encoding
from agent.core.config import ConfigError
from agent.core.messages import Message
from agent.core.topics import Topic

logger = logging.getLogger(__name__)

PUT = zenoh.SampleKind.PUT

# What zenoh says when it cannot listen, and what a person can do about it.
REMEDIES = {
    "Address already in use": "the address is in use; end that process or take another port",
    "Cannot assign requested address": "no address of this computer; write one of its own",
    "failed to lookup address": "no such host; write the computer's address as a number",
}


class Sample:
    """What arrived, where it lies in Zenoh's memory: the payload is copied when it is asked for, and not before."""

    __slots__ = ("_sample",)

    def __init__(self, sample: zenoh.Sample) -> None:
        self._sample = sample

    @property
    def key(self) -> str:
        return str(self._sample.key_expr)

    @property
    def is_put(self) -> bool:
        """Whether something was published or a token appeared; False: something was deleted or a token went."""
        return bool(self._sample.kind == PUT)

    @property
    def encoding(self) -> str:
        return str(self._sample.encoding)

    @property
    def size(self) -> int:
        """Bytes of the payload."""
        return len(self._sample.payload)

    def payload(self) -> bytes:
        """A copy of the payload."""
        return self._sample.payload.to_bytes()


class Query:
    """What somebody asks. Whoever asked waits until it is dropped, or gives up: drop every one."""

    __slots__ = ("_query",)

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query

    @property
    def key(self) -> str:
        """What was asked for; it may have wildcards."""
        return str(self._query.key_expr)

    @property
    def encoding(self) -> str:
        return str(self._query.encoding)

    @property
    def size(self) -> int:
        """Bytes of the payload."""
        return 0 if self._query.payload is None else len(self._query.payload)

    def payload(self) -> bytes:
        """A copy of the payload."""
        return b"" if self._query.payload is None else self._query.payload.to_bytes()

    def reply(self, kind: type[Message], key: str, payload: bytes) -> None:
        """Answer under a key of one's own: access rules know no other."""
        self._query.reply(key, payload, encoding=encoding(kind))

    def refuse(self, why: str) -> None:
        """Answer that there is no answer."""
        self._query.reply_err(why)

    def drop(self) -> None:
        """Let go: whoever asked need not wait any longer."""
        self._query.drop()  # type: ignore[no-untyped-call]  # of zenoh's own stubs


class Link(NamedTuple):
    """One link of a session, to another one."""

    session: str  # of the other end
    address: str  # where it is: of one that we dialled, as it listens
    name: str  # common name of the other end's certificate; empty: it has shown none


class Reply(NamedTuple):
    """One of the answers to a question."""

    key: str  # empty: there is none
    payload: bytes
    error: str = ""  # why there is none


Arrived = Callable[[Sample], None]
Asked = Callable[[Query], None]
Publish = Callable[[bytes], None]
Withdraw = Callable[[], None]


def unusable(sample: Sample, topic: Topic, any_encoding: bool = False) -> str | None:
    """Why a sample cannot be a message of this topic, judged before its payload is copied; None if it can.

    `any_encoding`: it need not say that it is encoded as the topic's messages are.
    """
    if not sample.is_put:
        return "not a put"
    if not any_encoding and sample.encoding != encoding(topic.message):
        return "wrong encoding"
    if sample.size > topic.limit:
        return "too large"
    return None


class Session:
    """One process's part in the network. Context manager; leaving undoes all that was declared.

    Entering raises ConfigError, one line that starts with `where`, when Zenoh does not take the configuration or cannot
    listen where it says.
    """

    def __init__(self, config: str, where: str) -> None:
        """`config` is JSON text of router_config.settings; `where` names the process or its endpoint to a person."""
        self._config, self._where = config, where
        self._tokens: dict[str, Any] = {}
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        try:
            self._session = self._open.enter_context(zenoh.open(zenoh.Config.from_json5(self._config)))
        except zenoh.ZError as error:
            for sign, remedy in REMEDIES.items():
                if sign in str(error):
                    raise ConfigError(f"{self._where}: {remedy}") from None
            reason = " ".join(re.sub(r" at /\S+", "", str(error)).split())  # zenoh names the places in its own source
            raise ConfigError(f"{self._where}: zenoh cannot open it: {reason}") from None
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        try:
            self._open.close()
        except zenoh.ZError as failure:
            logger.warning("zenoh did not close cleanly: %s", failure)  # the process is ending: nothing is left to do

    def publisher(self, topic: Topic, key: str) -> Publish:
        """A function that sends a payload, with the topic's encoding and quality of service. It never blocks."""
        publisher = self._session.declare_publisher(
            key,
            encoding=encoding(topic.message),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=getattr(zenoh.Priority, topic.qos.priority),
            reliability=getattr(zenoh.Reliability, topic.qos.reliability),
        )
        return publisher.put

    def subscribe(self, key: str, arrived: Arrived) -> None:
        """Have `arrived` called with every sample of other processes on `key`, which may have wildcards."""
        self._session.declare_subscriber(key, _direct(arrived), allowed_origin=zenoh.Locality.REMOTE)

    def put(self, topic: Topic, key: str, payload: bytes) -> None:
        """Publish once, where there is no publisher: as publisher() does."""
        self._session.put(
            key,
            payload,
            encoding=encoding(topic.message),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=getattr(zenoh.Priority, topic.qos.priority),
        )

    def put_foreign(self, key: str, payload: bytes, attachment: bytes) -> None:
        """Publish once what is no message of ours, in somebody else's network."""
        self._session.put(key, payload, attachment=attachment or None, congestion_control=zenoh.CongestionControl.DROP)

    def answer(self, key: str, asked: Asked) -> None:
        """Have `asked` called with every query of other processes on `key`, which may have wildcards."""
        handler: Callback[zenoh.Query] = Callback(lambda query: asked(Query(query)), indirect=False)
        self._session.declare_queryable(key, handler, allowed_origin=zenoh.Locality.REMOTE)

    def ask(
        self,
        kind: type[Message],
        key: str,
        payload: bytes,
        timeout_s: float,
        replied: Callable[[Reply], None],
        over: Callable[[], None],
    ) -> None:
        """Ask everybody who answers on `key`. Each answer goes to `replied`, and when there are no more, `over` is
        called; both in Zenoh's thread, perhaps before this returns."""
        handler: Callback[zenoh.Reply] = Callback(lambda reply: replied(_reply(reply)), over, indirect=False)
        self._session.get(
            key,
            handler,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            congestion_control=zenoh.CongestionControl.BLOCK,
            timeout=timeout_s,
            payload=payload,
            encoding=encoding(kind),
        )

    @property
    def id(self) -> str:
        """What tells this session from all others: hexadecimal digits, 32 at most."""
        return str(self._session.zid())

    def announce(self, key: str) -> Withdraw:
        """Show a liveliness token for as long as the session is open, or until the function returned is called."""
        token = self._session.liveliness().declare_token(key)
        self._tokens[key] = token  # it goes when nobody holds it

        def withdraw() -> None:
            self._tokens.pop(key).undeclare()

        return withdraw

    def watch_tokens(self, key: str, arrived: Arrived) -> None:
        """Have `arrived` called with every token on `key` that is there, comes or goes."""
        self._session.liveliness().declare_subscriber(key, _direct(arrived), history=True)

    def links(self) -> tuple[Link, ...]:
        """The links that there are now."""
        return tuple(map(_link, self._session.info.links()))

    def watch_links(self, lost: Callable[[Link], None]) -> None:
        """Have `lost` called with every link that goes from now on, in zenoh's thread."""

        def event(changed: zenoh.LinkEvent) -> None:
            if changed.kind != PUT:
                lost(_link(changed.link))

        self._watch = self._session.info.declare_link_events_listener(Callback(event, indirect=False))

    def who_is_linked(self, timeout_s: float) -> tuple[bytes, ...]:
        """What each linked session says of itself and its own links, as JSON, where it shows that to us. Waits until
        all have answered, for `timeout_s` of the wall at most."""
        replies = self._session.get("@/*/peer", timeout=timeout_s)
        return tuple(reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None)


def _direct(arrived: Arrived) -> Callback[zenoh.Sample]:
    # Called in zenoh's own thread: a thread of Python's in between would stamp later, and keeps a process from ending.
    return Callback(lambda sample: arrived(Sample(sample)), indirect=False)


def _link(link: zenoh.Link) -> Link:
    return Link(str(link.zid), str(link.dst), link.auth_identifier or "")


def _reply(reply: zenoh.Reply) -> Reply:
    if reply.ok is not None:
        return Reply(str(reply.ok.key_expr), reply.ok.payload.to_bytes())
    why = b"" if reply.err is None else reply.err.payload.to_bytes()
    return Reply("", b"", why.decode(errors="replace"))
