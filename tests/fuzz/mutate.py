"""Mutations: of a message's fields, which keep it well-formed, and of its bytes, which do not; and bombs."""

from __future__ import annotations

from random import Random
from typing import Any

import msgpack

from tests.fuzz.values import anything, integer, number, text

DEEP = 3000  # levels of a nesting bomb: more than an interpreter recurses
MANY = (17, 64, 65, 300)  # to which a list is blown up


def fields(message: Any, rng: Random, times: int) -> Any:
    """Change a message in place, given as maps and lists, `times` times; returns it."""
    for _ in range(times):
        _change(message, rng)
    return message


def _change(message: Any, rng: Random) -> None:
    """Walk down to a random place and change what stands there."""
    holder = message
    while True:
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        if not keys:
            return
        key = rng.choice(keys)
        below = holder[key]
        if not (isinstance(below, (dict, list)) and below) or rng.random() < 0.15:
            break
        holder = below
    match rng.randrange(8):
        case 0:
            holder[key] = anything(rng)
        case 1:
            del holder[key]
        case 2 if isinstance(holder, list):
            holder.insert(rng.randrange(len(holder) + 1), below)
        case 3 if isinstance(below, list) and below:
            holder[key] = (below * rng.choice(MANY))[: rng.choice(MANY)]
        case _:
            holder[key] = _like(below, rng)


def _like(value: Any, rng: Random) -> Any:
    """Another value of the same type."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return integer(rng) if rng.random() < 0.5 else value + rng.choice((-1, 1, 2, 16, 600, 10**9))
    if isinstance(value, float):
        return number(rng) if rng.random() < 0.5 else value * rng.choice((-1.0, 0.0, 1e-6, 0.5, 2.0, 1e3, 1e12))
    if isinstance(value, str):
        return text(rng)
    if isinstance(value, bytes):
        return raw(value, rng) if value else rng.randbytes(64)
    if isinstance(value, list) and len(value) > 1:
        return rng.sample(value, len(value))
    return anything(rng)


def raw(payload: bytes, rng: Random) -> bytes:
    """Bytes changed, cut, doubled, inserted or swapped, as a bad link or a bad program does."""
    changed = bytearray(payload)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        at = rng.randrange(len(changed) + 1)
        match rng.randrange(6):
            case 0 | 1 if at < len(changed):
                changed[at] = rng.randrange(256)
            case 2 if at < len(changed):
                changed[at] ^= 1 << rng.randrange(8)
            case 3:
                del changed[at : at + rng.choice((1, 2, 9, 100))]
            case 4:
                changed[at:at] = rng.randbytes(rng.choice((1, 2, 9)))
            case _:
                start = rng.randrange(len(changed) + 1)
                changed[at:at] = changed[start : start + rng.choice((1, 9, 50))]
    return bytes(changed)


def bomb(rng: Random) -> bytes:
    """Few bytes that promise much: deep nesting, lengths without content, and plain noise."""
    deep = rng.choice((10, 500, 1010, DEEP, 16_000))
    inner = rng.choice((b"\x91" * deep + b"\xc0", b"\x81\xa1a" * (deep // 3) + b"\xc0", b"\x92\xc0" * (deep // 2)))
    match rng.randrange(5):
        case 0:
            return inner
        case 1:
            name = rng.choice((b"schema", b"x_m", b"gossip", b"src", b"strange"))
            return b"\x81" + bytes([0xA0 + len(name)]) + name + inner
        case 2:
            fields = {"schema": 3, "fleet": "tank", "src": "r2", "dst": "r1", "target": "ball"}
            return bytes([0x80 + len(fields) + 1]) + bytes(msgpack.packb(fields))[1:] + b"\xa6gossip" + inner
        case 3:
            start = rng.choice((b"\xdd", b"\xdf", b"\xc6", b"\xdb", b"\xc9"))
            return (
                start + rng.choice((b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x00\x0f\xff\xff")) + rng.randbytes(8)
            )
        case _:
            return rng.randbytes(rng.choice((0, 1, 16, 300, 16 * 1024, 16 * 1024 + 1)))


def text_bomb(rng: Random) -> bytes:
    """The same of TOML, JSON and YAML: nesting, dotted keys, aliases, numbers without end, and what is no text."""
    deep = rng.choice((10, 33, 500, DEEP, 16_000))
    match rng.randrange(8):
        case 0:
            return rng.choice((b"", b"a = ", b'{"a": ', b"a: ")) + rng.choice((b"[", b'{"a":', b"{a=", b"- ")) * deep
        case 1:
            return b"a." * deep + b"a = 1"
        case 2:
            return b"[" + b"a." * deep + b"a]"
        case 3:
            return b"a: &a [" + b"1," * 50 + b"]\n" + b"b: [" + b"*a," * min(deep, 500) + b"]\n"
        case 4:
            return rng.choice((b"a = ", b'{"a": ', b"a: ")) + rng.choice((b"9" * deep, b"1e" + b"9" * 9, b"-nan"))
        case 5:
            return b'"' * deep + rng.randbytes(3)
        case 6:
            return rng.choice((b"\xff\xfe", b"\xef\xbb\xbf", b"\0")) * rng.choice((1, 9))
        case _:
            return rng.randbytes(rng.choice((0, 1, 16, 300, 16 * 1024)))
