"""Messages against the JSON Schemas that ship, by somebody else's validator."""

import base64
import json
from functools import cache
from typing import Any

import msgpack
from jsonschema import Draft202012Validator

from tests.places import ROOT

SCHEMAS = ROOT / "docs" / "schemas"


@cache
def validator(message: str) -> Draft202012Validator:
    """For messages of this name; the schema itself is one."""
    schema = json.loads((SCHEMAS / f"{message}.json").read_text(encoding="utf-8"))
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def wrong(message: str, payload: bytes) -> list[str]:
    """What the schema says against a payload as it came from the network; nothing if it is right."""
    value = in_json(msgpack.unpackb(payload))
    return [f"{error.json_path}: {error.message}"[:200] for error in validator(message).iter_errors(value)]


def in_json(value: Any) -> Any:
    """The same value as JSON can have it: bytes in base64."""
    if isinstance(value, dict):
        return {name: in_json(part) for name, part in value.items()}
    if isinstance(value, list):
        return [in_json(part) for part in value]
    return base64.b64encode(value).decode() if isinstance(value, bytes) else value
