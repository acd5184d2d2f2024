"""Inputs and outputs of Agent.step, as frozen structs: all that a recording has to hold.

Units, times and frames as in messages.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import msgpack
import msgspec
from msgspec import UNSET, Meta, UnsetType

from agent.core.codec import READABLE, decode
from agent.core.messages import Answer, Count, Estimate, Id, LogLine, Message, State, Vector
from agent.core.topics import Topic

Slope = tuple[float, float]

# --- inputs: from the robot's own devices, and from others ---


class Sighting(Message, frozen=True, kw_only=True):
    """What vision found in one frame. Pixels: u right, v down, from the centre of the upper left pixel."""

    t_ns: int  # middle of the exposure
    frame: Count
    sweep: Count = 0  # the plan this frame belongs to; 0: none
    index: int = -1  # which position of that plan
    focus: int | None = None  # lens position, once at rest
    target: Id
    found: bool
    centre_px: tuple[float, float] | None = None  # where the ray to a ball's centre meets the image; middle of a box
    radius_px: float | None = None  # apparent radius of a ball
    clarity: float | None = None  # Tenengrad per pixel over a ball's inner disc, or the inner half of a box
    area_px: float | None = None  # pixels that clarity was taken over
    score: float = 0.0  # 0 to 1: how sure it is that this is the target
    size_px: tuple[float, float] | None = None  # width and height of the box around a target that is no ball
    radius_sigma_px: float | None = None  # standard deviation of radius_px; None: vision did not say


class SeenTag(msgspec.Struct, frozen=True, array_like=True):
    """One landmark in a frame. A slope is (x, y) / (z - ahead_m) in the camera frame, the lens's bending undone."""

    id: Annotated[int, Meta(ge=0, le=586)]
    corners: tuple[Slope, Slope, Slope, Slope]  # clockwise as seen, from the upper left of the upright tag
    size_px: float  # its shortest side
    rho_px: float  # of its middle from the principal point
    edges: bool  # corners are where fitted edges meet; False: where a corner finder put them


class SeenTags(Message, frozen=True, kw_only=True):
    """The landmarks of one frame."""

    t_ns: int  # middle of the exposure
    frame: Count
    focus: int | None = None  # lens position, once at rest
    tags: Annotated[tuple[SeenTag, ...], Meta(max_length=64)] = ()


class Flow(Message, frozen=True, kw_only=True):
    """Where points of a key frame are in a later one, as slopes."""

    t_ns: int  # middle of the later exposure
    since_ns: int  # and of the key frame's
    pairs: Annotated[tuple[tuple[float, float, float, float], ...], Meta(max_length=64)] = ()  # x, y then; x, y now


class BlockPeaks(Message, frozen=True, kw_only=True):
    """What a sweep over whole frames showed: where the clarity of each block of its largest picture has its peak."""

    t_ns: int  # middle of the exposure of the frame that the blocks are counted in
    sweep: Count  # number of its plan
    focus: int  # lens position of that frame
    block_px: Annotated[int, Meta(ge=8)]
    cols: Annotated[int, Meta(ge=1, le=64)]
    rows: Annotated[int, Meta(ge=1, le=64)]
    # Index, row by row, lens position of the peak and its standard deviation; blocks without a clear one left out.
    peaks: Annotated[tuple[tuple[Count, float, float], ...], Meta(max_length=4096)] = ()


class Telemetry(Message, frozen=True, kw_only=True):
    """One telemetry frame of the control module."""

    t_ns: int  # arrival at the host
    board_us: int  # the board's clock
    depth_m: float
    roll_deg: float
    pitch_deg: float
    sensor_depth_m: tuple[float, float, float, float]  # each sensor, below its tare
    pulses_us: tuple[int, int, int, int, int, int, int, int]
    servos_us: tuple[int, int, int, int]
    battery_v: float
    armed: bool
    ladder: int  # failsafe level, 0 is normal
    flags: int
    loop_us: int
    rate_rad_s: float | UnsetType = UNSET  # yaw rate by the module's gyro; unset: it has none, or none that answers
    saturated: int | UnsetType = UNSET  # thrusters at their limit: bit 0 T1 to T4, bit 1 T5 to T8; unset: none
    sensors_bad: int | UnsetType = UNSET  # bit mask of pressure sensors that are not believed; unset: none
    parameters_dirty: bool | UnsetType = UNSET  # some are set and not saved; unset: none
    # Once a second, in the frame that follows the module's status:
    current_a: float | UnsetType = UNSET
    temperature_c: float | UnsetType = UNSET  # of the water, at the first sensor that tells
    heap_free_b: int | UnsetType = UNSET  # of the module's memory

    @property
    def bad_sensors(self) -> tuple[int, ...]:
        """Pressure sensors, 1 to 4, that the module does not believe."""
        return tuple(k + 1 for k in range(4) if (self.sensors_bad or 0) >> k & 1)


class Heard(Message, frozen=True, kw_only=True):
    """A payload as it came, not yet believed."""

    arrived_ns: int
    src: Id  # from the key it came on
    payload: bytes
    topic: Id | UnsetType = UNSET  # the row of topics.py that its key is of; unset: link


class DroppedPayloads(Message, frozen=True, kw_only=True):
    """Payloads that the transport turned away unread."""

    reason: str
    count: int
    src: Id | UnsetType = UNSET  # the neighbour on whose keys they came; unset: on keys of no neighbour


class Ordered(Message, frozen=True, kw_only=True):
    """An order as it came, not yet judged."""

    arrived_ns: int
    console: str  # from the key it came on
    payload: bytes


class Inputs(Message, frozen=True, kw_only=True):
    """All that arrived since the last step: of devices in order of arrival, of neighbours in turn."""

    telemetry: tuple[Telemetry, ...] = ()
    sightings: tuple[Sighting, ...] = ()
    heard: tuple[Heard, ...] = ()
    refused: tuple[DroppedPayloads, ...] = ()
    landmarks: tuple[SeenTags, ...] | UnsetType = UNSET  # whole frames that were searched for them; unset: none was
    flow: tuple[Flow, ...] | UnsetType = UNSET  # points of key frames in these frames; unset: none
    blocks: tuple[BlockPeaks, ...] | UnsetType = UNSET  # of sweeps over whole frames that ended; unset: none did
    faults: tuple[str, ...] | UnsetType = UNSET  # what the host knows to be wrong beside all this; unset: nothing
    keys: dict[Id, bytes] | UnsetType = UNSET  # public keys of the robots, when they were read or changed
    orders: tuple[Ordered, ...] | UnsetType = UNSET  # urgent ones first, then in order of arrival; unset: none came


# --- outputs: to the robot's own devices, and to others ---


class SweepPlan(Message, frozen=True, kw_only=True, omit_defaults=True):
    """Lens positions to visit in this order; the first only brings the lens to its starting side."""

    sweep: Count
    focus: tuple[int, ...]
    target: Id | None = None  # whose clarity to take; left out where the fleet has one target
    block_px: Count = 0  # of the blocks of whole frames, whose clarity is taken instead; left out: a target's


class SetPoint(Message, frozen=True, kw_only=True):
    """What the control module shall hold. Repeated, it is also the heartbeat that the module waits for."""

    depth_m: float
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    force_n: tuple[float, float] = (0.0, 0.0)  # forward, left; open loop
    yaw_moment_nm: float = 0.0  # open loop
    servos_us: tuple[int, int, int, int] = (1500, 1500, 1500, 1500)  # camera pan, tilt, lamp pan, tilt
    light: float = 0.0  # 0 to 1


class TargetBox(Message, frozen=True, kw_only=True):
    """A box that an operator drew around a target, for vision to go by: pixels of the whole frame."""

    target: Id
    frame: Count  # number of the frame that it was drawn in
    box: tuple[float, float, float, float]  # x, y of the upper left corner, width, height


Motors = Literal["tare", "off", "surface", "arm"]  # tare: the module's sensors read air now, and no motor turns


class SweepOutcome(Message, frozen=True, kw_only=True):
    """What the kernel made of one sweep: the peak of its clarity and the place that it gave, or why there is none."""

    sweep: Count  # number of its plan
    target: Id
    t_ns: int | None = None  # middle of the exposure of the sharpest frame
    lens_position: float | None = None  # of the peak
    sigma: float | None = None  # its standard deviation, lens positions
    width: float | None = None  # half width of the peak, lens positions
    held_width: float | None = None  # the half width that the fit was told; none: it was free
    quality: float | None = None  # correlation of curve and model, 0 to 1
    x_m: Vector | None = None  # where that puts the target: the prior
    rejected: str = ""  # why there is no prior
    lamps: tuple[Id, ...] | UnsetType = UNSET  # lamps that it took to burn meanwhile; unset: no light was asked for
    lit: tuple[Id, ...] | UnsetType = UNSET  # and that burned, as their robots said


class Said(Message, frozen=True, kw_only=True):
    """A message of a capability to one neighbour, as it is sent."""

    topic: Id  # a row of topics.py
    to: Id
    payload: bytes


class Grant(Message, frozen=True, kw_only=True):
    """Who has a resource from this step on."""

    resource: Literal["camera", "body", "lamp"]
    holder: Id  # a row of the table of priorities, or nobody


class Outputs(Message, frozen=True, kw_only=True):
    """All that one step decided."""

    set_point: SetPoint
    sweep: SweepPlan | None = None
    says: tuple[Estimate, ...] = ()
    state: State | None = None
    log: tuple[LogLine, ...] = ()
    outgoing: tuple[Said, ...] | UnsetType = UNSET  # what capabilities tell neighbours; unset: nothing
    grants: tuple[Grant, ...] | UnsetType = UNSET  # that are others than in the step before; unset: none
    lens: int | UnsetType | None = UNSET  # position between sweeps from now on; none: for landmarks; unset: as before
    outcome: SweepOutcome | UnsetType = UNSET  # left out but where a sweep ended: steps without one stay as they were
    answers: tuple[Answer, ...] | UnsetType = UNSET  # to `Inputs.orders`, one by one; unset: there were none
    motors: Motors | UnsetType = UNSET  # as ordered in this step; unset: as before
    box: TargetBox | UnsetType = UNSET  # around a target, as an operator drew it; unset: as before
    preview_hz: float | UnsetType = UNSET  # rate of previews for observers, from now on; unset: as before

    @classmethod
    def upgraded(cls, fields: dict[str, Any]) -> dict[str, Any]:
        """Outputs as older recordings have them: each topic of a capability was a field of its own. Fields that hold no
        messages stay, and are refused as unknown ones."""
        words = {name: fields[name] for name in OLDER if name in fields}
        held = words.values()
        if "outgoing" in fields or not all(isinstance(each, list) and all(map(_to_somebody, each)) for each in held):
            return fields
        said = [
            {"topic": OLDER[name], "to": each["dst"], "payload": msgpack.packb(each)}
            for name in words
            for each in words[name]
        ]
        named = (("outgoing", said) if name in OLDER else (name, value) for name, value in fields.items())
        return dict(named)

    def said(self, topic: Topic) -> Iterator[Any]:
        """What neighbours are told on a topic, decoded."""
        for each in self.outgoing or ():
            if each.topic == topic.name:
                yield decode(each.payload, topic.message, topic.limit, READABLE)


def _to_somebody(message: Any) -> bool:
    return isinstance(message, dict) and isinstance(message.get("dst"), str)


# Field and topic, in the order in which a robot says them.
OLDER = {"near": "near", "light": "light", "claims": "claim", "keyframes": "keyframe"}
