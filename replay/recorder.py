"""The fleet recorder: what is on the network of a fleet, as the bytes came, in the order they reached this process.

It is an overview. What one robot knew and when is in that robot's own black box.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import zenoh

from agent import topics
from agent.config import ConfigError, Fleet, dump
from agent.messages import SCHEMA, Refusal, decode
from agent.session import observer_config
from replay.backlog import Backlog, Entry
from replay.derive import Derive
from replay.environment import environment
from replay.leftovers import leftovers, mending
from replay.log import Limits, LogWriter, drop_note, unused

logger = logging.getLogger(__name__)

PERIOD_S = 0.1  # how often arrivals are decoded and handed to the writer
SILENCE_S = 3.0  # robots publish five times a second: by now something should have come
BACKLOG_MESSAGES = 8192
BACKLOG_BYTES = 16 * 1024 * 1024


def record(
    fleet: Fleet,
    out: Path,
    stop: threading.Event,
    warn: Callable[[str], None] = logger.warning,
    views: bool = True,
    limits: Limits = Limits(),  # noqa: B008 - a NamedTuple cannot change
) -> dict[str, int]:
    """Record into `out` until `stop` is set; returns messages per row of the table, and what was not recorded.

    Where a recording of that name was torn, it is mended meanwhile and the new one is NAME.2.mcap.
    Log times are Unix time that never steps back: sampled once, then monotonic. `warn` takes one line for a person,
    `views` adds channels for viewers. Raises ConfigError if the file cannot be written, or no longer, as on a disk that
    has become full, and if no session can be opened.
    """
    offset_ns = time.time_ns() - time.monotonic_ns()

    def clock() -> int:
        return offset_ns + time.monotonic_ns()

    counts = dict.fromkeys([*(row.name for row in topics.TOPICS), "alive", "not decoded", "overrun"], 0)
    started_ns = clock()
    ear = Ear(clock)
    warned = False
    torn = leftovers(out)
    if torn and not out.exists():
        out = unused(out)  # a recorder that was killed goes on; what was finished on purpose is not added to
        warn(f"its last recording was not finished, so this one is {out}")
    log = LogWriter(out, facts(fleet), {"fleet.toml": dump(fleet)}, limits, derive=Derive(fleet) if views else None)
    with log, mending(torn, warn), listening(fleet, ear, "recorder"):
        while not stop.wait(PERIOD_S):
            for entry in taken(ear, counts):
                log.put(entry)
            if log.failed:
                raise ConfigError(f"{out}: recording stopped: {log.failed}")
            if not warned and not any(counts.values()) and clock() - started_ns > SILENCE_S * 1e9:
                warned = True
                warn(f"nothing heard from fleet '{fleet.fleet}' in {SILENCE_S:.0f} s: no robot up, or another fleet")
        for entry in taken(ear, counts):
            log.put(entry)
    return {**counts, **ear.refused}


def facts(fleet: Fleet) -> dict[str, str]:
    """What a reader of the recording needs to know about the run."""
    return {
        "kind": "fleet",
        "fleet": fleet.fleet,
        "protocol": fleet.estimation.protocol,
        "seed": str(fleet.twin.seed),
        "schema": str(SCHEMA),
        **environment(),
    }


class Ear:
    """Called in Zenoh's threads: stamps, and appends or counts. All else is done when the backlog is taken."""

    def __init__(self, clock: Callable[[], int]) -> None:
        self.backlog = Backlog(BACKLOG_MESSAGES, BACKLOG_BYTES)
        self.refused: Counter[str] = Counter()
        self._clock = clock
        self._lock = threading.Lock()  # guards the counts: Zenoh has a thread per link

    def message(self, row: topics.Topic, sample: zenoh.Sample) -> None:
        if sample.kind != zenoh.SampleKind.PUT:
            self._refuse("not a put")
        elif len(sample.payload) > row.limit:
            self._refuse("too large")
        else:
            data, metadata = sample.payload.to_bytes(), {"encoding": str(sample.encoding)}
            self._put(sample, data, "msgpack", metadata, expendable=row is topics.IMAGE)

    def stranger(self, sample: zenoh.Sample) -> None:
        if topics.match(str(sample.key_expr)) is None:  # the others come through their own row as well
            self._refuse("unknown key")

    def token(self, sample: zenoh.Sample) -> None:
        alive = sample.kind == zenoh.SampleKind.PUT
        self._put(sample, b'{"alive":true}' if alive else b'{"alive":false}', "json", {})

    def _put(
        self, sample: zenoh.Sample, data: bytes, encoding: str, metadata: dict[str, str], expendable: bool = False
    ) -> None:
        at_ns = self._clock()
        self.backlog.put(Entry(str(sample.key_expr), at_ns, at_ns, 0, data, encoding, metadata, None, expendable))

    def _refuse(self, reason: str) -> None:
        with self._lock:
            self.refused[reason] += 1


@contextmanager
def listening(fleet: Fleet, ear: Ear, name: str) -> Iterator[None]:
    """A session called `name` that hears every robot of a fleet. Raises ConfigError if it cannot be opened.

    Subscribed row by row, so that a row that stays mute is seen to be; and to everything, for keys of nobody.
    """

    def handler(called: Callable[[zenoh.Sample], None]) -> zenoh.handlers.Callback[zenoh.Sample]:
        return zenoh.handlers.Callback(called, indirect=False)  # in Zenoh's thread: the stamp is the arrival

    try:
        session = zenoh.open(zenoh.Config.from_json5(observer_config(fleet, name)))
    except zenoh.ZError as error:
        raise ConfigError(f"fleet '{fleet.fleet}': zenoh cannot open a session: {error}") from None
    anyone = {"fleet": fleet.fleet, "src": "*", "dst": "*", "robot": "*", "target": "**"}
    with session:
        for row in topics.TOPICS:
            session.declare_subscriber(topics.key(row, **anyone), handler(partial(ear.message, row)))
        session.declare_subscriber(topics.ALL.format(**anyone), handler(ear.stranger))
        session.liveliness().declare_subscriber(topics.ALIVE.format(**anyone), handler(ear.token), history=True)
        yield


def taken(ear: Ear, counts: dict[str, int]) -> Iterator[Entry]:
    """What arrived, as entries of a fleet file: bytes unchanged, the sender's time and number where they decode."""
    entries, drops = ear.backlog.take()
    for key, drop in drops.items():
        counts["overrun"] += drop.messages
        yield drop_note(f"/zenoh/{key}", drop)
    for entry in entries:
        row = topics.match(entry.channel)
        counts[row[0].name if row else "alive"] += 1
        publish_ns, sequence, metadata = entry.log_time_ns, 0, entry.metadata
        if row:
            metadata = {"schema": f"aucamp.{row[0].message.__name__}", **metadata}
            try:
                message = decode(entry.data, row[0].message, row[0].limit)
                publish_ns = getattr(message, "sent_ns", publish_ns)
                sequence = getattr(message, "seq", 0)
            except Refusal:
                counts["not decoded"] += 1
        yield entry._replace(
            channel=f"/zenoh/{entry.channel}", publish_time_ns=publish_ns, sequence=sequence, metadata=metadata
        )
