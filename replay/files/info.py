"""What is in a recording, from a walk through one of its files: facts for programs, and one screen for a person."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from agent.core import topics
from replay.files.channels import CLOCK, STEP_IN, STEP_OUT, network_topic
from replay.files.clock_rate import Moment, Pace, moment, pace
from replay.files.digests import BEFORE, OWN
from replay.files.mcap_walk import Attachment, Channel, Damage, Message, Metadata, Schema, Tear, records

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

    @property
    def hz(self) -> float:
        seconds = (self.last_ns - self.first_ns) * 1e-9
        return (self.messages - 1) / seconds if seconds > 0 else 0.0


class Info(NamedTuple):
    complete: bool  # finished by its writer, and as it was written; False: everything up to the tear
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


def info(path: Path) -> Info:
    """What is in one file. Raises ConfigError if it cannot be opened or is no MCAP file."""
    notes: dict[str, dict[str, str]] = {}
    attachments: dict[str, str] = {}
    schemas: dict[int, str] = {0: ""}
    topics_: dict[int, Channel] = {}
    channels: dict[str, ChannelInfo] = {}
    sequences: dict[str, int] = {}
    moments: list[Moment] = []
    torn_bytes, torn = 0, False
    damage: list[Damage] = []
    for record in records(path):
        match record:
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
                    old = ChannelInfo(about.message_encoding, about.metadata, 0, 0, at_ns, at_ns, schema=schema)
                gap = record.sequence - sequences.get(about.topic, record.sequence) - 1
                sequences[about.topic] = record.sequence
                channels[about.topic] = old._replace(
                    messages=old.messages + 1,
                    bytes=old.bytes + len(record.data),
                    first_ns=min(old.first_ns, record.log_time),
                    last_ns=max(old.last_ns, record.log_time),
                    gaps=old.gaps + max(0, gap),
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
        complete=bool(end) and not torn and not damage,
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
        verified=verified and any(BEFORE in note for note in notes.values()),
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
    if not about.run and not about.channels:
        return "nothing in it: its writer was killed at once, or something else wrote it"
    if not about.end:
        tail = f"; {about.torn_bytes} bytes cannot be read" if about.torn_bytes else ""
        return f"not finished: still being written, or its writer was killed{tail}; `aucamp replay recover` mends it"
    torn = "" if about.complete else f", but {about.torn_bytes} bytes in it cannot be read"
    old = "" if about.verified or torn else "; it is older than digests, so only its checksums were verified"
    return f"finished, {about.end.get('cause', 'no cause given')}{torn}{old}"


def damages(found: Sequence[Damage], most: int = 3) -> str:
    """The first of them in words."""
    more = f"; and {len(found) - most} more" if len(found) > most else ""
    return "; ".join(each.what for each in found[:most]) + more


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
