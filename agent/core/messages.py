"""Messages to other robots, to observers and to consoles, as frozen structs.

`step_io` has the inputs and outputs of a step, `codec` turns messages into bytes.

Lengths are metres, angles degrees, times integer nanoseconds. `now_ns`, `sent_ns` and every `t_ns` count from
the Unix epoch on the clock of the process that wrote them (sampled once at start, then monotonic).
World frame: origin at the lower left corner of the tank floor, z up. Camera and gimbal: pan positive to the left, tilt
positive upwards.

What a field means stands here and nowhere else: `means` puts it into the JSON Schemas and into docs/messages.md.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal, get_args, get_type_hints

import msgspec
from msgspec import UNSET, Meta, UnsetType

SCHEMA = 3  # raised whenever the meaning of a field changes; robots refuse others, replay reads older ones too

MAX_PAYLOAD = 16 * 1024  # bytes of any message but a preview; refused before it is decoded
MAX_TEXT = 400  # characters of a line of the log
MAX_JPEG = 60_000  # bytes of a preview: with what stands around it, it fits into one batch of Zenoh, 65535

Vector = tuple[float, float, float]
Symmetric = tuple[float, float, float, float, float, float]  # xx xy xz yy yz zz
NAME = re.compile(r"[a-z][a-z0-9_]{0,15}")
Id = Annotated[str, Meta(pattern=rf"^{NAME.pattern}$(?!\n)")]  # for Python, $ is before a last line feed, too
Count = Annotated[int, Meta(ge=0)]
Signature = Annotated[bytes, Meta(max_length=64)]
Level = Literal["info", "warning", "error"]
Verdict = Literal["consistent", "suspect", "contradicted", "missing"]
Mode = Literal["running", "degraded", "stopped", "failed"]

NUMBER = "which edition of these schemas; a robot believes its own alone"
SENT = "when it was said: ns since the Unix epoch, by the clock of the robot that said it"
SIGNED = "Ed25519 by the origin, 64 bytes, of what agent/core/trust.py makes of it; empty: none"


def means(text: str) -> Meta:
    """What a field is, for the reader of the schema: unit, frame, when it is missing."""
    return Meta(description=text)


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of everything that is sent or logged."""

    def __post_init__(self) -> None:
        for name in _with_floats(type(self)):
            if not _finite(getattr(self, name)):
                raise ValueError(f"{name} is not finite")

    @classmethod
    def upgraded(cls, fields: dict[str, Any]) -> dict[str, Any]:
        """The fields of an older recording as this version names them."""
        return fields


@cache
def _with_floats(kind: type[Message]) -> tuple[str, ...]:
    """The fields that can hold a float, but for those of structs in them, which look after themselves."""
    return tuple(name for name, hint in get_type_hints(kind).items() if _holds_float(hint))


def _holds_float(hint: Any) -> bool:
    return hint in (float, Any, object) or any(map(_holds_float, get_args(hint)))


def _finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, (tuple, list)):
        return all(map(_finite, value))
    if isinstance(value, dict):
        return all(map(_finite, value.values()))
    return True


# --- between robots ---


class Epoch(msgspec.Struct, frozen=True, array_like=True, order=True):
    """Which stretch of a target's history evidence belongs to. With a new one older evidence is let go."""

    counter: Annotated[int, Meta(ge=0, le=10**9), means("counts the epochs")] = 0
    moving: Annotated[bool, means("in this epoch the target moves: samples travel, not sums")] = False
    proposer: Annotated[str, Meta(max_length=16), means("of schema 1; empty")] = ""


class Entry(msgspec.Struct, frozen=True, array_like=True):
    """All that one robot, since one of its starts, has measured of a resting target: a sum, so newer replaces older."""

    origin: Annotated[Id, means("the robot that measured")]
    incarnation: Annotated[Count, means("which of its starts: Unix time of it, ns")]
    count: Annotated[int, Meta(ge=1), means("samples in it; only the origin adds, one at a time, so also its version")]
    information: Annotated[Symmetric, means("sum of R^-1, 1/m^2, world frame: xx xy xz yy yz zz")]
    vector: Annotated[Vector, means("sum of R^-1 times the measured place, 1/m, world frame")]
    systematic_m2: Annotated[
        Symmetric, means("mean over the samples of what does not average out, m^2: xx xy xz yy yz zz")
    ]
    signature: Annotated[Signature, means(SIGNED)] = b""
    lever_m: Annotated[
        Vector, means("mean over the samples of the way from the camera to the target, m, world frame")
    ] = (0.0, 0.0, 0.0)


class Sample(msgspec.Struct, frozen=True, array_like=True):
    """One measurement of a target that moves."""

    origin: Annotated[Id, means("the robot that measured")]
    incarnation: Annotated[Count, means("which of its starts: Unix time of it, ns")]
    number: Annotated[int, Meta(ge=1), means("counts the samples of this origin and incarnation")]
    age_ns: Annotated[Count, means("ns since the exposure, by the clocks of those that carried it")]
    information: Annotated[Symmetric, means("R^-1, 1/m^2, world frame: xx xy xz yy yz zz; rank 2 for a bearing")]
    vector: Annotated[Vector, means("R^-1 times the measured place, 1/m, world frame")]
    t_ns: Annotated[
        Count, means("of the exposure, on the clock of its origin; relays may write the age, but not this")
    ] = 0
    signature: Annotated[Signature, means(SIGNED)] = b""
    unsure_ns: Annotated[Count, means("by which the age may be wrong: half of the round trips on its way, ns")] = 0


class Proposal(msgspec.Struct, frozen=True, array_like=True):
    """One robot's word that a new epoch should begin; of two, as a rule, it begins (agent/core/trust.py)."""

    proposer: Annotated[Id, means("the robot that says so")]
    since_ns: Annotated[
        Count, means("when its own samples said so first, on its clock; tells this alarm from one before")
    ]
    counter: Annotated[int, Meta(ge=1, le=10**9), means("of the epoch that should begin")]
    moving: Annotated[bool, means("whether the target moves in it")]
    signature: Annotated[Signature, means(SIGNED)] = b""
    step_m: Annotated[
        Vector | None, means("by which its own samples saw the target move, m, world frame; null: it rests again")
    ] = None
    against: Annotated[bool, means("its own samples say that the target did not move by that: no new epoch")] = False


class Holding(msgspec.Struct, frozen=True, array_like=True):
    """One line of a digest: what the sender has of an origin, so that no neighbour sends it again."""

    origin: Annotated[Id, means("the robot that measured")]
    incarnation: Annotated[Count, means("which of its starts: Unix time of it, ns")]
    newest: Annotated[Count, means("count of its entry, or number of its newest sample")]
    older: Annotated[
        int, Meta(ge=0, lt=2**32), means("bit k: sample newest - 1 - k is here too; of an entry, its checksum")
    ] = 0


class Gossip(msgspec.Struct, frozen=True, array_like=True):
    """What the protocol `evidence` says beside the estimate."""

    epoch: Annotated[Epoch, means("which history all of this belongs to")] = Epoch()
    entries: Annotated[tuple[Entry, ...], Meta(max_length=64), means("of a target at rest")] = ()
    samples: Annotated[tuple[Sample, ...], Meta(max_length=64), means("of a target that moves")] = ()
    digest: Annotated[tuple[Holding, ...], Meta(max_length=64), means("what the sender has already")] = ()
    proposals: Annotated[
        tuple[Proposal, ...], Meta(max_length=64), means("for the epoch that is, or for the next")
    ] = ()


class Estimate(Message, frozen=True, kw_only=True):
    """A robot's a-posteriori estimate to one neighbour; also its heartbeat, sent whether it knows anything or not."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    fleet: Annotated[Id, means("name of the fleet")]
    src: Annotated[Id, means("the robot that says it")]
    dst: Annotated[Id, means("the neighbour that it is said to")]
    incarnation: Annotated[Count, means("which start of the sender this is: Unix time of it, ns")]
    seq: Annotated[Count, means("counts the messages of the sender about this target to this neighbour")]
    sent_ns: Annotated[Count, means(SENT)]
    target: Annotated[Id, means("what it is about")]
    t: Annotated[int, Meta(ge=0, le=10**9), means("iteration of the estimate")]
    valid: Annotated[bool, means("the sender sees the target: it is in the valid set S^t")]
    x_m: Annotated[Vector | None, means("posterior: place of the target, m, world frame; null: none yet")] = None
    cov_m2: Annotated[Symmetric | None, means("its covariance, m^2, world frame: xx xy xz yy yz zz")] = None
    degree: Annotated[Count | None, means("protocol `metropolis`: how many neighbours the sender has")] = None
    gossip: Annotated[Gossip | None, means("protocol `evidence`: what was measured, by whom")] = None
    common: Annotated[
        str, Meta(max_length=16), means("digest of what all fleet files have to share; empty: not said")
    ] = ""
    missed: Annotated[
        float,
        Meta(ge=0),
        means("nats: -log of the probability to see nothing as it did, were the target where it is believed to be"),
    ] = 0.0
    echo: Annotated[
        tuple[Count, Count] | None,
        means(
            "newest `sent_ns` heard from the neighbour that it is said to, and ns since that arrived; null: never heard"
        ),
    ] = None


class Presence(Message, frozen=True, kw_only=True):
    """Where a robot that swims is and where it goes, to one neighbour, so that they keep clear of each other. One that
    is lost says where it may be, by a wide `cov`; one that has not found itself yet says nothing."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    fleet: Annotated[Id, means("name of the fleet")]
    src: Annotated[Id, means("the robot that says it")]
    dst: Annotated[Id, means("the neighbour that it is said to")]
    incarnation: Annotated[Count, means("which start of the sender this is: Unix time of it, ns")]
    seq: Annotated[Count, means("counts the rounds in which the sender says where it is")]
    sent_ns: Annotated[Count, means(SENT)]
    t_ns: Annotated[Count, means("of place and velocity: ns, by the clock of the robot that said it")]
    x_m: Annotated[float, means("m, world frame, of the body's centre")]
    y_m: Annotated[float, means("m, world frame")]
    yaw_rad: Annotated[float, means("rad, anticlockwise from x")]
    depth_m: Annotated[float, means("m below the surface")]
    cov: Annotated[
        Symmetric,
        means(
            "covariance of x, y and yaw, m and rad, by its own sensors alone and with what is wrong in all of its "
            "fixes alike: xx xy xp yy yp pp"
        ),
    ]
    v_x_m_s: Annotated[float, means("m/s, world frame")]
    v_y_m_s: Annotated[float, means("m/s, world frame")]
    rate_rad_s: Annotated[float, means("rad/s, of yaw, anticlockwise")]
    goal_x_m: Annotated[float, means("m, world frame: where it is told to be now")]
    goal_y_m: Annotated[float, means("m, world frame")]
    goal_yaw_rad: Annotated[float, means("rad: how it is told to look now")]
    behaviour: Annotated[str, Meta(max_length=16), means("what it does now: the kind in the fleet file")]
    target: Annotated[Id | UnsetType, means("what it follows or searches for; left out: neither")] = UNSET
    glance_until_ns: Annotated[
        Count, means("its camera is at landmarks until then, by its clock, and others look at the target; 0: it is not")
    ] = 0


# --- to observers ---


class NeighbourState(Message, frozen=True, kw_only=True):
    """What a robot has of one of its neighbours."""

    robot: Annotated[Id, means("the neighbour")]
    age_s: Annotated[float | None, means("s since its newest message; null: never heard")] = None
    valid: Annotated[bool, means("it sees the target, as it says")] = False
    used: Annotated[bool, means("took part in the last update")] = False
    heard: Annotated[Count, means("messages that arrived")] = 0
    gaps: Annotated[Count, means("sequence numbers that did not")] = 0


class Explain(Message, frozen=True, kw_only=True):
    """Why the last iteration ended where it did; `State.rule`, `alpha` and `neighbours` tell the rest."""

    status: Annotated[str, means("protocol `evidence`: none, single, ok, ambiguous, outlier")] = ""
    weights: Annotated[
        dict[str, float], means("share of each robot's word in the posterior, 0 to 1, beside alpha of the own prior")
    ] = {}
    votes: Annotated[
        dict[str, int], means("protocol `evidence`: how many origins agree with this one, itself included")
    ] = {}
    doubted: Annotated[
        dict[str, float], means("origins that count less than they claim: factor, 0 to 1; 0: left out")
    ] = {}
    ages_s: Annotated[dict[str, float], means("s, of the newest word of each neighbour when the iteration ran")] = {}
    epoch: Annotated[Epoch, means("which history the evidence is of")] = Epoch()
    nis: Annotated[
        float | None, means("normalised innovation squared of the own prior; mean 3 when all is well, 2 of a bearing")
    ] = None
    speed_m_s: Annotated[float | None, means("m/s, of a target that moves")] = None
    moved_m: Annotated[
        Vector | UnsetType | None,
        means("by which the target may have moved, m, world frame, while nobody knows; null: it is settled"),
    ] = UNSET
    stretch: Annotated[
        tuple[float, float] | UnsetType | None,
        means("by which share all ranges are long, and its sigma, of three robots and more; null: fewer"),
    ] = UNSET
    parts_m2: Annotated[
        tuple[float, float, float, float] | UnsetType,
        means(
            "m^2, parts of the variance of the posterior, where no robot is doubted: random; what each robot has wrong "
            "for itself; the scale of all ranges; level and survey"
        ),
    ] = UNSET
    sway_m: Annotated[
        dict[str, float], means("protocol `evidence`: m, from the posterior to where it would be without this origin")
    ] = {}


class Whereabouts(Message, frozen=True, kw_only=True):
    """Where a robot that swims is, by landmarks and its own motion."""

    x_m: Annotated[float, means("m, world frame, of the body's centre")]
    y_m: Annotated[float, means("m, world frame")]
    yaw_deg: Annotated[float, means("degrees, anticlockwise from x")]
    place_sigma_m: Annotated[float, means("m: root of the trace of the covariance of x and y")]
    yaw_sigma_deg: Annotated[float, means("degrees")]


class LampState(Message, frozen=True, kw_only=True):
    """A robot's lamp, and by which lease it burns. `obeys`: it burns, or is dark, as a neighbour's lease says."""

    power: Annotated[float, Meta(ge=0, le=1), means("share of its full power, as commanded")]
    pan_deg: Annotated[float, means("degrees, as its gimbal is told; positive to the left")]
    tilt_deg: Annotated[float, means("degrees, likewise; positive upwards")]
    phase: Annotated[Literal["free", "asks", "holds", "obeys"], means("free: nobody's lease is known")]
    lease: Annotated[Count, means("number of the lease; 0: none")] = 0
    holder: Annotated[Id | None, means("the robot that asks for it or holds it; null: none")] = None
    lamps: Annotated[tuple[Id, ...], means("whose lamps burn by it, as its holder knows")] = ()
    load: Annotated[float, means("how warm it is, or how empty the battery: 1 is at its limit")] = 0.0
    spoiled: Annotated[Count, means("own sweeps discarded so far because a lamp changed in them")] = 0


class State(Message, frozen=True, kw_only=True):
    """What a robot knows of one target, does and suffers from. With several targets the states take turns."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    fleet: Annotated[Id, means("name of the fleet")]
    robot: Annotated[Id, means("the robot that says it")]
    incarnation: Annotated[Count, means("which of its starts this is: Unix time of it, ns")]
    seq: Annotated[Count, means("counts its states about this target")]
    sent_ns: Annotated[Count, means(SENT)]
    verdict: Annotated[Verdict, means("whether what it believes of the target can be trusted")] = "consistent"
    causes: Annotated[tuple[str, ...], means("why not, the worst first; empty: consistent")] = ()
    mode: Annotated[
        Mode, means("running; degraded: a step broke a moment ago; stopped: ended as planned; failed: ended by a fault")
    ] = "running"
    signed: Annotated[
        bool, means("what others measured counts by their signatures; false: by whose mouth it came from")
    ] = False
    target: Annotated[Id, means("what it is about")]
    knows: Annotated[Literal["blind", "told", "sees"], means("told: by neighbours alone")]
    t: Annotated[Count, means("iteration")]
    acquired_t: Annotated[Count | None, means("iteration of the first own view; null: none yet")] = None
    measurements: Annotated[Count, means("own ones so far")] = 0
    prior_m: Annotated[Vector | None, means("place of the target by the last own measurement, m, world frame")] = None
    prior_sigma_m: Annotated[float | None, means("m: root of the trace of its covariance")] = None
    posterior_m: Annotated[Vector | None, means("place after the last update, m, world frame")] = None
    posterior_sigma_m: Annotated[float | None, means("m: root of the trace of its covariance")] = None
    alpha: Annotated[float | None, means("step size of the last update")] = None
    rule: Annotated[str, means("which branch of the protocol fired")] = ""
    explain: Annotated[Explain | None, means("why the last iteration ended where it did")] = None
    neighbours: Annotated[tuple[NeighbourState, ...], means("what it has of each of them")] = ()
    depth_m: Annotated[float | None, means("m below the surface; null: the control module is silent")] = None
    roll_deg: Annotated[float | None, means("degrees, about the axis ahead; positive: left side up")] = None
    pitch_deg: Annotated[float | None, means("degrees, about the axis to the left; positive: bow down")] = None
    pan_deg: Annotated[float, means("degrees, as the gimbal is told; positive to the left")] = 0.0
    tilt_deg: Annotated[float, means("degrees, as the gimbal is told; positive upwards")] = 0.0
    focus: Annotated[int | None, means("lens position, in the camera's own steps")] = None
    whereabouts: Annotated[
        Whereabouts | UnsetType | None, means("of a robot that swims; null: it does not know; left out: it is moored")
    ] = UNSET
    behaviour: Annotated[
        str | UnsetType, means("what a robot that swims does now: the kind in the fleet file; left out: it is moored")
    ] = UNSET
    lamp: Annotated[LampState | UnsetType, means("left out: its fleet has no [lighting]")] = UNSET
    ordered: Annotated[
        tuple[str, ...] | UnsetType, means("what people ordered that holds, `console: order`; left out: nothing")
    ] = UNSET
    armed: Annotated[bool | None, means("whether motors may turn; null: nobody knows, for the module is silent")] = None
    battery_v: Annotated[float | UnsetType, means("V, as its control module last said; left out: it never has")] = UNSET
    ladder: Annotated[int | UnsetType, means("the module's failsafe level, 0 is normal; left out: likewise")] = UNSET
    sensors_bad: Annotated[
        tuple[int, ...] | UnsetType, means("pressure sensors, 1 to 4, that the module does not believe; left out: none")
    ] = UNSET
    saturated: Annotated[
        str | UnsetType, means("thrusters that give all they can: `T1-T4`, `T5-T8` or both; left out: none")
    ] = UNSET
    unsaved: Annotated[bool | UnsetType, means("true: parameters are set and not saved; left out: none are")] = UNSET
    current_a: Annotated[float | UnsetType, means("A, drawn from its battery; left out: it has not said")] = UNSET
    water_c: Annotated[float | UnsetType, means("degrees Celsius, at its pressure sensors; left out: likewise")] = UNSET
    heap_free_kb: Annotated[float | UnsetType, means("kB of its module's memory; left out: likewise")] = UNSET
    refused: Annotated[dict[str, int], means("reason -> count of messages not believed")] = {}
    faults: Annotated[tuple[str, ...], means("what is wrong now: `kind`, or `kind: what of it`")] = ()


class LogLine(Message, frozen=True, kw_only=True):
    """A line of a robot's log."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    robot: Annotated[Id, means("the robot that says it")]
    sent_ns: Annotated[Count, means(SENT)]
    level: Annotated[Level, means("how bad it is")]
    text: Annotated[str, Meta(max_length=MAX_TEXT), means("one line, for people")]


class Image(Message, frozen=True, kw_only=True):
    """A preview of what a robot's camera sees: for people, never for a measurement."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    robot: Annotated[Id, means("the robot whose camera it is")]
    seq: Annotated[Count, means("counts the previews")]
    sent_ns: Annotated[Count, means(SENT)]
    t_ns: Annotated[int, means("middle of the exposure: ns since the Unix epoch, by the robot's clock")]
    frame: Annotated[Count, means("number of the frame, as the camera counts")]
    width_px: Annotated[int, Meta(ge=1), means("of the JPEG, which may be smaller than the frame")]
    height_px: Annotated[int, Meta(ge=1), means("of the JPEG")]
    enhanced: Annotated[bool, means("false: as the camera gave it")]
    focus: Annotated[int | None, means("lens position, once at rest, in the camera's own steps")] = None
    jpeg: Annotated[bytes, Meta(max_length=MAX_JPEG), means("the whole file, JPEG")]


# --- operator commands ---
# An order is a query, so that the console gets an answer or learns that there is none. The console's name stands in the
# key, where access rules see it. Observers cannot see queries, so the answer is published as well.

MAX_ORDER = 4096  # bytes; larger ones are turned away unread
MAX_WORDS = 200  # characters of an order in words

Arg = bool | int | float | str


class Order(Message, frozen=True, kw_only=True):
    """What an operator at a console wants of a robot. All values are absolute: heard twice is as heard once."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    id: Annotated[
        int, Meta(ge=0, le=2**63 - 1), means("counts the orders of this console, from the ns of its start on")
    ]
    session: Annotated[
        int,
        Meta(ge=0, le=2**63 - 1),
        means("tells sessions of a console of one name from each other: the ns of its start"),
    ] = 0
    verb: Annotated[str, Meta(max_length=16), means("what to do: docs/orders.md")]
    args: Annotated[Mapping[str, Arg], Meta(max_length=16), means("how, by the names in docs/orders.md")] = {}
    seen: Annotated[
        tuple[Count, Count] | None,
        means("incarnation and sent_ns of the robot's State that was looked at; null: for what may come late"),
    ] = None


class Answer(Message, frozen=True, kw_only=True):
    """What became of an order, for observers. The reply to the query is the same."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    robot: Annotated[Id, means("the robot that says it")]
    console: Annotated[str, Meta(max_length=16), means("who ordered, by the key of the order")]
    id: Annotated[Count, means("of the order; 0: it could not be read")]
    order: Annotated[str, Meta(max_length=MAX_WORDS), means("what was ordered, in words; empty: it could not be read")]
    ok: Annotated[bool, means("whether it is done, or under way")]
    why: Annotated[str, Meta(max_length=MAX_WORDS), means("why not, and what to do; or what is to be known beside")] = (
        ""
    )
    arrived_ns: Annotated[Count, means("when the order arrived: ns since the Unix epoch, by the robot's clock")]
    sent_ns: Annotated[Count, means(SENT)]
