"""What is wrong in a TOML file, in words: the key as the file spells it, and what may stand there instead."""

from __future__ import annotations

from typing import Any

import msgspec

ANY = "*"  # for msgspec's [...], which stands for the name of a table of which there may be several, such as robot.r1
NAME_RULE = "a name is a small letter and up to 15 small letters, digits or _"


def explain(error: msgspec.ValidationError, data: dict[str, Any], kind: Any) -> str:
    """One sentence about the first mistake in `data`, which could not be converted to the struct `kind`."""
    what, _, where = str(error).partition(" - at `")
    path = where.rstrip("`").replace("[...]", f".{ANY}").split(".")[1:]
    if where.startswith("key`"):  # the name of a table is itself the mistake
        path.append(ANY)
    key = ".".join(_named(path, data, kind, str(error))) or "top level"
    return f"key '{key}': {_remedy(what, path, kind)}"


def _named(path: list[str], data: dict[str, Any], kind: Any, error: str) -> list[str]:
    """The path with the name of the table in question: the one that makes the same mistake without the others."""
    if ANY not in path:
        return path
    at = path.index(ANY)
    above: Any = data
    for chunk in path[:at]:
        above = above[chunk]
    for name, value in above.items():
        alone: Any = {name: value}
        for chunk in reversed(path[:at]):
            alone = {chunk: alone}
        try:
            msgspec.convert({**data, **alone}, kind)
        except msgspec.ValidationError as same:
            if str(same) == error:
                return [*path[:at], name, *path[at + 1 :]]
    return path


def _remedy(what: str, path: list[str], kind: Any) -> str:
    if what.startswith("Object contains unknown field"):
        return f"unknown key {what.rsplit(' ', 1)[-1]}; remove it or correct its spelling"
    if what.startswith("Object missing required field"):
        return f"required key {what.rsplit(' ', 1)[-1]} is missing; add it"
    if what.startswith("Invalid enum value"):
        return f"{what.rsplit(' ', 1)[-1]} is no choice; write one of {', '.join(_choices(path, kind))}"
    if "matching regex" in what:
        return f"{NAME_RULE}; correct the name"
    return what[0].lower() + what[1:] + "; correct the value"


def _choices(path: list[str], kind: Any) -> list[str]:
    """The values of the Literal at `path` below the struct `kind`."""
    there: Any = msgspec.inspect.type_info(kind)
    for chunk in path:
        if isinstance(there, msgspec.inspect.StructType):
            there = next(field.type for field in there.fields if field.encode_name == chunk)
        elif isinstance(there, msgspec.inspect.DictType):
            there = there.value_type
    either = there.types if isinstance(there, msgspec.inspect.UnionType) else (there,)  # a Literal that may be left out
    return [str(value) for one in either for value in getattr(one, "values", ())]
