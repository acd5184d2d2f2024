"""What a file is by its first bytes, and what the head of a picture says before anything is decoded.

`kind_of` tells what a file is, `stated_size` how large a picture says it is, `orientation` how its camera was held,
`several` whether there are more pictures in it, and `cut_off` whether it ends before its end.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from contextlib import suppress

# --- what a file is ---
# By its first bytes, for a name is what somebody wrote: half of what is sent as .jpg by telephones is HEIC.

PICTURES = frozenset({"PNG", "JPEG", "BMP", "TIFF", "WebP"})  # that can be read: their heads are checked first
OTHER_PICTURES = frozenset({"GIF", "HEIC", "AVIF", "JPEG XL", "JPEG 2000", "OpenEXR", "Photoshop", "camera raw"})
BRANDS = {b"avif": "AVIF", b"avis": "AVIF", b"crx ": "camera raw"}
BRANDS |= dict.fromkeys((b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"heif"), "HEIC")
MAGIC = {
    b"\x89PNG\r\n\x1a\n": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"GIF8": "GIF",
    b"\xff\x0a": "JPEG XL",
    b"\0\0\0\x0cJXL ": "JPEG XL",
    b"\0\0\0\x0cjP  ": "JPEG 2000",
    b"\xff\x4f\xff\x51": "JPEG 2000",
    b"v/1\x01": "OpenEXR",
    b"8BPS": "Photoshop",
    b"FUJIFILMCCD-RAW": "camera raw",
    b"IIRO": "camera raw",
    b"IIU\0": "camera raw",
    b"II*\0\x10\0\0\0CR": "camera raw",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"\x1a\x45\xdf\xa3": "a Matroska or WebM film",
    b"\x89MCAP0\r\n": "an MCAP recording",
    b"\x89MCAP0\n": "a recording that was copied in text mode, which changes line ends",
    b"version https://git-lfs": "a Git LFS pointer; fetch the file itself with: git lfs pull",
    b"\x1f\x8b": "compressed by gzip; unpack it first with: gunzip",
    b"\x28\xb5\x2f\xfd": "compressed by zstd; unpack it first with: unzstd",
    b"BZh": "compressed by bzip2; unpack it first with: bunzip2",
    b"\xfd7zXZ\0": "compressed by xz; unpack it first with: unxz",
    b"\x04\x22\x4d\x18": "compressed by lz4; unpack it first with: unlz4",
    b"PK\x03\x04": "a ZIP archive; unpack it first",
    b"7z\xbc\xaf": "a 7-Zip archive; unpack it first",
    b"%PDF": "a PDF",
    b"#ROSBAG": "a bag of ROS 1; convert it to MCAP first",
    b"SQLite format 3\0": "an SQLite database, perhaps a bag of ROS 2; convert it to MCAP first",
    b"BM": "BMP",
}


def kind_of(data: bytes) -> str | None:
    """What a file is by its first 64 bytes: one of PICTURES, of OTHER_PICTURES, or in words; None: nobody knows."""
    head = data[:64]
    for magic, kind in MAGIC.items():
        if head.startswith(magic):
            return kind
    if head[:4] == b"RIFF":
        return {b"WEBP": "WebP", b"AVI ": "an AVI film", b"WAVE": "a sound"}.get(head[8:12])
    if head[4:8] == b"ftyp":
        return BRANDS.get(head[8:12], "an MP4 film")
    if head.lstrip(b"\xef\xbb\xbf \r\n\t").lower().startswith((b"<!doctype html", b"<html")):
        return "a page of HTML, perhaps what a server said instead of the file; fetch it again"
    return "empty" if not data else None


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
        last = data[at + 4 : at + 8] == b"IEND"  # behind it may be anything
        at += 12 + struct.unpack_from(">I", data, at)[0]
        if at > len(data):
            return None
        if last:
            break
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
    size = [0, 0]
    for tag, value in _tags(data, order, *struct.unpack_from(order + "I", data, 4)):
        if tag in TIFF_SIZES:
            size[TIFF_SIZES[tag]] = max(size[TIFF_SIZES[tag]], value)
    return size[0], size[1]


def _tags(data: bytes, order: str, at: int) -> Iterator[tuple[int, int]]:
    """The tags of a directory that begins there, and the value of each that is one number."""
    (count,) = struct.unpack_from(order + "H", data, at)
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(order + "HH", data, entry)
        (value,) = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, entry + 8)
        yield tag, value


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    for marker, at, _ in _jpeg_segments(data) if data.startswith(b"\xff\xd8") else ():
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):  # start of a frame; those three are tables
            if at + 5 > len(data):
                return None
            height, width = struct.unpack_from(">HH", data, at + 1)
            return width, height
    return None


# --- the rest of a picture's head ---
# How the camera was held (EXIF, tag 0x0112), how many pictures there are, and whether all of the file is there.

UPRIGHT = 1
TURNED = 0x0112


def orientation(data: bytes) -> int:
    """1 to 8 as EXIF has it, 1 for upright and for what says nothing. Source: CIPA DC-008, 4.6.4."""
    with suppress(struct.error):
        if data.startswith(b"\xff\xd8"):
            for marker, at, length in _jpeg_segments(data):
                if marker == 0xE1 and data[at : at + 6] == b"Exif\0\0":
                    return _turned(data[at + 6 : at + length])
        elif data.startswith(b"\x89PNG"):
            at = data.find(b"eXIf", 8, data.find(b"IDAT") % (len(data) + 1))
            return _turned(data[at + 4 :]) if at > 0 else UPRIGHT
        elif data.startswith(b"RIFF") and data[12:16] == b"VP8X" and data[20] & 0x08:
            at = data.rfind(b"EXIF")
            return _turned(data[at + 8 :].removeprefix(b"Exif\0\0")) if at > 0 else UPRIGHT
        elif data.startswith((b"II*\0", b"MM\0*")):
            return _turned(data)
    return UPRIGHT


def _turned(tiff: bytes) -> int:
    """The tag of a TIFF head, which EXIF is."""
    order = "<" if tiff.startswith(b"II") else ">"
    for tag, value in _tags(tiff, order, *struct.unpack_from(order + "I", tiff, 4)):
        if tag == TURNED:
            return value if 1 <= value <= 8 else UPRIGHT
    return UPRIGHT


def several(data: bytes) -> bool:
    """Whether it is an animation (PNG, WebP), or pages (TIFF): of that only the first picture would be read."""
    with suppress(struct.error):
        if data.startswith(b"\x89PNG"):
            return b"acTL" in data[: data.find(b"IDAT") % (len(data) + 1)]
        if data.startswith(b"RIFF") and data[12:16] == b"VP8X":
            return bool(data[20] & 0x02)
        if data.startswith((b"II*\0", b"MM\0*")):
            order = "<" if data.startswith(b"I") else ">"
            (at,) = struct.unpack_from(order + "I", data, 4)
            (count,) = struct.unpack_from(order + "H", data, at)
            (after,) = struct.unpack_from(order + "I", data, at + 2 + 12 * count)
            return after != 0 and not _is_preview(data, order, after)
    return False


def _is_preview(data: bytes, order: str, at: int) -> bool:
    """Whether the second directory of a TIFF is a smaller copy of the picture (NewSubfileType)."""
    return any(tag == 254 and value & 1 for tag, value in _tags(data, order, at))


def cut_off(data: bytes) -> bool:
    """Whether a picture ends before its end: a decoder may fill the rest with grey. Behind the end may be anything."""
    if data.startswith(b"\xff\xd8"):
        at = max((at + length for marker, at, length in _jpeg_segments(data) if marker == SCAN), default=len(data))
        return all(found[0] != b"\xff\xd9" for found in JPEG_MARKER.finditer(data, at))
    if data.startswith(b"\x89PNG"):
        return b"IEND" not in data[-4096:] and b"IEND" not in data
    if data.startswith(b"RIFF"):
        return len(data) < 8 + int.from_bytes(data[4:8], "little")
    return False


SCAN = 0xDA
JPEG_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]")  # within a scan; the others are data, or restart it


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Marker, place and length of what each segment holds, up to the first scan's head, that included."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4])
        if marker == 0xFF:  # filled
            at += 1
            continue
        yield marker, at + 4, length - 2
        if marker == SCAN:
            return
        at += 2 + length
