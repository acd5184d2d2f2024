"""One reader of bytes from outside, and the next bytes for it."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from random import Random
from typing import Any, NamedTuple

import msgpack
import tomli_w
import yaml

from tests.fuzz import mutate

POOL = 400  # well-formed payloads that are mutated


class Form(NamedTuple):
    """How a payload is written, so that its fields can be changed."""

    opened: Callable[[bytes], Any]
    closed: Callable[[Any], bytes]
    bomb: Callable[[Random], bytes]


class Decoder(NamedTuple):
    name: str
    take: Callable[[bytes], object]  # raises what should never be raised, AssertionError too
    sound: Callable[[Random], bytes]  # what it was made for, or nearly
    form: Form | None = None
    share: float = 1.0  # of the payloads that others get: less for what takes long
    slow_s: float = 0.1  # of the processor: no payload may take longer


def bytes_for(one: Decoder, pool: list[bytes], rng: Random) -> bytes:
    """The next bytes for a decoder: sound, mutated as fields or as bytes, a bomb or noise. `pool`: sound ones."""
    pick = rng.random()
    if pick < 0.2 or not pool:
        made = one.sound(rng)
        pool.append(made) if len(pool) < POOL else pool.__setitem__(rng.randrange(POOL), made)
        return made
    payload = rng.choice(pool)
    if one.form is not None and pick < (0.45 if one.form is MSGPACK else 0.7):  # of a text most bytes break the form
        return _changed(one.form, payload, rng)
    if pick < 0.92:
        return mutate.raw(payload, rng)
    return mutate.bomb(rng) if one.form is None else one.form.bomb(rng)


def _changed(form: Form, payload: bytes, rng: Random) -> bytes:
    try:
        return form.closed(mutate.fields(form.opened(payload), rng, rng.choice((1, 1, 3))))
    except (ValueError, OverflowError, TypeError, msgpack.UnpackException, yaml.YAMLError):
        return payload[: rng.randrange(len(payload) + 1)]


def _written(value: Any) -> Any:
    """The same of what TOML, JSON and YAML have."""
    if isinstance(value, dict):
        return {str(name): _written(part) for name, part in value.items() if part is not None}
    if isinstance(value, list):
        return [_written(part) for part in value if part is not None]
    return value.hex() if isinstance(value, bytes) else value


def _text(text: str) -> bytes:
    return text.encode("utf-8", errors="surrogatepass")


MSGPACK = Form(msgpack.unpackb, lambda value: bytes(msgpack.packb(value)), mutate.bomb)
TOML = Form(
    lambda data: tomllib.loads(data.decode()), lambda value: _text(tomli_w.dumps(_written(value))), mutate.text_bomb
)
JSON = Form(json.loads, lambda value: _text(json.dumps(_written(value), ensure_ascii=False)), mutate.text_bomb)
YAML = Form(yaml.safe_load, lambda value: _text(yaml.safe_dump(_written(value))), mutate.text_bomb)
