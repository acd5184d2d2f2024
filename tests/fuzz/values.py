"""Numbers, texts and things that programs stumble over, and a value of any type that a message declares."""

from __future__ import annotations

import math
from functools import cache
from random import Random
from typing import Any

from msgspec import inspect

INTEGERS = (0, 1, 2, -1, 17, 64, 255, 2**31, 2**32 - 1, 2**32, 10**9, 10**9 + 1, 2**53 + 1, 2**62, 2**63 - 1, 2**63)
LARGEST, SMALLEST = 2**64 - 1, -(2**63)  # of the integers that msgpack has
FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-12, 1e9, 1e15, 1e154, 1e200, 1e308, -1e308, 1.7976931348623157e308, 5e-324, 1e-308)
NO_NUMBERS = (math.nan, math.inf, -math.inf)
NAMES = ("r1", "r2", "r3", "r4", "stranger", "ball", "buoy", "tank", "a")
TEXTS = ("", "R1", "r1/r2", "*", "ä" * 9, "x" * 17, "x" * 500, "\x00", "\x1b[2J", "{0}", "%s", "\ud7ff", "1e999")


def integer(rng: Random) -> int:
    """An integer that msgpack can carry, near some limit."""
    pick = rng.random()
    if pick < 0.1:
        return rng.choice((LARGEST, SMALLEST))
    if pick < 0.3:
        return rng.getrandbits(rng.randrange(1, 64))
    return rng.choice(INTEGERS)


def number(rng: Random) -> float:
    """A float: an extreme one, or any of some size; sometimes none at all."""
    pick = rng.random()
    if pick < 0.1:
        return rng.choice(NO_NUMBERS)
    if pick < 0.5:
        return rng.choice(FLOATS)
    return rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-12.0, 12.0)


def text(rng: Random) -> str:
    return rng.choice(NAMES) if rng.random() < 0.6 else rng.choice(TEXTS)


def anything(rng: Random) -> Any:
    """A value of any type: what stands where something else was meant."""
    match rng.randrange(9):
        case 0:
            return None
        case 1:
            return rng.random() < 0.5
        case 2 | 3:
            return integer(rng)
        case 4 | 5:
            return number(rng)
        case 6:
            return text(rng)
        case 7:
            return rng.randbytes(rng.choice((0, 1, 32, 64, 65)))
        case _:
            return rng.choice(([], {}, [[]], {"a": None}, [0.0] * 6, [0.0] * 3, [1] * 70, {"schema": 3}, {"r1": 1.0}))


def of_type(kind: type, rng: Random, wild: float) -> Any:
    """The plain form (maps, lists, numbers) of a value that a type declares.

    wild: how probable it is for each number to be an extreme one, in or out of what the type allows.
    """
    return _made(_shape(kind), rng, wild)


@cache
def _shape(kind: type) -> inspect.Type:
    return inspect.type_info(kind)


def _made(shape: inspect.Type, rng: Random, wild: float) -> Any:
    if wild and rng.random() < 0.1 * wild:
        return anything(rng)
    match shape:
        case inspect.Metadata():  # a type with a description
            return _made(shape.type, rng, wild)
        case inspect.IntType():
            return integer(rng) if rng.random() < wild else (shape.ge or 0) + rng.randrange(50)
        case inspect.FloatType():
            return number(rng) if rng.random() < wild else rng.uniform(0.0, 1.0)
        case inspect.BoolType():
            return rng.random() < 0.5
        case inspect.StrType():
            return text(rng) if rng.random() < wild else rng.choice(NAMES)
        case inspect.BytesType():
            return rng.randbytes(rng.choice((0, 1, 64)))
        case inspect.NoneType():
            return None
        case inspect.LiteralType():
            return rng.choice(shape.values)
        case inspect.UnionType():
            return _made(rng.choice(shape.types), rng, wild)
        case inspect.TupleType():
            return [_made(each, rng, wild) for each in shape.item_types]
        case inspect.VarTupleType():
            return [_made(shape.item_type, rng, wild) for _ in range(rng.choice((0, 1, 1, 2, 3)))]
        case inspect.DictType():
            some = range(rng.choice((0, 1, 3)))
            names = [text(rng) if rng.random() < wild else rng.choice(NAMES) for _ in some]
            return {name: _made(shape.value_type, rng, wild) for name in names}
        case inspect.StructType():
            return _struct(shape, rng, wild)
    raise TypeError(f"no value for {shape}; teach tests/fuzz/values.py this type")


def _struct(shape: inspect.StructType, rng: Random, wild: float) -> Any:
    if shape.array_like:
        return [_made(field.type, rng, wild) for field in shape.fields]
    made = {}
    for field in shape.fields:
        if field.name == "schema" and rng.random() > 0.2 * wild:
            made["schema"] = field.default
        elif field.required or rng.random() < 0.6:
            made[field.name] = _made(field.type, rng, wild)
    return made
