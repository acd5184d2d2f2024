"""What the command line of Zenoh shows of our traffic, when told `--decoder aucamp`.

zenoh-cli finds `decode` through the entry point group `zenoh_cli.codecs.decoders`.
"""

from __future__ import annotations

import json
from typing import Any

import msgpack


def decode(key: object, value: bytes) -> str:
    """One line for one payload: a message as JSON, text as text, the rest as '<n bytes>'. Never raises.

    zenoh-cli passes the key as well; a payload is told by its own shape, so that a stranger's shows up too.
    """
    try:
        fields = msgpack.unpackb(value, strict_map_key=False)
        if isinstance(fields, dict):
            return json.dumps(_printable(fields))
    except (ValueError, TypeError, RecursionError, msgpack.UnpackException):
        pass  # not a message: shown by what it is, below
    try:
        text = value.decode("utf-8")
    except UnicodeDecodeError:
        return _size(value)
    # Quoted unless plain: a payload must not steer the terminal, or break the line.
    return text if text.isprintable() and text.isascii() else json.dumps(text)


def _printable(value: Any) -> Any:
    """The value with everything JSON has no form for written out."""
    if isinstance(value, dict):
        return {str(name): _printable(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_printable(part) for part in value]
    if isinstance(value, bytes):
        return _size(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)


def _size(value: bytes) -> str:
    kind = "jpeg " if value.startswith(b"\xff\xd8\xff") else ""
    return f"<{kind}{len(value)} bytes>"
