"""What is on the network, for other programs: a JSON Schema of each message, the table of topics, and the decoder of
the zenoh command line.

All of it is made from the structs and from the table of topics that the robots themselves use.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgpack
import msgspec

from agent.core import capability_messages, messages, topics
from agent.core.codec import encoding
from agent.core.config import write_whole
from agent.core.messages import MAX_ORDER, SCHEMA, Answer, Message, Order
from agent.core.topics import TOPICS

DIALECT = "https://json-schema.org/draft/2020-12/schema"
AS_MSGPACK = (
    "A message is one msgpack map with these keys. A string with contentEncoding base64 is msgpack's bin there, "
    "the bytes themselves: write them in base64 before you check a message against this schema."
)
INDEX = "topics.json"
TOKENS = {
    topics.ALIVE: "an agent of this robot runs; the token goes with its session",
    topics.TWICE: "the witness is linked to two agents of this robot's name",
}
QUERIES = {
    topics.ORDER: (Order, "what somebody at a console wants of a robot; the reply is an Answer, of the same key")
}


def schema(kind: type[Message]) -> dict[str, Any]:
    """The JSON Schema of one message, with all that is in it."""
    (reference,), parts = msgspec.json.schema_components((kind,))
    for name, part in parts.items():
        if part["type"] == "array":  # a struct that travels without the names of its fields
            for field, item in zip(_struct(name).__struct_fields__, part["prefixItems"], strict=True):
                item["title"] = field
        elif "schema" in part["properties"]:
            part["properties"]["schema"]["const"] = SCHEMA
            part["required"].insert(0, "schema")  # it has a default for us who write it; who reads it insists
    top = parts.pop(reference["$ref"].rpartition("/")[2])
    return {"$schema": DIALECT, **top, "$comment": AS_MSGPACK, **({"$defs": parts} if parts else {})}


def _struct(name: str) -> Any:
    """A part of a message, by its name."""
    return next(
        getattr(home, name)
        for home in (messages, capability_messages, capability_messages, capability_messages)
        if hasattr(home, name)
    )


def index() -> dict[str, Any]:
    """Which message is on which key, and the liveliness tokens."""
    return {
        "schema": SCHEMA,
        "topics": [
            {
                "name": row.name,
                "key": row.key,
                "encoding": encoding(row.message),
                "message": row.message.__name__,
                "json_schema": file_name(row.message),
                "hz": row.hz or None,
                "reliability": row.qos.reliability,
                "priority": row.qos.priority,
                "max_bytes": row.limit,
            }
            for row in TOPICS
        ],
        "liveliness": [{"key": key, "description": about} for key, about in TOKENS.items()],
        "queries": [
            {
                "key": key,
                "encoding": encoding(kind),
                "message": kind.__name__,
                "json_schema": file_name(kind),
                "reply": Answer.__name__,
                "max_bytes": MAX_ORDER,
                "description": about,
            }
            for key, (kind, about) in QUERIES.items()
        ],
    }


def kinds() -> tuple[type[Message], ...]:
    """Every kind of message that there is a schema of."""
    return (*(row.message for row in TOPICS), *(kind for kind, _ in QUERIES.values()))


def file_name(kind: type[Message]) -> str:
    return f"{kind.__name__}.json"


def texts() -> dict[str, str]:
    """All files: name -> content."""
    files = {INDEX: index(), **{file_name(kind): schema(kind) for kind in kinds()}}
    return {name: json.dumps(content, indent=2) + "\n" for name, content in files.items()}


def write(folder: Path) -> list[Path]:
    """Write all of them into a folder that is there; returns their paths."""
    written = []
    for name, text in texts().items():
        write_whole(folder / name, text)
        written.append(folder / name)
    return written


# --- decoder of the zenoh command line ---
# What the command line of Zenoh shows of our traffic, when told `--decoder aucamp`.
#
# zenoh-cli finds `decode` through the entry point group `zenoh_cli.codecs.decoders`.


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
