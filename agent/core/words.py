"""What robots say of light to each other: where the own lamp is at, whose light is asked for, and what is answered.

Each word is all that there is to say, so that the newest stands for those before it, and a lost one costs nothing but
time. Nothing in it counts from a clock: leases say how long they still last, and what came before what is told by
numbers. `changes` counts commands that altered the light; `heard` says which of the reader's words the sender had by
then. Two words with the same `changes`, of which one came before a sweep began and the other was said by somebody who
had heard what was said after its end, prove that this lamp did not change in it.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType

from agent.core.messages import NUMBER, SCHEMA, SENT, Count, Id, Message, Vector, means

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
    """Why nobody can mean that; None where somebody can."""
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
