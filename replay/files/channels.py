"""The table of what stands in a recording: channel, encoding, schema, writer. No other file spells a channel. And the
queue of entries that wait for the disk; and the digests by which a recording is known to be as it was written.

Raw channels hold what nothing else can give back: recovery is there to keep them. Derived ones are for viewers: they
follow from the raw ones, so replay does not read them, and a recording without them can have them made anew.
"""

from __future__ import annotations

import heapq
import json
import re
import threading
from collections import deque
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from typing import IO, Literal, NamedTuple

from agent.core import topics

# --- write queue ---
# What waits for the disk: bounded in messages and in bytes; frames give way before state; every loss is counted.


class Schema(NamedTuple):
    """How a viewer decodes a channel: `data` is a FileDescriptorSet for the encoding "protobuf"."""

    name: str
    encoding: str
    data: bytes


class Entry(NamedTuple):
    """One message on its way into a file. `encoding`, `metadata` and `schema` are the channel's."""

    channel: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes
    encoding: str
    metadata: Mapping[str, str]
    schema: Schema | None = None
    expendable: bool = False  # can be lost without harm to replay: frames


class Drop(NamedTuple):
    """Messages of one channel that were thrown away between two takes; `first` and `last` are sequence numbers."""

    messages: int
    bytes: int
    first: int
    last: int
    last_ns: int


class Backlog:
    """A queue between threads that must not wait and the thread that writes.

    Full, it loses its oldest expendable entry; when it has none left, its oldest.
    """

    def __init__(self, max_messages: int, max_bytes: int) -> None:
        self._max_messages, self._max_bytes = max_messages, max_bytes
        self._vital: deque[tuple[int, Entry]] = deque()  # with the number of its arrival
        self._expendable: deque[tuple[int, Entry]] = deque()
        self._arrivals = 0
        self._bytes = 0
        self._drops: dict[str, Drop] = {}
        self._lock = threading.Lock()  # guards all of the above

    def put(self, entry: Entry) -> bool:
        """Append; True once it is half full: time to come and take."""
        with self._lock:
            (self._expendable if entry.expendable else self._vital).append((self._arrivals, entry))
            self._arrivals += 1
            self._bytes += len(entry.data)
            while len(self) > self._max_messages or self._bytes > self._max_bytes:
                self._lose((self._expendable or self._vital).popleft()[1])
            return 2 * len(self) > self._max_messages or 2 * self._bytes > self._max_bytes

    def take(self) -> tuple[list[Entry], dict[str, Drop]]:
        """All that waits, in order of arrival, and what was lost since the last take, by channel."""
        with self._lock:
            vital, self._vital = self._vital, deque()
            expendable, self._expendable = self._expendable, deque()
            drops, self._drops = self._drops, {}
            self._bytes = 0
        return [entry for _, entry in heapq.merge(vital, expendable)], drops

    def __len__(self) -> int:
        return len(self._vital) + len(self._expendable)

    def _lose(self, entry: Entry) -> None:
        self._bytes -= len(entry.data)
        drop = self._drops.get(entry.channel, Drop(0, 0, entry.sequence, 0, 0))
        self._drops[entry.channel] = Drop(
            drop.messages + 1, drop.bytes + len(entry.data), drop.first, entry.sequence, entry.log_time_ns
        )


# --- the table of channels ---

Encoding = Literal["msgpack", "json", "protobuf", "application/octet-stream"]
PROTOBUF: Encoding = "protobuf"
Writer = Literal["agent", "recorder", "recovery"]  # into the black box, the fleet file, the mended copy of either
AGENT: tuple[Writer, ...] = ("agent",)
RECORDER: tuple[Writer, ...] = ("recorder",)
BOTH: tuple[Writer, ...] = ("agent", "recorder")


class Channel(NamedTuple):
    name: str  # {robot}, {key} and so on are filled in; [/{target}] is left off where there is only one
    about: str  # what it holds, for a person
    encoding: Encoding
    schema: str  # the message: of msgpack a struct of ours, named in the metadata; of protobuf with its descriptor
    writers: tuple[Writer, ...]
    derived: bool = False  # from raw channels


def _derived(name: str, about: str, schema: str, writers: tuple[Writer, ...]) -> Channel:
    return Channel(name, about, PROTOBUF, schema, writers, derived=True)


STEP_IN = Channel("/raw/step_in", "arguments of each `Agent.step`", "msgpack", "aucamp.Inputs", AGENT)
STEP_OUT = Channel(
    "/raw/step_out", "its results: with the arguments all that replay needs", "msgpack", "aucamp.Outputs", AGENT
)
CAMERA_IMAGE = Channel(
    "/{robot}/camera/image",
    "frames between sweeps, as JPEG, coarse but of a survey; one in 128, and all of `agent --lossless`, as PNG",
    PROTOBUF,
    "foxglove.CompressedImage",
    AGENT,
)
SWEEP_IMAGE = Channel(
    "/{robot}/sweep/image",
    "and the part of them that a sweep measures, of one in 16 all that it reads",
    PROTOBUF,
    "foxglove.CompressedImage",
    AGENT,
)
FRAME = Channel(
    "/raw/frame",
    "what belongs to each frame: lens position, region, time; its picture has the same sequence",
    "msgpack",
    "aucamp.Picture",
    AGENT,
)
VISION = Channel("/raw/vision", "what vision found in each frame", "msgpack", "aucamp.Sighting", AGENT)
FROM_BOARD = Channel(
    "/raw/serial/from_board", "bytes of the tether from the control module", "application/octet-stream", "", AGENT
)
TO_BOARD = Channel("/raw/serial/to_board", "and to the control module", "application/octet-stream", "", AGENT)
CLOCK = Channel("/raw/clock", "how fast the clock goes, and the time on the wall", "msgpack", "aucamp.ClockRate", BOTH)
DROPS = Channel("/raw/drops", "what the disk was too slow for: frames give way first, steps last", "msgpack", "", BOTH)
LINES = Channel("/raw/log", "lines of its log that no step said", "msgpack", "aucamp.LogLine", AGENT)
CUT = Channel("/raw/step_in_cut", "inputs of a step that has no outputs", "msgpack", "aucamp.Inputs", ("recovery",))
NETWORK = Channel(
    "/zenoh/{key}", "every message on the network, its payload as it came", "msgpack", "aucamp.{message}", RECORDER
)
ON_NETWORK = NETWORK.name.format(key="")  # how these names begin
PRESENCE = Channel(
    NETWORK.name.format(key=topics.ALIVE.removesuffix("/{session}")),
    '`{"alive":true}` when a robot came, `{"alive":false}` when it went',
    "json",
    "",
    RECORDER,
)

TF = _derived("/{robot}/tf", "where body, gimbal and camera are", "foxglove.FrameTransforms", BOTH)
PRIOR = _derived("/{robot}/target[/{target}]/prior", "the robot's own measurement", "foxglove.PoseInFrame", BOTH)
ESTIMATE = _derived("/{robot}/target[/{target}]/estimate", "its posterior", "foxglove.PoseInFrame", BOTH)
LOG = _derived("/{robot}/log", "lines of its log", "foxglove.Log", BOTH)
PREVIEW = _derived(
    "/{robot}/preview", "what the camera saw, at most twice a second", "foxglove.CompressedImage", RECORDER
)
CAMERA_MODEL = _derived(
    "/{robot}/camera/calibration", "the pinhole of frames between sweeps", "foxglove.CameraCalibration", AGENT
)
SWEEP_MODEL = _derived(
    "/{robot}/sweep/calibration", "and that of the part which a sweep reads", "foxglove.CameraCalibration", AGENT
)
POINTS = _derived(
    "/{robot}/depth/points",
    "how far each block of a whole sweep is, in the camera's frame",
    "foxglove.PointCloud",
    AGENT,
)
KEYFRAME_POINTS = _derived(
    "/{robot}/survey/keyframe", "what a sweep of a survey measured, in the world", "foxglove.PointCloud", BOTH
)
NEXT_VIEW = _derived("/{robot}/survey/next", "where it looks next, or now", "foxglove.PoseInFrame", BOTH)
COVERAGE = _derived(
    "/survey/map", "of each cell how much of what is asked for is known", "foxglove.PointCloud", RECORDER
)
PROTOCOL = _derived("/{robot}/plot/protocol[/{target}]", "prior, posterior and S in numbers", "aucamp.Protocol", BOTH)
NEIGHBOUR = _derived(
    "/{robot}/plot/hears/{neighbour}[/{target}]", "age and weight of a neighbour's word", "aucamp.Neighbour", BOTH
)
ATTITUDE = _derived("/{robot}/plot/attitude", "depth, roll, pitch, battery", "aucamp.Attitude", AGENT)
THRUSTERS = _derived("/{robot}/plot/thrusters", "pulses of thrusters and servos", "aucamp.Thrusters", AGENT)
SURVEY = _derived(
    "/{robot}/plot/survey",
    "share of the wanted cells that it knows, keyframes that it made and holds",
    "aucamp.Survey",
    BOTH,
)
FOCUS = _derived("/{robot}/plot/focus[/{target}]", "lens position and clarity", "aucamp.Focus", AGENT)
RATE = _derived("/plot/clock", "how fast the clock goes", "aucamp.Clock", BOTH)

CHANNELS = (
    *(STEP_IN, STEP_OUT, CAMERA_IMAGE, SWEEP_IMAGE, FRAME, VISION, FROM_BOARD, TO_BOARD, CLOCK, DROPS, LINES, CUT),
    *(PRESENCE, NETWORK, TF, PRIOR, ESTIMATE, LOG, PREVIEW, CAMERA_MODEL, SWEEP_MODEL, POINTS),
    *(KEYFRAME_POINTS, NEXT_VIEW, COVERAGE),
    *(PROTOCOL, NEIGHBOUR, ATTITUDE, THRUSTERS, SURVEY, FOCUS, RATE),
)


def name(channel: Channel, **chunks: str) -> str:
    """The channel of one robot, key or target."""
    return channel.name.replace("[/{target}]", "/{target}" if "target" in chunks else "").format(**chunks)


def match(name_text: str) -> tuple[Channel, dict[str, str]] | None:
    """Which row a channel belongs to and the values of its chunks; None for a channel of nobody."""
    for channel in CHANNELS:
        if found := _pattern(channel).fullmatch(name_text):
            return channel, {chunk: text for chunk, text in found.groupdict().items() if text is not None}
    return None


@cache
def shows_frame(name_text: str) -> bool:
    """Whether a channel of a black box holds the pictures of its camera."""
    found = match(name_text)
    return found is not None and found[0] in (CAMERA_IMAGE, SWEEP_IMAGE)


def network_topic(name_text: str) -> tuple[topics.Topic, dict[str, str]] | None:
    """Which row of the network's table a channel of a fleet file holds, and the chunks of its key; None: of none."""
    return topics.match(name_text.removeprefix(ON_NETWORK)) if name_text.startswith(ON_NETWORK) else None


def entry_on(channel: Channel, log_time_ns: int, publish_time_ns: int, sequence: int, data: bytes) -> Entry:
    """A message on a channel whose name has nothing to fill in."""
    metadata = {"schema": channel.schema} if channel.schema else {}
    return Entry(channel.name, log_time_ns, publish_time_ns, sequence, data, channel.encoding, metadata)


@cache
def _pattern(channel: Channel) -> re.Pattern[str]:
    text = re.escape(channel.name).replace(r"\[", "(?:").replace(r"\]", ")?")
    return re.compile(re.sub(r"\\{(\w+)\\}", r"(?P<\1>[^/]+)", text.replace(r"\{key\}", "(?P<key>.+)")))


# --- digests ---
# What a recording says of itself as SHA-256, so that a reader notices what was changed after it was written.
#
# The header `aucamp.run` has a digest of itself and of each attachment; every other note has its own. The last note
# has one of all bytes before it. A digest is no signature: who writes a whole new file writes new digests into it.

OWN = "sha256"  # entry of a note: digest of its name and its other entries
BEFORE = "sha256.before"  # entry of the last note: of all bytes of the file before that note
ATTACHED = "sha256."  # and the attachment's name: entry of the header


def stamped(name: str, facts: Mapping[str, object]) -> dict[str, str]:
    """The entries of a note as texts, its own digest among them."""
    entries = {key: str(value) for key, value in facts.items() if key != OWN}
    return {**entries, OWN: _digest(name, entries)}


def is_as_written(name: str, entries: Mapping[str, str]) -> bool | None:
    """Whether a note is what its digest says; None: it is older than digests."""
    said = entries.get(OWN)
    if said is None:
        return None
    return said == _digest(name, {key: value for key, value in entries.items() if key != OWN})


def of_attachments(attachments: Mapping[str, str]) -> dict[str, str]:
    """Entries of the header for texts by file name."""
    return {f"{ATTACHED}{name}": sha256(text.encode()).hexdigest() for name, text in attachments.items()}


def attached(run: Mapping[str, str]) -> dict[str, str]:
    """Digests of the attachments by file name, as a header has them."""
    return {key.removeprefix(ATTACHED): value for key, value in run.items() if key.startswith(ATTACHED)}


def _digest(name: str, entries: Mapping[str, str]) -> str:
    return sha256(json.dumps([name, sorted(entries.items())]).encode()).hexdigest()


class HashedFile:
    """A file that is written once from its beginning; `before` is the digest of what was written so far."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self._digest = file, sha256()

    def write(self, data: bytes) -> int:
        """Write and take into the digest."""
        self._digest.update(data)
        return self._file.write(data)

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._file.tell()

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._file.flush()

    @property
    def before(self) -> str:
        return self._digest.hexdigest()
