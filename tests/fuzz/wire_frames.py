"""Byte streams for the tether, either end: frames with random fields, mutated frames, noise. All from one seed."""

from __future__ import annotations

import random
import struct
from typing import Any

from hw.firmware import wire

BITS = {"B": 8, "H": 16, "h": 16, "I": 32, "i": 32}
EDGES = {"f": (0.0, -0.0, 1.0, -1.0, float("nan"), float("inf"), float("-inf"), 3.4e38, 1e-45)}


def random_fields(rng: random.Random, kind: int) -> tuple[Any, ...]:
    """Anything that the payload of this message can hold, its limits more often than chance would have it."""
    if kind == wire.LOG:
        return rng.randrange(256), rng.randbytes(rng.randrange(wire.MAX_TEXT + 1))
    fields: list[Any] = []
    count = ""
    for char in wire.FORMAT[kind][1:]:
        if char.isdigit():
            count += char
            continue
        if char == "s":
            fields.append(rng.randbytes(int(count)))
        else:
            fields += [random_number(rng, char) for _ in range(int(count or 1))]
        count = ""
    return tuple(fields)


def random_number(rng: random.Random, char: str) -> float:
    """A number that struct packs as `char`."""
    if char == "f":
        if rng.random() < 0.5:
            return float(rng.choice(EDGES["f"]))
        return float(struct.unpack("<f", rng.randbytes(4))[0])
    bits, signed = BITS[char], char.islower()
    lowest, highest = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    chance = rng.random()
    if chance < 0.3:
        return rng.choice((lowest, lowest + 1, 0, 1, highest - 1, highest))
    if chance < 0.6:
        return rng.randrange(24)  # ids, modes, thrusters, kinds
    return rng.randint(lowest, highest)


def mutated(rng: random.Random, stream: bytes) -> bytes:
    """The same with bits flipped, bytes lost, doubled or put in, or cut off."""
    out = bytearray(stream)
    for _ in range(rng.randrange(1, 4)):
        at = rng.randrange(len(out) + 1)
        match rng.randrange(5):
            case 0 if at < len(out):
                out[at] ^= 1 << rng.randrange(8)
            case 1:
                del out[at : at + rng.randrange(1, 8)]
            case 2:
                out[at:at] = rng.randbytes(rng.randrange(1, 8))
            case 3:
                out[at:at] = out[at : at + rng.randrange(1, 40)]
            case 4:
                del out[at:]
    return bytes(out)


def noise(rng: random.Random) -> bytes:
    """Bytes of no frame, at times longer than any."""
    n = rng.choice((1, 3, 20, 80, 300))
    return rng.randbytes(n) if rng.random() < 0.7 else bytes([rng.randrange(256)]) * n


def frame(writer: Any, kind: int, fields: tuple[Any, ...]) -> bytes:
    return bytes(writer.log(*fields) if kind == wire.LOG else writer.frame(kind, *fields))
