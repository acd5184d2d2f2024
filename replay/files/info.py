"""What is in a recording, from a walk through one of its files: facts for programs, and one screen for a person. And
how fast its clock went.
"""

from __future__ import annotations

import json
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import NamedTuple

from agent.clock import machine
from agent.clock.clock import Clock
from agent.clock.keeper import how_fast
from agent.core import messages, topics
from agent.core.codec import Refusal, decode, encode, printable
from agent.core.config import ConfigError
from replay.files.channels import BEFORE, CLOCK, OWN, STEP_IN, STEP_OUT, Entry, entry_on, network_topic
from replay.files.mcap_walk import OURS, Attachment, Channel, Damage, Header, Message, Metadata, Schema, Tear, records

# --- rate of the clock ---
# How fast the clock goes by which a recording is stamped: noted twice a second of it, on the channel CLOCK.
#
# A dive in the twin has a clock of its own, faster or slower than the wall's and not evenly so. Each note ties the
# two together at one moment; between two notes a reader interpolates.

PERIOD_NS = 500_000_000  # of the clock; its rate is that of its last second on the wall


class ClockRate(messages.Message, frozen=True, kw_only=True):
    """One note; its log time is the clock's own. Where the clock is the system's the rate is 1."""

    rate: float  # seconds of the clock in a second of the wall, of late
    dive_s: float | None  # since the twin's clock began; None: there is no twin
    wall_ns: int  # Unix time by the system then, which may be corrected while the clock never steps back


class RateNotes:
    """A process with a loop asks it for notes; of one thread."""

    def __init__(self, clock: Clock, unix_ns: Callable[[], int] = machine.unix_ns) -> None:
        self._clock, self._unix_ns = clock, unix_ns
        self._numbers = count()
        self._period: int | None = None  # that was noted last, counted since 1970

    def due(self) -> tuple[Entry, ...]:
        """The note of this period, once; nothing until the next one begins. To be asked more often than that."""
        now_ns, wall_ns = self._clock.now_ns(), self._unix_ns()
        if now_ns // PERIOD_NS == self._period:
            return ()
        self._period = now_ns // PERIOD_NS
        start_ns = self._clock.start_ns
        dive_s = None if start_ns is None else (now_ns - start_ns) * 1e-9
        note = ClockRate(rate=self._clock.rate(), dive_s=dive_s, wall_ns=wall_ns)
        return (entry_on(CLOCK, now_ns, now_ns, next(self._numbers), encode(note)),)


class Moment(NamedTuple):
    """A note as a recording has it."""

    now_ns: int  # by the clock
    noted: ClockRate


def moment(log_time_ns: int, data: bytes) -> Moment | None:
    """What a message on CLOCK says; None for one of another version."""
    try:
        return Moment(log_time_ns, decode(data, ClockRate))
    except Refusal:
        return None


class Pace(NamedTuple):
    """How a dive's clock went over a recording, or over several of one dive."""

    dive_s: float
    wall_s: float
    slowest: float
    fastest: float

    def __str__(self) -> str:
        """A line for a person."""
        return how_fast(self.dive_s, self.wall_s, (self.slowest, self.fastest))


def in_dive(moments: Iterable[Moment]) -> list[Moment]:
    """Those with a twin, in order."""
    return sorted((each for each in moments if each.noted.dive_s is not None), key=lambda each: each.now_ns)


def pace(moments: Iterable[Moment]) -> Pace | None:
    """From the first to the last moment with a twin; None without one, or where the wall's clock was set back."""
    dive = in_dive(moments)
    if not dive or (wall_ns := dive[-1].noted.wall_ns - dive[0].noted.wall_ns) <= 0:
        return None
    rates = [each.noted.rate for each in dive]
    return Pace((dive[-1].now_ns - dive[0].now_ns) * 1e-9, wall_ns * 1e-9, min(rates), max(rates))


# --- what is in a recording ---

STEP_HZ = 20.0  # of an agent's loop
SHOWN = ("kind", "fleet", "robot", "protocol", "part", "incarnation", "commit", "dirty", "cpu", "machine", "python")
COUNTED = {  # entries of the last note, in words
    "dropped": "dropped because the disk did not keep up",
    "not_recorded": "of what came, not recorded or no message",
    "not_derived": "not shown to viewers",
}


class ChannelInfo(NamedTuple):
    encoding: str
    metadata: dict[str, str]
    messages: int
    bytes: int  # before compression
    first_ns: int
    last_ns: int
    gaps: int = 0  # sequence numbers that are missing; only where the channel counts by one
    schema: str = ""  # what a viewer decodes it as
    first: int = 0  # sequence number
    unbroken: int = 0  # messages up to the first missing sequence number, or to a tear: what is read of steps

    @property
    def hz(self) -> float:
        seconds = (self.last_ns - self.first_ns) * 1e-9
        return (self.messages - 1) / seconds if seconds > 0 else 0.0


class Info(NamedTuple):
    complete: bool  # finished by its writer, ours or not, and as it was written; False: up to the tear
    run: dict[str, str]
    end: dict[str, str]  # empty when the writer was killed
    channels: dict[str, ChannelInfo]
    attachments: dict[str, str]
    recovered: dict[str, str]  # what was lost, when this file is a mended copy
    torn: bool  # something in it is broken, or its end is missing
    torn_bytes: int  # that cannot be read
    clock: dict[str, dict[str, str]]  # Unix and monotonic time: at the "start" and at the "end"
    pace: Pace | None  # of the dive's clock; None: there was no twin
    damage: tuple[Damage, ...] = ()  # what is whole, but not as it was written
    verified: bool = False  # it has digests of all that is in it; False: as older recordings, or those cut off
    library: str = ""  # that wrote it


def info(path: Path) -> Info:
    """What is in one file. Raises ConfigError if it cannot be opened or is no MCAP file."""
    notes: dict[str, dict[str, str]] = {}
    attachments: dict[str, str] = {}
    schemas: dict[int, str] = {0: ""}
    topics_: dict[int, Channel] = {}
    channels: dict[str, ChannelInfo] = {}
    sequences: dict[str, int] = {}
    moments: list[Moment] = []
    torn_bytes, torn, library = 0, False, ""
    damage: list[Damage] = []
    for record in records(path):
        match record:
            case Header():
                library = record.library
            case Metadata():
                notes[record.name] = record.metadata
            case Attachment():
                attachments[record.name] = record.data.decode(errors="replace")
            case Schema():
                schemas[record.id] = record.name
            case Channel():
                topics_[record.id] = record
            case Message() if record.channel_id in topics_:
                about = topics_[record.channel_id]
                old = channels.get(about.topic)
                if old is None:
                    schema, at_ns = schemas.get(about.schema_id, ""), record.log_time
                    old = ChannelInfo(
                        about.message_encoding, about.metadata, 0, 0, at_ns, at_ns, schema=schema, first=record.sequence
                    )
                gap = record.sequence - sequences.get(about.topic, record.sequence) - 1
                sequences[about.topic] = record.sequence
                follows = not torn and old.unbroken == old.messages and record.sequence == old.first + old.messages
                channels[about.topic] = old._replace(
                    messages=old.messages + 1,
                    bytes=old.bytes + len(record.data),
                    first_ns=min(old.first_ns, record.log_time),
                    last_ns=max(old.last_ns, record.log_time),
                    gaps=old.gaps + max(0, gap),
                    unbroken=old.unbroken + follows,
                )
                if about.topic == CLOCK.name and (noted := moment(record.log_time, record.data)) is not None:
                    moments.append(noted)
            case Tear():
                torn_bytes, torn = torn_bytes + record.bytes, True
            case Damage():
                damage.append(record)
    verified = all(OWN in note for name, note in notes.items() if name.startswith("aucamp."))
    plain = {
        name: {key: said for key, said in note.items() if key not in (OWN, BEFORE)} for name, note in notes.items()
    }
    end = plain.get("aucamp.end", {})
    return Info(
        complete=not torn and not damage and (bool(end) or not library.startswith(OURS)),
        run=plain.get("aucamp.run", {}),
        end=end,
        channels=channels,
        attachments=attachments,
        recovered=plain.get("aucamp.recovered", {}),
        torn=torn,
        torn_bytes=torn_bytes,
        clock={when: note for when in ("start", "end") if (note := plain.get(f"aucamp.clock.{when}"))},
        pace=pace(moments),
        damage=tuple(damage),
        verified=verified and any(BEFORE in note for note in notes.values()) and library.startswith(OURS),
        library=library,
    )


def describe(path: Path, about: Info) -> str:
    """One screen of plain text: where it comes from, how it ended, what is in it and what is missing."""
    return "\n".join([str(path), *(f"  {line}" for line in _lines(about))])


def as_json(path: Path, about: Info) -> str:
    """The same for programs."""
    facts = about._asdict()
    facts["channels"] = {name: {**channel._asdict(), "hz": channel.hz} for name, channel in about.channels.items()}
    facts["pace"] = about.pace._asdict() if about.pace is not None else None
    facts["damage"] = [each.what for each in about.damage]
    facts["attachments"] = {name: len(text) for name, text in about.attachments.items()}
    return json.dumps({"file": str(path), **facts}, indent=1)


def ending(about: Info) -> str:
    """How the recording ended, in words."""
    if about.damage:
        torn = f"; {about.torn_bytes} bytes cannot be read" if about.torn_bytes else ""
        return f"damaged: {damages(about.damage)}{torn}"
    if about.recovered:
        return f"mended copy of a torn file: {about.recovered.get('summary', 'no summary')}"
    by = f" by '{printable(about.library)[:MOST]}'" if about.library else ""
    if about.complete and not about.library.startswith(OURS):
        return f"whole, {'a copy' if about.run else 'but not written by Aucamp, but'}{by}; digests say nothing of it"
    if not about.run and not about.channels:
        return "nothing in it: its writer was killed at once, or something else wrote it"
    if not about.end:
        tail = f"; {about.torn_bytes} bytes cannot be read" if about.torn_bytes else ""
        return f"not finished: still being written, or its writer was killed{tail}; `aucamp replay recover` mends it"
    torn = "" if about.complete else f", but {about.torn_bytes} bytes in it cannot be read"
    old = "" if about.verified or torn else "; it is older than digests, so only its checksums were verified"
    return f"finished, {about.end.get('cause', 'no cause given')}{torn}{old}"


def damages(found: Sequence[Damage]) -> str:
    """The first three kinds of them in words, and how often each."""
    counts = Counter(each.what for each in found)
    said = [what if times == 1 else f"{what} ({times} times)" for what, times in counts.items()]
    more = f"; and {len(said) - 3} more" if len(said) > 3 else ""
    return "; ".join(said[:3]) + more


def _lines(about: Info) -> Iterator[str]:
    facts = [f"{name} {about.run[name]}" for name in SHOWN if name in about.run]
    if about.channels or facts:
        yield ", ".join(facts) or "written by something else: no aucamp.run in it"
    yield ending(about)
    for entry, what in COUNTED.items():
        if counts := _counts(about.end.get(entry, "{}")):
            yield f"{what}: " + ", ".join(f"{name} {n}" for name, n in counts.items())
    if about.channels:
        first_ns = min(channel.first_ns for channel in about.channels.values())
        last_ns = max(channel.last_ns for channel in about.channels.values())
        yield f"{(last_ns - first_ns) * 1e-9:.1f} s, attached {', '.join(about.attachments) or 'nothing'}"
        if about.pace is not None:
            yield str(about.pace)
        yield f"{'messages':>9} {'Hz':>7} {'kB':>9} {'missing':>8}  channel"
    for name, channel in sorted(about.channels.items()):
        missing = str(channel.gaps) if counts_by_one(name) else ""
        row = f"{channel.messages:>9} {channel.hz:>7.1f} {channel.bytes / 1e3:>9.1f} {missing:>8}  {name}"
        hz = nominal_hz(name)
        slow = hz > 0 and channel.messages > 10 and not 0.8 * hz <= channel.hz <= 1.2 * hz
        yield row + (f"  ({channel.schema})" if channel.schema else "") + (f"  expected {hz:g} Hz" if slow else "")


def missing_steps(files: Iterable[Info]) -> str | None:
    """Of a black box, by its parts, how many steps stand behind the first that is missing, in a line; None: none."""
    read = left_out = 0
    ended = False
    for about in files:
        if (steps := about.channels.get(STEP_IN.name)) is not None:
            followed = 0 if ended or steps.first != read else steps.unbroken
            read, left_out = read + followed, left_out + steps.messages - followed
        ended = ended or left_out > 0 or about.torn
    if not left_out:
        return None
    after = f"step {read - 1}" if read else "the start"
    return f"steps are missing after {after}: what is made of steps leaves out the {left_out} later ones"


def _counts(text: str) -> dict[str, object]:
    """Messages by channel or reason, as the last note has them; none of a note that says something else."""
    try:
        counts = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return {name: n for name, n in counts.items() if n} if isinstance(counts, dict) else {}


def counts_by_one(channel: str) -> bool:
    """Whether a missing sequence number on this channel is a missing message."""
    row = network_topic(channel)
    return channel in (STEP_IN.name, STEP_OUT.name, CLOCK.name) or (row is not None and row[0] is not topics.LOG)


def nominal_hz(channel: str) -> float:
    """How often this channel should have a message; 0: no such rate."""
    if channel in (STEP_IN.name, STEP_OUT.name):
        return STEP_HZ
    row = network_topic(channel)
    return row[0].hz if row else 0.0


# --- damaged recordings ---
# What a recording can do to its reader: nothing but make it say, in one line, that it is damaged.
#
# Readers check what can be checked. What still goes wrong in bytes that no recorder of ours wrote ends here,
# with the place in our code that could not go on: if it is the code's mistake and not the file's, that is where to
# look.

PACKAGE = Path(__file__).parents[2]
MOST = 160  # characters of what was wrong
REMEDY = "take another copy of it, or report this line if its recorder is of this version"


@contextmanager
def suspecting(path: Path) -> Iterator[None]:
    """Raise ConfigError, one line that names the file, for whatever its content does to the code in this block.

    An OSError that names its own file comes through: it is about a disk.
    """
    try:
        yield
    except ConfigError:
        raise
    except Refusal as refusal:
        raise ConfigError(f"{path}: holds a message that is none ({refusal}); {REMEDY}") from None
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            raise
        said = " ".join(str(error).split())[:MOST]
        what = f"{type(error).__name__}{f': {said}' if said else ''}"
        raise ConfigError(f"{path}: holds what no recorder writes ({what}, in {_place(error)}); {REMEDY}") from error


def _place(error: Exception) -> str:
    """Where in our code it happened: file and line."""
    frames = [(Path(frame.filename), frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    rooms = [PACKAGE / room for room in ("agent", "replay")]
    path, line = [each for each in frames if any(each[0].is_relative_to(room) for room in rooms)][-1]
    return f"{path.relative_to(PACKAGE)}:{line}"
