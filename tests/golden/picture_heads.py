"""What the heads of small pictures say: `picture_heads.jsonl`, each picture as hex digits and what is read of it.

The pictures were made once, by OpenCV and by hand, and stay as they are. `python -m tests.golden.picture_heads` reads
them again after a change that is meant.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator

import cv2
import numpy as np

from agent.core.picture_head import cut_off, kind_of, orientation, several, stated_size
from tests.places import GOLDEN

FILE = GOLDEN / "picture_heads.jsonl"
EXIF = b"II*\0\x08\0\0\0\x01\0" + struct.pack("<HHIH2x", 0x0112, 3, 1, 6) + bytes(4)  # turned by a quarter


def said(data: bytes) -> dict[str, object]:
    return {
        "kind": kind_of(data),
        "size": stated_size(data),
        "orientation": orientation(data),
        "several": several(data),
        "cut_off": cut_off(data),
    }


def read() -> list[dict[str, object]]:
    """The rows of the file, what is said of each picture read anew."""
    rows = [json.loads(line) for line in FILE.read_text().splitlines()]
    return [{"name": row["name"], "hex": row["hex"], **said(bytes.fromhex(row["hex"]))} for row in rows]


def pictures() -> Iterator[tuple[str, bytes]]:
    """Of 7 x 5 pixels."""
    image = np.arange(105, dtype=np.uint8).reshape(5, 7, 3)
    made = {kind: cv2.imencode(f".{kind}", image)[1].tobytes() for kind in ("png", "jpg", "bmp", "tiff", "webp")}
    yield from made.items()
    yield "jpg turned", made["jpg"][:2] + segment(0xE1, b"Exif\0\0" + EXIF) + made["jpg"][2:]
    yield "jpg filled", made["jpg"][:2] + b"\xff" + made["jpg"][2:]
    yield "jpg cut", made["jpg"][:-40]
    yield "png turned", made["png"][:33] + chunk(b"eXIf", EXIF) + made["png"][33:]
    yield "png animated", made["png"][:33] + chunk(b"acTL", bytes(8)) + made["png"][33:]
    yield "png cut", made["png"][:-8]
    vp8x = struct.pack("<I4s3s3s", 10, bytes((0x0A, 0, 0, 0)), (6).to_bytes(3, "little"), (4).to_bytes(3, "little"))
    webp = b"WEBPVP8X" + vp8x + b"EXIF\x1a\0\0\0" + EXIF
    yield "webp animated and turned", b"RIFF" + struct.pack("<I", len(webp)) + webp
    yield "tiff of two pages", b"MM\0*\0\0\0\x08" + page(8 + 30) + page(0)
    yield "tiff and its preview", b"MM\0*\0\0\0\x08" + page(8 + 30) + page(0, preview=True)
    for name in ("heic", "avif", "isom"):
        yield name, b"\0\0\0\x18ftyp" + name.encode() + bytes(12)
    yield "page", b"\n<!DOCTYPE html><html>"
    yield "nothing", b""
    yield "text", b"hello"


def segment(marker: int, data: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(data) + 2) + data


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def page(after: int, preview: bool = False) -> bytes:
    """A directory of a TIFF with its width, or what kind of copy it is, and its height."""
    first = (254, 4, 1, 1) if preview else (256, 4, 1, 7)
    return (
        struct.pack(">H", 2)
        + struct.pack(">HHII", *first)
        + struct.pack(">HHII", 257, 4, 1, 5)
        + struct.pack(">I", after)
    )


if __name__ == "__main__":
    known = {row["name"]: bytes.fromhex(row["hex"]) for row in read()} if FILE.exists() else dict(pictures())
    lines = (json.dumps({"name": name, "hex": data.hex(), **said(data)}) for name, data in known.items())
    FILE.write_text("\n".join(lines) + "\n")
