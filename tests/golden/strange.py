"""What robots of golden cases take in beside what is true: words that cannot be, and devices that say nonsense."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgpack
from msgspec.structs import replace

from agent.core.codec import decode, encode
from agent.core.messages import Estimate, Proposal
from agent.core.step_io import DroppedPayloads, Heard, Inputs

HOUR_NS = 3600 * 10**9


def told(**other: object) -> Callable[[Estimate], bytes]:
    """The same word, but for these fields."""
    return lambda said: encode(replace(said, **other))


def gossip(**other: object) -> Callable[[Estimate], bytes]:
    """The same word with other gossip."""

    def payload(said: Estimate) -> bytes:
        assert said.gossip is not None
        return encode(replace(said, gossip=replace(said.gossip, **other)))

    return payload


def entry(**other: object) -> Callable[[Estimate], bytes]:
    """The same word, each of whose entries has these fields."""

    def payload(said: Estimate) -> bytes:
        assert said.gossip is not None
        entries = tuple(replace(each, **other) for each in said.gossip.entries)
        return encode(replace(said, gossip=replace(said.gossip, entries=entries)))

    return payload


def fields(**other: object) -> Callable[[Estimate], bytes]:
    """Likewise, but no message of this kind."""
    return lambda said: bytes(msgpack.packb({**msgpack.unpackb(encode(said)), **other}))


WIDE = (9.0, 0.0, 0.0, 9.0, 0.0, 9.0)
# One after the other in place of what r2 says.
WORDS: tuple[Callable[[Estimate], bytes], ...] = (
    lambda said: b"",
    lambda said: b"\xc1 no msgpack",
    lambda said: bytes(msgpack.packb([1, 2, 3])),
    lambda said: bytes(100_000),
    fields(schema="two"),
    fields(schema=99),
    fields(t="soon"),
    fields(x_m=(math.nan, 0.0, 0.0)),
    told(fleet="other"),
    told(src="r3"),
    told(dst="r3"),
    told(target="wreck"),
    told(common="0123456789abcdef"),
    told(x_m=(9.0, 0.0, 0.0)),
    told(cov_m2=(-1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
    told(incarnation=2 * 10**18),
    told(seq=10**9),
    told(seq=1),
    told(sent_ns=1_767_225_600 * 10**9 + HOUR_NS),
    told(sent_ns=1_767_225_600 * 10**9),
    told(incarnation=1_767_225_600 * 10**9 + 5, seq=10**6),
    entry(origin="r9"),
    entry(count=10**6),
    entry(information=(-1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
    entry(information=(0.0,) * 6),
    entry(vector=(1e9, 0.0, 0.0)),
    entry(systematic_m2=(-1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
    entry(systematic_m2=WIDE),
    entry(origin="r3"),
    entry(incarnation=2 * 10**18),
    gossip(proposals=(Proposal("r9", 1, 1, True),)),
    gossip(proposals=(Proposal("r3", 1_767_225_605 * 10**9, 1, True),)),
    gossip(proposals=(Proposal("r1", 1, 1, True),)),
)
FIRST = 120  # step: by then all have said much
REFUSED = (DroppedPayloads(reason="too large", count=3, src="r2"), DroppedPayloads(reason="stranger", count=1))
TOPICS = ("near", "claim", "keyframe", "light")


def strange(inputs: Inputs, step: int) -> Inputs:
    """The inputs of r1 of the case `strange` in that step, with something strange among them."""
    if step < FIRST:
        return inputs
    heard = tuple(_other(each, step) if each.src == "r2" else each for each in inputs.heard)
    if step % 40 == 0:
        heard += tuple(replace(each, topic=TOPICS[step // 40 % len(TOPICS)]) for each in inputs.heard)
        inputs = replace(inputs, refused=REFUSED, faults=("recording: disk full",))
    if step % 60 < 8:  # a place in a picture that nothing can be made of: the step breaks
        beyond = tuple(replace(each, found=True, centre_px=(1e308, 1e308)) for each in inputs.sightings)
        inputs = replace(inputs, sightings=beyond)
    return replace(inputs, heard=heard)


def _other(heard: Heard, step: int) -> Heard:
    """A strange word each second time."""
    said = decode(heard.payload, Estimate)
    if step % 4 or said.gossip is None:
        return heard
    return replace(heard, payload=WORDS[(step - FIRST) // 4 % len(WORDS)](said))


def forge(heard: Heard) -> Heard:
    """The same message, which says beside it that r3 has seen the target where r2 did, and oftener. r2 signed that."""
    said = decode(heard.payload, Estimate)
    if said.gossip is None:
        return heard
    as_r3 = tuple(replace(e, origin="r3", count=e.count + 100) for e in said.gossip.entries if e.origin == "r2")
    gossip = replace(said.gossip, entries=(*said.gossip.entries, *as_r3))
    return replace(heard, payload=encode(replace(said, gossip=gossip)))
