"""What is said to others, as frozen structs. What a step takes and gives is step_io.py's, the bytes are codec.py's.

Lengths are metres, angles degrees, times integer nanoseconds. `now_ns`, `sent_ns` and every `t_ns` count from
the Unix epoch on the clock of the process that wrote them (sampled once at start, then monotonic).
World frame: origin at the lower left corner of the tank floor, z up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

SCHEMA = 2  # raised whenever the meaning of a field changes; robots refuse others, replay reads older ones too

MAX_PAYLOAD = 16 * 1024  # bytes of any message but a preview; refused before it is decoded
MAX_TEXT = 400  # characters of a line of the log
MAX_JPEG = 60_000  # bytes of a preview: with what stands around it, it fits into one batch of Zenoh, 65535

Vector = tuple[float, float, float]
Symmetric = tuple[float, float, float, float, float, float]  # xx xy xz yy yz zz
Id = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,15}$")]
Count = Annotated[int, Meta(ge=0)]
Signature = Annotated[bytes, Meta(max_length=64)]  # Ed25519 by the origin, of what signed.py makes of it; empty: none
Level = Literal["info", "warning", "error"]
Mode = Literal["running", "degraded", "stopped", "failed"]  # a step broke of late; ended as planned; ended by a fault


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of everything that is sent or logged."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            if not _finite(getattr(self, name)):
                raise ValueError(f"{name} is not finite")


# --- between robots -------------------------------------------------------------------------------------------


class Epoch(msgspec.Struct, frozen=True, array_like=True, order=True):
    """Which stretch of a target's history evidence belongs to. With a new one older evidence is let go."""

    counter: Annotated[int, Meta(ge=0, le=10**9)] = 0
    moving: bool = False  # in this epoch the target moves: samples travel, not sums
    proposer: Annotated[str, Meta(max_length=16)] = ""  # of schema 1; empty


class Entry(msgspec.Struct, frozen=True, array_like=True):
    """All that one robot, since one of its starts, has measured of a resting target: a sum, so newer replaces older."""

    origin: Id
    incarnation: Count
    count: Annotated[int, Meta(ge=1)]  # samples in it; only the origin adds, one at a time, so also its version
    information: Symmetric  # sum of R^-1, 1/m^2
    vector: Vector  # sum of R^-1 x̂, 1/m
    systematic_m2: Symmetric  # mean over the samples of what does not average out
    signature: Signature = b""


class Sample(msgspec.Struct, frozen=True, array_like=True):
    """One measurement of a target that moves."""

    origin: Id
    incarnation: Count
    number: Annotated[int, Meta(ge=1)]  # counts the samples of this origin and incarnation
    age_ns: Count  # since the exposure, by the clocks of those that carried it
    information: Symmetric  # R^-1, 1/m^2
    vector: Vector  # R^-1 x̂, 1/m
    t_ns: Count = 0  # of the exposure, on the clock of its origin; relays may write the age, but not this
    signature: Signature = b""


class Proposal(msgspec.Struct, frozen=True, array_like=True):
    """One robot's word that a new epoch should begin; of two, as a rule, it begins (epoch_vote.py)."""

    proposer: Id
    since_ns: Count  # when its own samples said so first, on its clock; tells this alarm from one before
    counter: Annotated[int, Meta(ge=1, le=10**9)]
    moving: bool
    signature: Signature = b""


class Holding(msgspec.Struct, frozen=True, array_like=True):
    """One line of a digest: what the sender has of an origin, so that nobody sends it again."""

    origin: Id
    incarnation: Count
    newest: Count  # count of its entry, or number of its newest sample
    older: Annotated[int, Meta(ge=0, lt=2**32)] = 0  # bit k: sample `newest - 1 - k` is here too; checksum of an entry


class Gossip(msgspec.Struct, frozen=True, array_like=True):
    """What the protocol `evidence` says beside the estimate."""

    epoch: Epoch = Epoch()
    entries: Annotated[tuple[Entry, ...], Meta(max_length=64)] = ()
    samples: Annotated[tuple[Sample, ...], Meta(max_length=64)] = ()
    digest: Annotated[tuple[Holding, ...], Meta(max_length=64)] = ()
    proposals: Annotated[tuple[Proposal, ...], Meta(max_length=64)] = ()  # for the epoch that is, or for the next


class Estimate(Message, frozen=True, kw_only=True):
    """A robot's a-posteriori estimate to one neighbour; also its heartbeat, sent whether it knows anything or not."""

    schema: int = SCHEMA
    fleet: Id
    src: Id
    dst: Id
    incarnation: Count  # which start of the sender this is
    seq: Count
    sent_ns: Count
    target: Id
    t: Annotated[int, Meta(ge=0, le=10**9)]  # iteration
    valid: bool  # the sender sees the target: it is in S^t
    x_m: Vector | None = None  # posterior
    cov_m2: Symmetric | None = None
    degree: Count | None = None  # `metropolis`: how many neighbours the sender has
    gossip: Gossip | None = None  # `evidence`
    common: Annotated[str, Meta(max_length=16)] = ""  # digest of what all fleet files have to share; empty: not said


# --- to whoever looks -----------------------------------------------------------------------------------------


class NeighbourState(Message, frozen=True, kw_only=True):
    robot: Id
    age_s: float | None = None  # since the newest message; none: never heard
    valid: bool = False
    used: bool = False  # took part in the last update
    heard: Count = 0
    gaps: Count = 0  # missing sequence numbers


class Explain(Message, frozen=True, kw_only=True):
    """Why the last iteration ended where it did; `State.rule`, `alpha` and `neighbours` tell the rest."""

    status: str = ""  # `evidence`: none, single, ok, ambiguous, outlier
    weights: dict[str, float] = {}  # share of each robot's word in the posterior, beside alpha of the own prior
    votes: dict[str, int] = {}  # `evidence`: how many origins agree with this one, itself included
    doubted: dict[str, float] = {}  # origins that count less than they claim: factor; 0: left out
    ages_s: dict[str, float] = {}  # of the newest word of each neighbour, when the iteration ran
    epoch: Epoch = Epoch()
    nis: float | None = None  # normalised innovation squared of the own prior; mean 3 when all is well
    speed_m_s: float | None = None  # of a target that moves
    sway_m: dict[str, float] = {}  # `evidence`: from the posterior to where it would be without this origin


class State(Message, frozen=True, kw_only=True):
    """What a robot knows of one target, does and suffers from. With several targets the states take turns."""

    schema: int = SCHEMA
    fleet: Id
    robot: Id
    incarnation: Count
    seq: Count
    sent_ns: Count
    mode: Mode = "running"
    signed: bool = False  # entries of others count by their signatures; without, by whose mouth they came from
    target: Id
    knows: Literal["blind", "told", "sees"]
    t: Count
    acquired_t: Count | None = None  # iteration of the first own view
    measurements: Count = 0
    prior_m: Vector | None = None
    prior_sigma_m: float | None = None  # root of the covariance's trace
    posterior_m: Vector | None = None
    posterior_sigma_m: float | None = None
    alpha: float | None = None  # step size of the last update
    rule: str = ""  # which branch of the protocol fired
    explain: Explain | None = None
    neighbours: tuple[NeighbourState, ...] = ()
    depth_m: float | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    pan_deg: float = 0.0
    tilt_deg: float = 0.0
    focus: int | None = None
    armed: bool | None = None  # none: nobody knows, for the module is silent
    refused: dict[str, int] = {}  # reason -> count of messages not believed
    faults: tuple[str, ...] = ()  # "kind", or "kind: what of it"


class LogLine(Message, frozen=True, kw_only=True):
    schema: int = SCHEMA
    robot: Id
    sent_ns: Count
    level: Level
    text: Annotated[str, Meta(max_length=MAX_TEXT)]


class Image(Message, frozen=True, kw_only=True):
    """A preview of what a robot's camera sees: for people, never for a measurement."""

    schema: int = SCHEMA
    robot: Id
    seq: Count  # counts the previews
    sent_ns: Count
    t_ns: int  # middle of the exposure
    frame: Count  # as the camera counts
    width_px: Annotated[int, Meta(ge=1)]  # of the JPEG, which may be smaller than the frame
    height_px: Annotated[int, Meta(ge=1)]
    enhanced: bool  # False: as the camera gave it
    focus: int | None = None  # lens position, once at rest
    jpeg: Annotated[bytes, Meta(max_length=MAX_JPEG)]


def fault_kind(fault: str) -> str:
    """Which of State.faults this is, whatever its words."""
    return fault.partition(":")[0]


def _finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, (tuple, list)):
        return all(map(_finite, value))
    if isinstance(value, dict):
        return all(map(_finite, value.values()))
    return True


def upper(matrix: Iterable[Iterable[float]]) -> Symmetric:
    """The upper triangle of a symmetric 3x3 matrix, as it travels."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = (tuple(map(float, row)) for row in matrix)
    return (xx, xy, xz, yy, yz, zz)
