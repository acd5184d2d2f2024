"""THE table of what stands in a recording: channel, encoding, schema, writer. Nothing else spells a channel.

Raw channels hold what nothing else can give back: recovery is there to keep them. Derived ones are for viewers: they
follow from the raw ones, so replay does not read them, and a recording without them can have them made anew.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Literal, NamedTuple

from agent.core import topics
from replay.files.backlog import Entry

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
    "frames between sweeps, as JPEG; one in 128, and all of `aucamp agent --lossless`, as PNG",
    PROTOBUF,
    "foxglove.CompressedImage",
    AGENT,
)
SWEEP_IMAGE = Channel(
    "/{robot}/sweep/image", "and the part of them that a sweep reads", PROTOBUF, "foxglove.CompressedImage", AGENT
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
    *(STEP_IN, STEP_OUT, CAMERA_IMAGE, SWEEP_IMAGE, FRAME, VISION, FROM_BOARD, TO_BOARD, CLOCK, DROPS, CUT),
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


def entry_on(
    channel: Channel, log_time_ns: int, publish_time_ns: int, sequence: int, data: bytes, expendable: bool = False
) -> Entry:
    """A message on a channel whose name has nothing to fill in. An `expendable` one is lost before any other."""
    metadata = {"schema": channel.schema} if channel.schema else {}
    return Entry(
        channel.name, log_time_ns, publish_time_ns, sequence, data, channel.encoding, metadata, expendable=expendable
    )


@cache
def _pattern(channel: Channel) -> re.Pattern[str]:
    text = re.escape(channel.name).replace(r"\[", "(?:").replace(r"\]", ")?")
    return re.compile(re.sub(r"\\{(\w+)\\}", r"(?P<\1>[^/]+)", text.replace(r"\{key\}", "(?P<key>.+)")))
