"""Recordings as they are written: the fleet recorder's, of what is on the network of a fleet, as the bytes came, in the
order they reached this process; and an agent's black box. With the recorder come the presence monitor, and the same
traffic live in Foxglove.

What the fleet recorder keeps is an overview. What one robot knew and when is in that robot's own black box.
"""

from __future__ import annotations

import json
import logging
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.clock import machine
from agent.clock.clock import Clock
from agent.core import topics
from agent.core.codec import Refusal, decode, encode, printable
from agent.core.config import ConfigError, Fleet, dump, to_install
from agent.core.messages import SCHEMA, LogLine
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import Sighting
from agent.core.topics import Topic
from replay.files import channels
from replay.files.channels import NETWORK, PRESENCE, Backlog, Entry, entry_on, name
from replay.files.frames import WHOLE_EVERY, frame_entries, part_of
from replay.files.info import RateNotes
from replay.files.log import Limits, LogWriter, drop_note, parts, unused
from replay.files.mcap_file import environment
from replay.files.recover import broken_off, recovering, torn_files
from replay.viewers.layout import foxglove_layout, shipped
from replay.viewers.viewer_channels import MeasureDepth, ViewerChannels
from router_config.session import Sample, Session, unusable
from router_config.settings import observer_config

# --- presence monitor ---
# Who of a fleet is heard and who is not, for a person who waits for it: said once, and again when it changes.

SILENCE_S = 3.0  # of the wall: a fleet's own clock stands while there is no twin. Links are up within one
NAMED = 5  # robots in a line


class RollCall:
    """`look` is given the names of all who were heard so far, and of all whom these speak to, again and again; `say`
    gets a line for a person."""

    def __init__(self, fleet: Fleet, say: Callable[[str], None]) -> None:
        self._fleet, self._say = fleet, say
        self._told: frozenset[str] | None = None  # who was heard when it was last said; None: too early to tell
        self._lacking: set[str] = set()  # robots that the fleet file lacks, which was said
        self._until_s = machine.monotonic_s() + SILENCE_S

    def look(self, heard: Collection[str], spoken_to: Collection[str] = ()) -> None:
        """Say after a while who is missing, and then who has come for the first time; and whom the file lacks."""
        for robot in sorted({*heard, *spoken_to} - self._fleet.robot.keys() - self._lacking):
            if len(self._lacking) < NAMED:  # anybody can make names up
                what = "give the fleet file that the agents were started with"
                self._say(f"{printable(robot)[:40]} is of this fleet, and its file lacks it; {what}")
                self._lacking.add(robot)
        now = frozenset(self._fleet.robot).intersection(heard)
        if self._told is None:
            if machine.monotonic_s() >= self._until_s:
                self._told = now
                if line := self._first_line():
                    self._say(line)
        elif new := now - self._told:
            self._told = now
            missing = f"; still not heard: {self._where(self._missing())}" if self._missing() else "; that is all"
            self._say(f"{', '.join(sorted(new))} is heard now{missing}")

    def end(self) -> None:
        """Say who is still missing."""
        if self._told is not None and self._missing():
            self._say(f"never heard: {self._where(self._missing())}")

    def _missing(self) -> list[str]:
        return [name for name in self._fleet.robot if name not in (self._told or ())]

    def _first_line(self) -> str | None:
        if not self._missing():
            return None
        where = self._where(self._missing())
        if not self._told:
            return (
                f"nobody of fleet '{self._fleet.fleet}' is heard yet: {where}; start the agents, or give the fleet "
                f"file that they were started with"
            )
        return f"not heard yet: {where}; start it with aucamp agent, or correct its address in the fleet file"

    def _where(self, names: Iterable[str]) -> str:
        said = [f"{name} at {self._fleet.robot[name].listen}" for name in names]
        return ", ".join(said if len(said) <= NAMED else [*said[:NAMED], f"{len(said) - NAMED} more"])


# --- the fleet recorder ---

logger = logging.getLogger(__name__)

CHANNELS = 16_384  # keys that are recorded: a mesh of 64 robots has 4,200, and a file can number 65,535 channels
PERIOD_S = 0.1  # how often arrivals are decoded and handed to the writer
GIVEN_UP_S = 60.0  # a disk that takes nothing for so long will not: the starter of this has to know
BACKLOG_MESSAGES = 8192
BACKLOG_BYTES = 16 * 1024 * 1024


def record(
    fleet: Fleet,
    out: Path,
    stop: threading.Event,
    clock: Clock,
    warn: Callable[[str], None] = logger.warning,
    views: bool = True,
    limits: Limits = Limits(),  # noqa: B008 - a NamedTuple cannot change
    keys: Path | None = None,
    name: str = "recorder",
) -> dict[str, int]:
    """Record into `out` until `stop` is set; returns messages per topic, and what was not recorded by reason.

    Where a recording of that name was torn, it is mended meanwhile and the new one is NAME.2.mcap. Where nothing at all
    was heard, no file is left. Log times are the clock's. `warn` takes lines for a person, one at a time, `views` adds
    channels for viewers, `keys` is the folder of a secured fleet's certificates, where `name` has one. Raises
    ConfigError if the file cannot be written, or no longer, as on a disk that has become full, and if no session can be
    opened. What no message of a fleet may do is counted, and recorded.
    """
    arrivals, rate, roll = Arrivals(clock.now_ns), RateNotes(clock), RollCall(fleet, warn)
    stuck = False
    torn = torn_files(out)
    if broken_off(out):
        out = unused(out)  # a recorder that was killed goes on; what was finished on purpose is not added to
        warn(f"its last recording was not finished, so this one is {out}")
    log = LogWriter(
        out, facts(fleet), {"fleet.toml": dump(fleet)}, limits, derive=ViewerChannels(fleet) if views else None
    )
    with log, recovering(torn, warn), receiving(fleet, arrivals, name, keys):
        while not machine.wait(stop, PERIOD_S):
            for entry in (*arrivals.drain(), *rate.due()):
                log.put(entry)
            log.at_end["not_recorded"] = arrivals.not_recorded()
            if log.failed or log.stuck_s > GIVEN_UP_S:
                raise ConfigError(f"{out}: recording stopped: {log.fault}")
            if stuck is not (stuck := log.fault is not None):
                warn(f"{out}: {log.fault or 'the disk answers again; info says what was lost'}")
            roll.look(arrivals.robots, arrivals.spoken_to)
        for entry in arrivals.drain():
            log.put(entry)
        log.at_end["not_recorded"] = arrivals.not_recorded()
    if log.failed:  # on the way out
        raise ConfigError(f"{out}: recording stopped: {log.failed}")
    if log.fault:
        raise ConfigError(f"{out}: not all was recorded: {log.fault}")
    counts = {**arrivals.counts, **arrivals.refused, **arrivals.raised}
    if any(counts.values()):
        roll.end()
    else:
        for file in parts(log.path):
            file.unlink()
    return counts


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


class Arrivals:
    """What reached this process: stamped and queued in Zenoh's threads, all else is done when the queue is drained."""

    def __init__(self, clock: Callable[[], int]) -> None:
        """`clock` gives Unix nanoseconds that never step back."""
        self.counts = dict.fromkeys([*(topic.name for topic in topics.TOPICS), "alive", "not decoded", "overrun"], 0)
        self.refused: Counter[str] = Counter()  # what is in no file, by reason
        self.raised: Counter[str] = Counter()  # messages that made trouble, by kind; their bytes are recorded
        self.robots: set[str] = set()  # that were heard, or came and went
        self.spoken_to: set[str] = set()  # by those
        self._backlog = Backlog(BACKLOG_MESSAGES, BACKLOG_BYTES)
        self._clock = clock
        self._keys: set[str] = set()
        self._lock = threading.Lock()  # guards `refused` and `_keys`: Zenoh has a thread per link

    def message(self, topic: Topic, sample: Sample) -> None:
        """Queue a message of a topic, also one that says another encoding, which is kept with it."""
        at_ns = self._clock()
        reason = unusable(sample, topic, any_encoding=True) or self._too_many(sample.key)
        if reason:
            self._refuse(reason)
        else:
            data, about = sample.payload(), {"encoding": sample.encoding}
            self._put(sample.key, at_ns, data, NETWORK.encoding, about, expendable=topic is topics.IMAGE)

    def stranger(self, sample: Sample) -> None:
        """Count a message on a key of nobody; the others come through their own topic as well."""
        if topics.match(sample.key) is None:
            self._refuse("unknown key")

    def token(self, sample: Sample) -> None:
        """Queue that a robot came or went."""
        at_ns = self._clock()
        data = b'{"alive":true}' if sample.is_put else b'{"alive":false}'
        key = sample.key.rpartition("/")[0]  # without the session
        if reason := self._too_many(key):
            self._refuse(reason)
        else:
            self._put(key, at_ns, data, PRESENCE.encoding, {})

    def drain(self) -> Iterator[Entry]:
        """Entries of a fleet file for what arrived since the last call: the sender's bytes, time and number."""
        entries, drops = self._backlog.take()
        for key, drop in drops.items():
            self.counts["overrun"] += drop.messages
            yield drop_note(name(NETWORK, key=key), drop)
        for entry in entries:
            row = topics.match(entry.channel)
            self.counts[row[0].name if row else "alive"] += 1
            self.robots.add(row[1][row[0].writer] if row else entry.channel.rpartition("/")[2])
            if row is not None and "dst" in row[1]:
                self.spoken_to.add(row[1]["dst"])
            yield self._decoded(entry, row[0] if row else None)._replace(channel=name(NETWORK, key=entry.channel))

    def _decoded(self, entry: Entry, topic: Topic | None) -> Entry:
        """The entry with the sender's time and number, where it decodes."""
        if topic is None:
            return entry
        schema = NETWORK.schema.format(message=topic.message.__name__)
        entry = entry._replace(metadata={"schema": schema, **entry.metadata})
        try:
            message = decode(entry.data, topic.message, topic.limit)
        except Refusal:
            self.counts["not decoded"] += 1
            return entry
        except Exception as error:  # noqa: BLE001 - its bytes are recorded, whatever it does to who looks into them
            self.counts["not decoded"] += 1
            self.trouble(entry.channel, error)
            return entry
        sent_ns, number = getattr(message, "sent_ns", entry.log_time_ns), getattr(message, "seq", 0)
        return entry._replace(publish_time_ns=sent_ns, sequence=number)

    def trouble(self, key: str, error: Exception) -> None:
        """Count what a message did that none should be able to; the log has the first of each kind."""
        kind = f"raised {type(error).__name__}"
        self.raised[kind] += 1
        if self.raised[kind] == 1:
            logger.warning("a message on %s %s: %s", key, kind, str(error)[:200])

    def not_recorded(self) -> str:
        """What is in no file, and what made trouble, by reason: JSON."""
        with self._lock:
            return json.dumps({**self.refused, "overrun": self.counts["overrun"], **self.raised})

    def _too_many(self, key: str) -> str | None:
        with self._lock:
            if key in self._keys or len(self._keys) < CHANNELS:
                self._keys.add(key)
                return None
        return "too many keys"

    def _put(
        self, key: str, at_ns: int, data: bytes, encoding: str, about: dict[str, str], expendable: bool = False
    ) -> None:
        self._backlog.put(Entry(key, at_ns, at_ns, 0, data, encoding, about, None, expendable))

    def _refuse(self, reason: str) -> None:
        with self._lock:
            self.refused[reason] += 1


@contextmanager
def receiving(fleet: Fleet, arrivals: Arrivals, process: str, keys: Path | None = None) -> Iterator[None]:
    """Subscribe to every robot of a fleet, as `process`. Raises ConfigError if no session can be opened.

    Topic by topic, so that one that stays mute is seen to be; and to everything, for keys of nobody. `keys`:
    the folder of a secured fleet's certificates, that of `process` among them.
    """
    anyone = {"fleet": fleet.fleet, **topics.ANYBODY}
    with Session(observer_config(fleet, process, keys), f"fleet '{fleet.fleet}'") as session:
        for topic in topics.TOPICS:
            session.subscribe(topics.key(topic, **anyone), partial(arrivals.message, topic))
        session.subscribe(topics.ALL.format(**anyone), arrivals.stranger)
        session.watch_tokens(topics.ALIVE.format(**anyone), arrivals.token)
        yield


# --- a fleet live in Foxglove ---
# The fleet live in Foxglove: the viewer channels of a recording, over a WebSocket on this machine alone.
#
# Only what robots show on the network is there, previews of their cameras included; the frames themselves stay on the
# robots' own computers, in their black boxes.

HOST = "127.0.0.1"  # who can reach the port sees everything: other hosts come through ssh -L
PORT = 8765  # Foxglove's own


def view(
    fleet: Fleet,
    stop: threading.Event,
    clock: Clock,
    port: int = PORT,
    say: Callable[[str], None] = lambda line: None,
    keys: Path | None = None,
) -> None:
    """Serve until `stop` is set. Raises ConfigError without the extra `view`, or if the port is taken.

    `say` gets lines for a person: where to look, and who is not heard. `keys`: the folder of a secured fleet's
    certificates.
    """
    try:
        import foxglove  # the SDK, an extra; our own module of that name is replay.viewers.foxglove
    except ImportError:
        raise ConfigError(f"the live view needs the extra `view`; {to_install('view')}") from None
    arrivals, rate, derive = Arrivals(clock.now_ns), RateNotes(clock), ViewerChannels(fleet)
    context = foxglove.Context()
    channels: dict[str, Any] = {}

    def show(entry: Entry) -> None:
        if entry.channel not in channels and len(channels) == CHANNELS:
            raise ValueError("too many channels")
        if entry.channel not in channels and entry.schema is not None:
            schema = foxglove.Schema(**entry.schema._asdict())
            channels[entry.channel] = foxglove.Channel(
                entry.channel, schema=schema, message_encoding=entry.encoding, context=context
            )
        channels[entry.channel].log(entry.data, log_time=entry.log_time_ns)

    with receiving(fleet, arrivals, "view", keys):
        try:
            server = foxglove.start_server(name=f"aucamp {fleet.fleet}", host=HOST, port=port, context=context)
        except RuntimeError as error:
            raise ConfigError(f"port {port} of {HOST}: {error}; choose another with --port") from None
        try:
            say(f"open a connection to ws://{HOST}:{port} in Foxglove; {where_the_layout_is(fleet)}; Ctrl-C ends it")
            roll = RollCall(fleet, say)
            while not machine.wait(stop, PERIOD_S):
                for entry in (*arrivals.drain(), *rate.due()):
                    show_all_of(entry, derive, show, arrivals.trouble)
                roll.look(arrivals.robots, arrivals.spoken_to)
            roll.end()
            if arrivals.raised:
                say(f"not shown: {', '.join(f'{count} messages {kind}' for kind, count in arrivals.raised.items())}")
        finally:
            server.stop()


def show_all_of(
    entry: Entry,
    derive: Callable[[Entry], Iterable[Entry]],
    show: Callable[[Entry], None],
    trouble: Callable[[str, Exception], None],
) -> None:
    """Show what follows from one message. Where it raises, `trouble` is told, and the next one is shown as ever."""
    try:
        for derived in derive(entry):
            show(derived)
    except Exception as error:  # noqa: BLE001 - whatever a message does, the view goes on
        trouble(entry.channel, error)


def where_the_layout_is(fleet: Fleet) -> str:
    """Words for a person: the one that comes with us, if it fits the fleet."""
    path = shipped("foxglove.json")
    if json.loads(path.read_text(encoding="utf-8")) == foxglove_layout(fleet):
        return f"the layout is {path}"
    return "`aucamp replay layout` writes a layout for this fleet"


# --- an agent's black box ---
# What a robot's black box holds, channel by channel. The calls come from several threads; none of them waits.


def black_box_log(
    folder: Path,
    fleet: Fleet,
    robot: str,
    calibration: Calibration,
    run: Mapping[str, object],
    views: bool,
    depth: MeasureDepth | None = None,
) -> LogWriter:
    """The file `<robot>.mcap`, or `<robot>.2.mcap` and so on after a restart. A robot goes on without it.

    `views`: with channels for viewers; `depth`: what makes depth maps for them.
    """
    return LogWriter(
        unused(folder / f"{robot}.mcap"),
        run,
        attachments={"fleet.toml": dump(fleet), "calibration.toml": dump(calibration)},
        splits_at=channels.STEP_IN.name,
        derive=ViewerChannels(fleet, robot, calibration, depth) if views else None,
        needed=False,
    )


class BlackBoxWriter:
    """Gives each channel of the black box its name, number and times."""

    def __init__(
        self,
        log: LogWriter,
        robot: str,
        clock: Callable[[], int],
        lossless: bool = False,
        rate: RateNotes | None = None,
    ) -> None:
        """`clock` gives Unix nanoseconds that never step back; `lossless`: every frame as PNG, nine times as large.

        `rate`: notes of how fast that clock goes, to be written as well.
        """
        self._log, self._robot, self._clock, self._lossless, self._rate = log, robot, clock, lossless, rate
        self._frames, self._chunks = count(), {channels.FROM_BOARD: count(), channels.TO_BOARD: count()}
        self._lines = count()

    def step(self, step: int, now_ns: int, inputs: bytes, outputs: bytes | None) -> None:
        """One call of Agent.step, as encoded messages; `outputs` is None when it raised."""
        self._log.put(entry_on(channels.STEP_IN, now_ns, now_ns, step, inputs))
        if outputs is not None:
            self._log.put(entry_on(channels.STEP_OUT, now_ns, now_ns, step, outputs))
        for note in self._rate.due() if self._rate is not None else ():
            self._log.put(note)

    def line(self, line: LogLine) -> None:
        """A line of the log that is in the outputs of no step."""
        self._log.put(entry_on(channels.LINES, self._clock(), line.sent_ns, next(self._lines), encode(line)))

    def frame(
        self,
        image: NDArray[np.uint8],
        roi: tuple[int, int, int, int],
        *sightings: Sighting,
        measured: tuple[int, int, int, int] | None = None,
        coarse: bool = False,
    ) -> None:
        """A frame and what vision found in it, of each target that it looked for; called on vision's thread.

        measured: the part of it, in the full frame, that has all that vision measured. Of all but one in WHOLE_EVERY
        that part alone is recorded, as if the camera had read no more. coarse: no clarity is measured in it. Raises
        ValueError for a part outside it.
        """
        number, now_ns = next(self._frames), self._clock()
        if measured is not None and number % WHOLE_EVERY and not self._lossless:
            image, roi = part_of(image, roi, measured), measured
        about = self._robot, number, now_ns, image, roi, sightings[0]
        for entry in frame_entries(*about, self._lossless, coarse):
            self._log.put(entry)
        for sighting in sightings:
            self._log.put(entry_on(channels.VISION, now_ns, sighting.t_ns, number, encode(sighting)))

    def serial(self, from_board: bool, data: bytes) -> None:
        """Bytes of the tether; called on the port's thread."""
        channel, now_ns = channels.FROM_BOARD if from_board else channels.TO_BOARD, self._clock()
        self._log.put(entry_on(channel, now_ns, now_ns, next(self._chunks[channel]), data))
