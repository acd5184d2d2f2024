"""What a rogue can say: messages of a neighbour that are as dear as they can be, made anew ten thousand times a second.

Encoding one takes longer than there is time for, so each kind is encoded once with marks in the place of its numbers,
and a number is written over the marks of a copy. Every number stays a valid one.
"""

import os
import random
import time
from collections.abc import Callable

import msgpack
import msgspec
import numpy as np

from agent.core.config import Fleet
from agent.core.messages import MAX_PAYLOAD, Entry, Epoch, Estimate, Gossip, Sample

Make = Callable[[int], bytes]  # the number of a message, from 1 on -> its payload

MANY = 64  # entries or samples that one message may hold
EIGHT, FOUR = b"\xcf", b"\xce"  # msgpack's unsigned integers of eight and of four bytes
NUMBER, TIME, COUNT = 0x5EC0000000000001, 0x5EC0000000000002, 0x5EC00003
SIGNED = os.urandom(64)  # nobody's signature, as long as one: it has to be looked at to be refused


def kinds(fleet: Fleet, src: str, dst: str, incarnation: int = 1) -> dict[str, Make]:
    """Ways to say nothing true from `src` to `dst`, by name, all about the fleet's first target.

    heartbeat: nothing in it, 200 bytes; entries: 64, each with news every time; signed: the same with signatures that
    are nobody's; incarnations: 64 of new starts; samples: 64, new each time; epochs: a new one each time; random: bytes
    of the greatest length that is accepted; stuffed: the heartbeat, made that long by a field that nobody knows.
    """
    say = dict(fleet=fleet.fleet, src=src, dst=dst, incarnation=incarnation, seq=NUMBER, sent_ns=TIME, t=0, valid=False)

    def marked(gossip: Gossip | None) -> bytes:
        return _packed(Estimate(**say, target=next(iter(fleet.target)), gossip=gossip))

    random_bytes = random.Random(0).randbytes(MAX_PAYLOAD)
    stuffed = _stuffed(marked(None))
    origins = sorted(fleet.robot)
    return {
        "heartbeat": _patched(marked(None)),
        "entries": _patched(marked(Gossip(entries=_entries(origins)))),
        "signed": _patched(marked(Gossip(entries=_entries(origins, SIGNED)))),
        "incarnations": _patched(marked(Gossip(entries=_entries(origins, newest=True)))),
        "samples": _patched(marked(Gossip(epoch=Epoch(1, True, src), samples=_samples(origins)))),
        "epochs": _patched(marked(Gossip(epoch=Epoch(COUNT, False, src), entries=_entries(origins)))),
        "random": lambda k: k.to_bytes(8, "big") + random_bytes[8:],
        "stuffed": _patched(stuffed),
    }


def _entries(origins: list[str], signature: bytes = b"", newest: bool = False) -> tuple[Entry, ...]:
    """64 of them: of each robot as many starts as that takes, all in the middle of the tank and modest."""
    sure = 2500.0  # 1/m^2: 20 mm
    return tuple(
        Entry(
            origin=origins[k % len(origins)],
            incarnation=COUNT if newest else 1 + k // len(origins),
            count=1 if newest else COUNT,
            information=(sure, 0.0, 0.0, sure, 0.0, sure),
            vector=(0.7 * sure, 0.6 * sure, 0.1 * sure),
            systematic_m2=(1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6),
            signature=signature,
        )
        for k in range(MANY)
    )


def _samples(origins: list[str]) -> tuple[Sample, ...]:
    sure = 2500.0
    return tuple(
        Sample(
            origin=origins[k % len(origins)],
            incarnation=1 + k // len(origins),
            number=COUNT,
            age_ns=1_000_000,
            information=(sure, 0.0, 0.0, sure, 0.0, sure),
            vector=(0.7 * sure, 0.6 * sure, 0.1 * sure),
            t_ns=TIME,
        )
        for k in range(MANY)
    )


def _packed(message: Estimate) -> bytes:
    """As `codec.encode` does it, without its checks: a mark may be larger than the field's number may."""
    return bytes(msgpack.packb(msgspec.to_builtins(message, builtin_types=(bytes,))))


def _stuffed(payload: bytes) -> bytes:
    fields = msgpack.unpackb(payload)
    room = MAX_PAYLOAD - len(msgpack.packb({**fields, "x": b""})) - 1
    stuffed = msgpack.packb({**fields, "x": bytes(room)})
    assert len(stuffed) == MAX_PAYLOAD
    return bytes(stuffed)


def _patched(template: bytes) -> Make:
    """Copies of a payload with the message's number in the place of each mark, and the time of day where one was."""
    numbers, times, counts = (
        _places(template, EIGHT + NUMBER.to_bytes(8, "big")),
        _places(template, EIGHT + TIME.to_bytes(8, "big")),
        _places(template, FOUR + COUNT.to_bytes(4, "big")),
    )
    assert len(numbers) == 1
    number, now, four = numbers + np.arange(8), times[:, None] + np.arange(8), counts[:, None] + np.arange(4)
    copy = np.frombuffer(template, np.uint8).copy()

    def make(k: int) -> bytes:
        copy[number] = np.frombuffer(k.to_bytes(8, "big"), np.uint8)
        copy[now] = np.frombuffer(time.time_ns().to_bytes(8, "big"), np.uint8)
        copy[four] = np.frombuffer(k.to_bytes(4, "big"), np.uint8)
        return copy.tobytes()

    return make


def _places(template: bytes, mark: bytes) -> np.ndarray:
    """Where the digits of a mark stand."""
    found, at = [], template.find(mark)
    while at >= 0:
        found.append(at + 1)
        at = template.find(mark, at + 1)
    return np.array(found, dtype=np.intp)
