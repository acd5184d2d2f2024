"""Messages to bytes and back: the msgpack map of a struct. Only the shape of a message is checked here.

`Refusal` says why bytes are no message. `stated_size` reads how large a picture says it is before it is decoded,
`too_deep` how deeply a text is nested.
"""

from __future__ import annotations

import re
import struct
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
    """The msgpack map of a message, fields in the order of declaration: equal messages give equal bytes."""
    return bytes(msgpack.packb(msgspec.to_builtins(message, builtin_types=(bytes,))))


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
            raise Refusal("schema", f"schema of type {type(said).__name__}, ours is {SCHEMA}")  # a repr has no end
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


# --- stated size of a picture ---
# A decoder takes as much memory as the head of a picture asks for, so the head is read first.


def stated_size(data: bytes) -> tuple[int, int] | None:
    """Width and height in pixels as the head of a PNG, JPEG, BMP, WebP or TIFF states them; None where it is none.

    Source: W3C PNG, 11.2.2 (IHDR); ITU-T T.81, B.1.1.3 and B.2.2 (markers and frame header); BITMAPCOREHEADER and
    BITMAPINFOHEADER; RFC 9649, 2.5 to 2.7; TIFF 6.0, section 2.
    """
    with suppress(struct.error):
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            return _png_size(data)
        if data.startswith(b"BM"):
            short = struct.unpack_from("<I", data, 14)[0] == 12
            width, height = struct.unpack_from("<HH" if short else "<ii", data, 18)
            return abs(width), abs(height)
        if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
            return _webp_size(data)
        if data.startswith((b"II*\0", b"MM\0*")):
            return _tiff_size(data, "<" if data.startswith(b"I") else ">")
    return _jpeg_size(data)


def _png_size(data: bytes) -> tuple[int, int] | None:
    """None where a chunk says that it is longer than there is: a decoder sets aside memory for all of it."""
    at = 8
    while data[at : at + 4]:
        at += 12 + struct.unpack_from(">I", data, at)[0]
        if at > len(data):
            return None
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _webp_size(data: bytes) -> tuple[int, int] | None:
    match data[12:16]:
        case b"VP8X":
            return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
        case b"VP8L":
            (bits,) = struct.unpack_from("<I", data, 21)
            return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
        case b"VP8 ":
            width, height = struct.unpack_from("<HH", data, 26)
            return width & 0x3FFF, height & 0x3FFF
    return None


TIFF_SIZES = {256: 0, 322: 0, 257: 1, 323: 1}  # tags of width and height: of the picture, and of a tile


def _tiff_size(data: bytes, order: str) -> tuple[int, int]:
    """Of the first picture; of a tag that comes twice, the larger."""
    (at,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, at)
    size = [0, 0]
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(order + "HH", data, entry)
        if tag in TIFF_SIZES:
            (value,) = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, entry + 8)
            size[TIFF_SIZES[tag]] = max(size[TIFF_SIZES[tag]], value)
    return size[0], size[1]


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    while data.startswith(b"\xff\xd8") and at + 9 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4])
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):  # start of a frame; those three are tables
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        at += 2 + length
    return None


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
