"""Write docs/schemas/ and the tables of docs/messages.md from the structs: `python docs/write_messages.py`."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agent.core import topics
from agent.core.codec import encoding
from agent.core.messages import MAX_ORDER
from agent.ground.schemas import QUERIES, TOKENS, kinds, schema, write

PAGE = Path(__file__).with_name("messages.md")
SCHEMAS = Path(__file__).with_name("schemas")
SEVERAL = 3  # messages with the same field: it is explained once
BEGIN, END = "<!-- tables: python docs/write_messages.py -->\n", "<!-- end of tables -->\n"


def tables() -> str:
    """All that is generated in the page."""
    wholes = {encoding(kind): schema(kind) for kind in kinds()}
    counts = Counter(row for whole in wholes.values() for row in rows(whole).values())
    common = [row for row, count in counts.items() if count >= SEVERAL]
    sections, told = [keys(), "\n".join(["### In several messages", "", *HEAD, *common]) + "\n"], set[str]()
    for name, whole in wholes.items():
        lead = f"`{name}`, [schema](schemas/{whole['title']}.json). "
        sections.append(section(whole, lead, common))
        parts = whole.get("$defs", {})
        sections += [section(part) for title, part in parts.items() if title not in told]
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


HEAD = ("| field | type | what it is |", "|---|---|---|")


def section(part: dict[str, Any], lead: str = "", common: Sequence[str] = ()) -> str:
    """One struct: what it is, and a row for each of its fields that is not common to several."""
    how = "" if "properties" in part else " Travels as an array, in this order."
    of_all = [f"`{name}`" for name, row in rows(part).items() if row in common]
    also = f" With {', '.join(of_all)} of [several](#in-several-messages)." if of_all else ""
    own = [row for row in rows(part).values() if row not in common]
    return "\n".join([f"### {part['title']}", "", f"{lead}{part['description']}{how}{also}", "", *HEAD, *own]) + "\n"


def rows(part: dict[str, Any]) -> dict[str, str]:
    """Of each field of a struct."""
    fields = part.get("properties") or {item["title"]: item for item in part["prefixItems"]}
    found = {}
    for name, field in fields.items():
        needed = name in part.get("required", ()) or ("properties" not in part and "default" not in field)
        kind = f"{type_of(field)}{'' if needed else ', optional'}"
        found[name] = f"| `{name}` | {kind} | {field['description']} |"
    return found


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
