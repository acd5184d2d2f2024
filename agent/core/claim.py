"""What a robot of a survey says of itself twice a second: where it looks next, and which keyframes it holds."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import UNSET, Meta, UnsetType

from agent.core.keyframe import MOST_NUMBER, Lens, Place, Quaternion, pose_fault
from agent.core.messages import NUMBER, SCHEMA, SENT, Count, Id, Message, Vector, means

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
    """Where a robot looks next, so that its neighbours look elsewhere, and which keyframes it has, so that nobody
    sends it what it has, and everybody what it lacks."""

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
    """How many keyframes whoever claims has made since its start, and how many it holds in all."""
    counts = [(has, has.upto + has.beyond.bit_count()) for has in claim.has]
    own = sum(n for has, n in counts if (has.origin, has.incarnation) == (claim.src, claim.incarnation))
    return own, sum(n for _, n in counts)


def claim_fault(claim: Claim, tank_m: Vector) -> str | None:
    """Why nobody can be about to look like that; None where somebody can."""
    view = claim.view
    if view is not UNSET and pose_fault(view.place, view.turn, tank_m):
        return "no pose of a camera in the tank"
    return None
