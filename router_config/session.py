"""The Zenoh session adapter: keys, bytes and integers pass it. No other file of ours imports zenoh.

What arrives is handed over in Zenoh's own threads. A callback does no more than stamp, judge and append: a slow one
holds up every other subscription of its session.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import re
import socket
import stat
import struct
import termios
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, NamedTuple, Self

import zenoh
from zenoh.handlers import Callback

from agent.clock import machine
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
    """What somebody asks. The asker waits until it is dropped, or gives up: drop every one."""

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
        """Let go: the asker need not wait any longer."""
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
            config = zenoh.Config.from_json5(self._config)
            watchdog = LinkWatchdog(json.loads(self._config))
            self._open.callback(watchdog.end)  # last: it lets go of dials, for which Zenoh waits when it closes
            self._session = self._open.enter_context(zenoh.open(config))
            watchdog.start(self._session)
            self._open.callback(watchdog.hurry)
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


# --- links that heal ---
# Zenoh does not survive it when a time-out cuts off the making of a link between its start of writing and its start of
# reading: both ends list the link, and one reads nothing, for good, since it is the reader who would notice. So Zenoh's
# own time-outs are long enough never to come, and a dial that comes to nothing is ended by its socket, as is a link
# that is not read.

LOOK_S = 0.25
DIAL_LOOKS = 8  # 2 s: what is no link by then is ended; it is dialled again within a second
UNREAD_LOOKS = 6  # 1.5 s in which something waits and nothing is read; the other end says four times in 2 s that it is
UNREAD = "has a link with us that is not read"
# Zenoh has close() wait up to 10 s for what is unsent, in one of its two threads that read all links: where three peers
# vanish at once, nobody hears those that are left, nor a stop. Off, the system sends what is unsent by itself.
NOT_WAITED_FOR = struct.pack("ii", 0, 0)
HURRY_S = 0.02  # between looks while the session closes
LOCATOR = re.compile(r"t(?:cp|ls)/(?:\[([^]%]+)[^]]*]|([^:\[]+)):(\d+)")
# Of linux: the number of an option, where bytes received stand in struct tcp_info, where an address does in
# sockaddr_in and sockaddr_in6, and how long these are.
SO_PEERNAME, TCP_BYTES_RECEIVED = 28, 128
ADDRESSES = {socket.AF_INET: (slice(4, 8), 16), socket.AF_INET6: (slice(8, 24), 28)}

End = tuple[str, int]  # address and port
Ends = tuple[End | None, End | None]  # ours and theirs


class LinkWatchdog:
    """Ends dials that become no link and links that are not read, of one session. What other sessions of the process
    have as a link is none of its business.

    It counts looks and no time, so a process that was stopped begins where it was.
    """

    _started: ClassVar[set[LinkWatchdog]] = set()  # of all sessions of the process

    def __init__(self, config: dict[str, Any]) -> None:
        places = (config.get(part, {}).get("endpoints", ()) for part in ("listen", "connect"))
        self._listens, self._dials = ({end[1] for end in map(_end, part) if end} for part in places)
        self._looks: dict[tuple[Ends, str], int] = {}  # a connection and how far it was read -> looks that found it so
        self._links: frozenset[Ends] = frozenset()
        self._hurries, self._ends = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="link watchdog", daemon=True)

    def start(self, session: zenoh.Session) -> None:
        self._session = session
        self._started.add(self)
        self._thread.start()

    def hurry(self) -> None:
        """The session is about to close: what is no link yet is not to become one."""
        self.links()
        self._hurries.set()

    def end(self) -> None:
        self._ends.set()
        if self in self._started:
            self._thread.join()
            self._started.remove(self)

    def links(self) -> frozenset[Ends]:
        """What the session lists, or listed before it began to close."""
        if not self._hurries.is_set():
            self._links = frozenset((_end(str(link.src)), _end(str(link.dst))) for link in self._session.info.links())
        return self._links

    def _run(self) -> None:
        while not machine.wait(self._ends, HURRY_S if self._hurries.is_set() else LOOK_S):
            try:
                self._look()
            except (OSError, zenoh.ZError) as error:
                logger.info("links could not be looked at: %s", error)  # another session closes: next time

    def _look(self) -> None:
        own = self.links()
        others = frozenset[Ends]().union(*(one.links() for one in set(self._started)))
        before, self._looks = self._looks, {}
        for connection, ends in _connections():
            if ends in own:
                with contextlib.suppress(OSError):  # it has just gone
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, NOT_WAITED_FOR)
                state, most = _unread(connection), UNREAD_LOOKS
            elif ends not in others and (ends[0][1] in self._listens or ends[1][1] in self._dials):
                # What we did not accept, and goes on reading, is a link of somebody else's session in this process.
                read = "" if ends[0][1] in self._listens else f", read to {_read(connection)[1]}"
                state, most = f"no link{read}", 0 if self._hurries.is_set() else DIAL_LOOKS
            else:
                continue
            looks = before.get((ends, state), 0) + 1
            if state and looks <= most:
                self._looks[ends, state] = looks
            elif state:
                with contextlib.suppress(OSError):  # it has just gone
                    connection.shutdown(socket.SHUT_RDWR)
                if ends in own:
                    logger.warning("%s:%d %s; it is ended, and made anew", *ends[1], UNREAD)


def _connections() -> Iterator[tuple[socket.socket, tuple[End, End]]]:
    """Each TCP connection of this process, those that are being dialled too, for as long as it is looked at."""
    for entry in Path("/proc/self/fd").iterdir():
        try:
            if not stat.S_ISSOCK(os.fstat(int(entry.name)).st_mode):
                continue  # of a file not even a copy may be closed: its locks would go
            connection = socket.socket(fileno=os.dup(int(entry.name)))
        except OSError:  # closed meanwhile
            continue
        with connection, contextlib.suppress(OSError):  # one that listens has no other end
            if connection.type == socket.SOCK_STREAM and connection.family in ADDRESSES:
                host, port = connection.getsockname()[:2]
                yield connection, ((host.partition("%")[0], port), _peer(connection))


def _unread(connection: socket.socket) -> str:
    """How far it was read, where something waits to be read; else empty."""
    waits, read = _read(connection)
    return f"read to {read}" if waits else ""


def _read(connection: socket.socket) -> tuple[int, int]:
    """How many bytes wait to be read, and how many were."""
    (waits,) = struct.unpack("i", fcntl.ioctl(connection, termios.FIONREAD, bytes(4)))
    told = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_BYTES_RECEIVED + 8)
    return waits, struct.unpack_from("Q", told, TCP_BYTES_RECEIVED)[0] - waits


def _peer(connection: socket.socket) -> End:
    """The other end, which getpeername() would not tell of a dial that is under way."""
    address, size = ADDRESSES[connection.family]
    raw = connection.getsockopt(socket.SOL_SOCKET, SO_PEERNAME, size)
    return socket.inet_ntop(connection.family, raw[address]), int.from_bytes(raw[2:4], "big")


def _end(locator: str) -> End | None:
    """tcp/HOST:PORT or tls/[HOST]:PORT, as Zenoh writes a link's; None: it is no TCP."""
    if (found := LOCATOR.match(locator)) is None:
        return None
    return found[1] or found[2], int(found[3])
