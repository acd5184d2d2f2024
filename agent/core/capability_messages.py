"""Messages of the capabilities `survey` (keyframes, claims) and `light` (lamps, leases), as frozen structs.

Units, times and frames as in agent/core/messages.py.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import Annotated, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType

from agent.core.messages import NUMBER, SCHEMA, SENT, SIGNED, Count, Id, Message, Signature, Vector, means

# --- keyframe ---
# What one sweep of the focus over a whole view measured, as integers. Robots that have the same keyframes have the same
# map, to the bit: nothing of them is a float, and what is made of them uses + - * / and square roots alone, which are
# the same on every processor.

UNIT_M = 1e-4  # of places and depths
TURN_ONE = 1 << 30  # of a quaternion's components
MOST_BLOCKS = 25 * 19
MOST_NUMBER = 2000  # keyframes of one start of a robot: an hour of them
BEND_ONE = 10_000
PX_ONE = 10

SIGMA_FIRST_M, SIGMA_STEP = 0.0005, 1.025  # sigma of a byte q: SIGMA_FIRST_M SIGMA_STEP^q


def _sigmas() -> tuple[float, ...]:
    """By products, which are the same on every processor; a power is not."""
    found = [SIGMA_FIRST_M]
    while len(found) < 256:
        found.append(found[-1] * SIGMA_STEP)
    return tuple(found)


SIGMAS_M = _sigmas()
Whole = Annotated[int, Meta(ge=-(2**31), lt=2**31)]
Place = tuple[Whole, Whole, Whole]
Quaternion = tuple[Whole, Whole, Whole, Whole]


class Lens(msgspec.Struct, frozen=True, array_like=True):
    """Where the blocks of a picture look, in tenths of pixels. A point (x, y, z) of the camera frame has the slopes
    s = (x, y) / (z - ahead). It is seen at c + f (1 + bend |s|^2) s, counted from the corner of the first block."""

    f: Annotated[int, Meta(ge=100, le=10**6), means("0.1 px, at the lens position of the picture")]
    cx: Annotated[int, Meta(ge=-(10**6), le=10**6), means("0.1 px, from the left edge of the first block")]
    cy: Annotated[int, Meta(ge=-(10**6), le=10**6), means("0.1 px, from the upper edge of the first block")]
    bend: Annotated[int, Meta(ge=-20_000, le=20_000), means("1e-4")]
    ahead: Annotated[int, Meta(ge=-5000, le=5000), means("0.1 mm: where rays meet, ahead of the gimbal's pivot")]
    block: Annotated[int, Meta(ge=8, le=1000), means("px: side of a block")]
    cols: Annotated[int, Meta(ge=1, le=64), means("blocks across")]


class Frame(msgspec.Struct, frozen=True, array_like=True):
    """What one sweep showed, and from where."""

    origin: Annotated[Id, means("the robot that measured")]
    incarnation: Annotated[Count, means("which of its starts: Unix time of it, ns")]
    number: Annotated[int, Meta(ge=1, le=MOST_NUMBER), means("counts the keyframes of this origin and incarnation")]
    place: Annotated[Place, means("0.1 mm, world frame, of the gimbal's pivot")]
    turn: Annotated[Quaternion, means("w x y z of the turn from camera to world, times 2^30")]
    lens: Annotated[Lens, means("where blocks look")]
    depths: Annotated[
        bytes,
        Meta(max_length=2 * MOST_BLOCKS),
        means("z-depth of each block from the pivot, row by row: 16 bits, the lower byte first, 0.1 mm; 0: none"),
    ]
    sigmas: Annotated[
        bytes, Meta(max_length=MOST_BLOCKS), means("its standard deviation: 0.5 mm times 1.025 to that power")
    ]


class Keyframe(Message, frozen=True, kw_only=True):
    """What one sweep showed, to one neighbour; by the robot that measured, or by one that passes it on."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    fleet: Annotated[Id, means("name of the fleet")]
    src: Annotated[Id, means("the robot that says it")]
    dst: Annotated[Id, means("the neighbour that it is said to")]
    incarnation: Annotated[Count, means("which start of the sender this is: Unix time of it, ns")]
    seq: Annotated[Count, means("counts the keyframes that the sender said to this neighbour")]
    sent_ns: Annotated[Count, means(SENT)]
    frame: Annotated[Frame, means("what was measured, and from where")]
    signature: Annotated[Signature | UnsetType, means(f"{SIGNED}; left out where the fleet has no keys")] = UNSET


class Blocks(msgspec.Struct, frozen=True):
    """Depths of blocks as floats: what a keyframe is made of."""

    cols: int
    depths_m: tuple[float | None, ...]  # row by row; None: not measured
    sigmas_m: tuple[float, ...]


def quantised(blocks: Blocks) -> tuple[bytes, bytes]:
    """Depths and sigmas as they travel. What is too far or too unsure for that is left out."""
    depths, sigmas = bytearray(), bytearray()
    for z_m, sigma_m in zip(blocks.depths_m, blocks.sigmas_m, strict=True):
        z = 0 if z_m is None else round(z_m / UNIT_M)
        if not 0 < z < 1 << 16 or not sigma_m <= SIGMAS_M[-1]:
            z = 0
        depths += z.to_bytes(2, "little")
        sigmas.append(sigma_byte(sigma_m) if z else 0)
    return bytes(depths), bytes(sigmas)


def sigma_byte(sigma_m: float) -> int:
    """The nearest byte, by ratio."""
    at = bisect_left(SIGMAS_M, sigma_m)
    if at == 0 or at == len(SIGMAS_M):
        return min(at, len(SIGMAS_M) - 1)
    return at if SIGMAS_M[at] / sigma_m < sigma_m / SIGMAS_M[at - 1] else at - 1


def measured(frame: Frame) -> list[tuple[int, float, float]]:
    """Index, z-depth and sigma [m] of each block that has one."""
    data = frame.depths
    found = []
    for k, q in enumerate(frame.sigmas):
        if z := data[2 * k] | data[2 * k + 1] << 8:
            found.append((k, z * UNIT_M, SIGMAS_M[q]))
    return found


def place_of(at_m: Vector) -> Place:
    x, y, z = (round(at / UNIT_M) for at in at_m)
    return x, y, z


def frame_fault(frame: Frame, tank_m: Vector) -> str | None:
    """Why no robot can have measured that; None where one can. The receiver judges origin, incarnation and number."""
    blocks = len(frame.sigmas)
    if not blocks or len(frame.depths) != 2 * blocks or blocks % frame.lens.cols:
        return "depths and sigmas are not of one grid of blocks"
    if pose_fault(frame.place, frame.turn, tank_m):
        return "no pose of a camera in the tank"
    return None


def pose_fault(place: Place, turn: Quaternion, tank_m: Vector) -> bool:
    """Whether a camera cannot be there, or turned so."""
    outside = any(not -2000 <= at <= size / UNIT_M + 2000 for at, size in zip(place, tank_m, strict=True))
    length = sum(q * q for q in turn)
    return outside or abs(length - TURN_ONE * TURN_ONE) > TURN_ONE * TURN_ONE // 100


# --- claim ---
# What a robot of a survey says of itself twice a second.

SHORT_MASK = 32  # numbers after the first that is missing, of which it is said whether they are held


class View(msgspec.Struct, frozen=True, array_like=True):
    """A camera somewhere, as integers."""

    place: Annotated[Place, means("0.1 mm, world frame, of the gimbal's pivot")]
    turn: Annotated[Quaternion, means("w x y z of the turn from camera to world, times 2^30")]
    lens: Annotated[Lens, means("where blocks look")]
    rows: Annotated[int, Meta(ge=1, le=64), means("blocks down")]
    sigma: Annotated[int, Meta(ge=1, le=10**5), means("0.01 mm: standard deviation of a block's depth at 0.5 m")]


class Has(msgspec.Struct, frozen=True, array_like=True):
    """Which keyframes of one start of a robot the sender holds."""

    origin: Annotated[Id, means("the robot that measured")]
    incarnation: Annotated[Count, means("which of its starts: Unix time of it, ns")]
    upto: Annotated[int, Meta(ge=0, le=MOST_NUMBER), means("all with this number and less are held")]
    beyond: Annotated[
        int, Meta(ge=0, lt=2**SHORT_MASK), means("bit k: number upto + 2 + k is held too; upto + 1 is not")
    ] = 0


class Claim(Message, frozen=True, kw_only=True):
    """Where a robot looks next, so that its neighbours look elsewhere, and which keyframes it has, so that they
    send it what it lacks, and nothing that it has."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    fleet: Annotated[Id, means("name of the fleet")]
    src: Annotated[Id, means("the robot that says it")]
    dst: Annotated[Id, means("the neighbour that it is said to")]
    incarnation: Annotated[Count, means("which start of the sender this is: Unix time of it, ns")]
    seq: Annotated[Count, means("counts the rounds in which the sender says this")]
    sent_ns: Annotated[Count, means(SENT)]
    view: Annotated[View | UnsetType, means("where it looks next, or now; left out: nowhere")] = UNSET
    until_ns: Annotated[Count, means("by its clock: when that has been seen, at the latest; 0 without a view")] = 0
    has: Annotated[tuple[Has, ...], Meta(max_length=128), means("what it holds")] = ()
    share: Annotated[float, Meta(ge=0, le=1), means("of the wanted cells that its map knows well enough")] = 0.0
    digest: Annotated[str, Meta(max_length=16), means("of its map; those of equal maps are equal")] = ""


def holds(claim: Claim) -> tuple[int, int]:
    """How many keyframes the sender of a claim has made since its start, and how many it holds in all."""
    counts = [(has, has.upto + has.beyond.bit_count()) for has in claim.has]
    own = sum(n for has, n in counts if (has.origin, has.incarnation) == (claim.src, claim.incarnation))
    return own, sum(n for _, n in counts)


def claim_fault(claim: Claim, tank_m: Vector) -> str | None:
    """Why no robot can be about to look like that; None where one can."""
    view = claim.view
    if view is not UNSET and pose_fault(view.place, view.turn, tank_m):
        return "no pose of a camera in the tank"
    return None


# --- light ---
# Lamps and leases. Each message holds all that there is to say: the newest replaces those before it, and a lost one
# costs only time. No time in it counts from a clock: leases say how long they still last, and order is told by numbers.
# `changes` counts commands that altered the light; `heard` says which of the reader's messages the sender had by then.
# Take two messages with the same `changes`: one came before a sweep began, the other was said by a robot that had heard
# what was said after the end of the sweep. They prove that this lamp did not change in the sweep.

MOST_HOLDS_S = 30.0  # a lease ends by itself, whatever its holder says
MOST_WAITED = 600  # tenths of a second

Power = Annotated[float, Meta(ge=0, le=1)]
Number = Annotated[int, Meta(ge=0, le=10**9)]
Why = Literal["", "busy", "dark", "off", "battery", "heat", "limit", "moves", "no lamp"]


class LampNow(msgspec.Struct, frozen=True, array_like=True):
    """A robot's own lamp."""

    power: Annotated[Power, means("share of its full power, as commanded")] = 0.0
    pan_deg: Annotated[float, Meta(ge=-360, le=360), means("degrees, as its gimbal is told; positive to the left")] = (
        0.0
    )
    tilt_deg: Annotated[float, Meta(ge=-360, le=360), means("degrees, likewise; positive upwards")] = 0.0
    changes: Annotated[Count, means("counts commands that altered its light, since the sender's start")] = 0
    steady: Annotated[bool, means("light and gimbal have come to rest since the last of them")] = True
    load: Annotated[float, Meta(ge=0, le=1), means("how warm it is, or how empty the battery: 1 is at its limit")] = 0.0
    cannot: Annotated[Why, means("why it cannot burn for others now; empty: it can")] = ""
    burns_for: Annotated[Id | None, means("the robot whose lease it obeys; null: nobody's")] = None


class Lease(msgspec.Struct, frozen=True, array_like=True):
    """Light for one sweep. Lamps that are named burn at their power, aimed at the place; all others go dark; none
    changes before the lease is over. It is over when its holder says nothing of it any more, or another number."""

    number: Annotated[Number, means("counts the leases of this holder's start")]
    waited: Annotated[
        int, Meta(ge=0, le=MOST_WAITED), means("tenths of a second that its holder waited: of two who ask the longer")
    ]
    left_s: Annotated[float, Meta(ge=0, le=MOST_HOLDS_S), means("s that it lasts still, at the most")]
    granted: Annotated[bool, means("it is in force; false: it is asked for, and may be given up for another's")]
    at_m: Annotated[Vector | None, means("where lamps aim: m, world frame; null: none but the holder's own burns")]
    lamps: Annotated[tuple[tuple[Id, Power], ...], Meta(max_length=8), means("robot and power of its lamp")] = ()


class LeaseAck(msgspec.Struct, frozen=True, array_like=True):
    """Answer to a lease of the reader's."""

    incarnation: Annotated[Count, means("which start of the holder it is of")]
    number: Annotated[Number, means("of the lease")]
    obeys: Annotated[bool, means("its lamp is as the lease says, or dark, and stays so; false: it is another's")]
    why: Annotated[Why, means("why it is dark though it was named, or busy; empty: it is as asked")] = ""
    whose: Annotated[Id | None, means("of busy: the robot whose lease counts instead")] = None


class Light(Message, frozen=True, kw_only=True):
    """A robot's lamp, the light that it asks for and its answer to a neighbour that asks, to that neighbour."""

    schema: Annotated[int, means(NUMBER)] = SCHEMA
    fleet: Annotated[Id, means("name of the fleet")]
    src: Annotated[Id, means("the robot that says it")]
    dst: Annotated[Id, means("the neighbour that it is said to")]
    incarnation: Annotated[Count, means("which start of the sender this is: Unix time of it, ns")]
    seq: Annotated[Count, means("counts the rounds in which the sender speaks of light")]
    sent_ns: Annotated[Count, means(SENT)]
    lamp: Annotated[LampNow, means("its own")]
    heard: Annotated[
        tuple[Count, Count] | None, means("incarnation and seq of the reader's newest word that it had; null: none")
    ] = None
    lease: Annotated[Lease | UnsetType, means("the one that it asks for or holds; left out: none")] = UNSET
    ack: Annotated[LeaseAck | UnsetType, means("to the reader's lease; left out: it knows of none")] = UNSET


def light_fault(said: Light, tank_m: Vector) -> str | None:
    """Why no robot can mean that; None where one can."""
    if said.lease is UNSET:
        return None
    at_m, names = said.lease.at_m, [name for name, _ in said.lease.lamps]
    if at_m is not None and not all(-0.5 <= at <= size + 0.5 for at, size in zip(at_m, tank_m, strict=True)):
        return "lamps aim at a place outside the tank"
    if len(set(names)) != len(names):
        return "a lamp is named twice"
    if at_m is None and any(name != said.src for name in names):
        return "lamps of others burn, and nobody knows where to"
    return None
