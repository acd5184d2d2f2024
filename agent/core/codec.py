"""Messages to bytes and back: the msgpack map of a struct. Only the shape of a message is checked here.

`Refusal` says why bytes are no message. Of texts that others made, `as_text` reads their encoding, and `too_deep` says
how deeply one is nested.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from contextlib import suppress
from typing import Literal, TypeVar

import msgpack
import msgspec

from agent.core.messages import MAX_PAYLOAD, SCHEMA, Message

M = TypeVar("M", bound=Message)

RefusalKind = Literal[
    "size",
    "garbage",
    "schema",
    "content",
    "address",
    "order",
    "place",
    "target",
    "clock",
    "fleet file",
    "quarantine",
    "signature",
]


READABLE = frozenset({1, 2, SCHEMA})  # schemas of recordings: what the later one added, older messages lack


class Refusal(ValueError):
    """A payload that is not believed: `kind` is what it is counted by, the text is for people."""

    def __init__(self, kind: RefusalKind, text: str) -> None:
        super().__init__(text)
        self.kind = kind


def encode(message: Message) -> bytes:
    """The msgpack map of a message, fields in the order of declaration: equal messages give equal bytes.

    Of a kind with more than 15 fields of which some are left out, the header has two bytes more than it needs.
    """
    return msgspec.msgpack.encode(message)


def decode(
    payload: bytes, kind: type[M], limit: int = MAX_PAYLOAD, accepted: Collection[int] = frozenset({SCHEMA})
) -> M:
    """Bytes -> struct. Raises Refusal for anything that is not a message of this kind and an accepted schema."""
    if len(payload) > limit:
        raise Refusal("size", f"{len(payload)} bytes, limit {limit}")
    try:
        fields = msgpack.unpackb(payload, strict_map_key=True)
    except (ValueError, msgpack.UnpackException, RecursionError):
        raise Refusal("garbage", "not msgpack") from None
    if not isinstance(fields, dict):
        raise Refusal("garbage", "not a map")
    if "schema" in kind.__struct_fields__:
        said = fields.get("schema")
        if type(said) is not int:
            what = f"schema of type {type(said).__name__}" if "schema" in fields else "no schema"  # a repr has no end
            raise Refusal("schema", f"{what}, ours is {SCHEMA}")
        if said not in accepted:
            raise Refusal("schema", f"schema {said}, ours is {SCHEMA}")
    try:
        return msgspec.convert(kind.upgraded(fields), kind, builtin_types=(bytes,))
    except msgspec.ValidationError as error:
        raise Refusal("content", str(error)[:200]) from None
    except RecursionError:
        raise Refusal("content", "nested too deeply") from None


def prepare() -> None:
    """Have msgspec look into all kinds of messages, before a second thread reads any.

    Two threads that do it at the same time end in a segmentation fault (seen with msgspec 0.22.0).
    """
    kinds: list[type[Message]] = [Message]
    for kind in kinds:
        kinds += kind.__subclasses__()
        with suppress(msgspec.ValidationError):
            msgspec.convert(None, kind)


def encoding(kind: type[Message]) -> str:
    """The encoding string that every sample of this kind carries."""
    return f"application/msgpack;aucamp.{kind.__name__}"


def printable(text: str) -> str:
    """The same in one line that steers no terminal."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


# --- text ---
# As editors of all countries write it: with a mark of its encoding, or in UTF-16.


def as_text(data: bytes) -> str:
    """UTF-8 with or without its mark, or UTF-16 with one. Raises UnicodeDecodeError."""
    return data.decode("utf-16" if data.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig")


# --- nesting of a text ---
# A parser takes stack for each level of nesting, and for a dotted key memory that grows with the square of its parts.

MOST_DEEP = 32  # tables and lists in each other, and parts of a dotted key: a fleet file has six
# Strings and comments, of TOML and of JSON; one that does not end goes to the end of its line or of the text.
QUOTED = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"""|\Z)'
    r"|'''(?:[^']|'(?!''))*+(?:'''|\Z)"
    r'|"(?:[^"\\\n]|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+",
    re.DOTALL,
)
DOTTED = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{MOST_DEEP}}}")


def too_deep(text: str) -> bool:
    """Whether TOML or JSON is nested more than MOST_DEEP deep."""
    bare, depth = QUOTED.sub("_", text), 0
    for bracket in re.findall(r"[][{}]", bare):
        depth = depth + 1 if bracket in "[{" else max(depth - 1, 0)
        if depth > MOST_DEEP:
            return True
    return DOTTED.search(bare) is not None
