"""A keyframe: what one sweep of the focus over a whole view measured, as integers, as robots tell it to each other.

Whoever has the same keyframes has the same map, to the bit: nothing of them is a float, and what is made of them uses
+ - * / and square roots alone, which are the same on every processor.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import Annotated

import msgspec
from msgspec import Meta

from agent.core.messages import NUMBER, SCHEMA, SENT, Count, Id, Message, Vector, means

UNIT_M = 1e-4  # of places and depths
TURN_ONE = 1 << 30  # of a quaternion's components
MOST_BLOCKS = 25 * 19
MOST_NUMBER = 2000  # keyframes of one start of a robot: an hour of them
BEND_ONE = 10_000
PX_ONE = 10

SIGMA_FIRST_M, SIGMA_STEP = 0.0005, 1.025  # sigma of a byte q: SIGMA_FIRST_M SIGMA_STEP^q


def _sigmas() -> tuple[float, ...]:
    """By products, which are the same everywhere; a power is not."""
    found = [SIGMA_FIRST_M]
    while len(found) < 256:
        found.append(found[-1] * SIGMA_STEP)
    return tuple(found)


SIGMAS_M = _sigmas()
Whole = Annotated[int, Meta(ge=-(2**31), lt=2**31)]
Place = tuple[Whole, Whole, Whole]
Quaternion = tuple[Whole, Whole, Whole, Whole]


class Lens(msgspec.Struct, frozen=True, array_like=True):
    """Where the blocks of a picture look, in tenths of pixels: a point (x, y, z) of the camera frame has the slopes
    s = (x, y) / (z - ahead) and is seen at c + f (1 + bend |s|^2) s, counted from the corner of the first block."""

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
    """Why nobody can have measured that; None where somebody can. Its head is for who receives it to judge."""
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
