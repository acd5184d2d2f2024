"""Write docs/schemas/ and the tables of docs/messages.md from the structs: `python docs/write_messages.py`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from agent.core import topics
from agent.core.codec import encoding
from agent.core.messages import MAX_ORDER
from agent.ground.schemas import QUERIES, TOKENS, kinds, schema, write

PAGE = Path(__file__).with_name("messages.md")
SCHEMAS = Path(__file__).with_name("schemas")
BEGIN, END = "<!-- tables: python docs/write_messages.py -->\n", "<!-- end of tables -->\n"


def tables() -> str:
    """All that is generated in the page."""
    sections, told = [keys()], set[str]()
    for kind in kinds():
        whole = schema(kind)
        parts = whole.get("$defs", {})
        sections.append(section(whole, f"`{encoding(kind)}`, [schema](schemas/{whole['title']}.json). "))
        sections += [section(part) for name, part in parts.items() if name not in told]
        told |= parts.keys()
    return "\n".join(sections)


def keys() -> str:
    """The table of topics."""
    lines = ["| key | message | rate | QoS, largest size |", "|---|---|---|---|"]
    for row in topics.TOPICS:
        rate = f"{row.hz:g} Hz" if row.hz else "on events"
        name = row.message.__name__
        size = f"{row.qos.reliability.lower().replace('_', ' ')}, {row.limit} bytes"
        lines.append(f"| `{row.key}` | [`{name}`](#{name.lower()}) | {rate} | {size} |")
    lines += [
        f"| `{key}` | [`{kind.__name__}`](#{kind.__name__.lower()}), a query: {about} | on events | {MAX_ORDER} bytes |"
        for key, (kind, about) in QUERIES.items()
    ]
    lines += [f"| `{key}` | liveliness token without payload: {about} | | |" for key, about in TOKENS.items()]
    return "\n".join(lines) + "\n"


def section(part: dict[str, Any], lead: str = "") -> str:
    """One struct: what it is, and a row for each of its fields."""
    fields = part.get("properties") or {item["title"]: item for item in part["prefixItems"]}
    how = "" if "properties" in part else " Travels as an array, in this order."
    lines = [f"### {part['title']}", "", f"{lead}{part['description']}{how}", "", "| field | type | what it is |"]
    lines += ["|---|---|---|"]
    for name, field in fields.items():
        needed = name in part.get("required", ()) or ("properties" not in part and "default" not in field)
        kind = f"{type_of(field)}{'' if needed else ', may be left out'}"
        lines.append(f"| `{name}` | {kind} | {field['description']} |")
    return "\n".join(lines) + "\n"


def type_of(field: dict[str, Any]) -> str:
    """A type in a few words, as msgpack has it."""
    if "anyOf" in field:
        return " or ".join(type_of(one) for one in field["anyOf"])
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "enum" in field:
        return ", ".join(f'`"{value}"`' for value in field["enum"])
    kind = field["type"]
    if kind == "array":
        if "prefixItems" in field:
            return f"array of {len(field['prefixItems'])} numbers"
        return f"array of {type_of(field['items'])}"
    if kind == "object":
        return f"map to {type_of(field['additionalProperties'])}"
    if field.get("contentEncoding") == "base64":
        return "bin"
    return {"null": "nil", "string": "str", "boolean": "bool"}.get(kind, str(kind))


def with_tables(page: str) -> str:
    """The page with its tables made anew."""
    return re.sub(f"{BEGIN}.*{END}", lambda _: f"{BEGIN}\n{tables()}\n{END}", page, flags=re.DOTALL)


if __name__ == "__main__":
    SCHEMAS.mkdir(exist_ok=True)
    write(SCHEMAS)
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
