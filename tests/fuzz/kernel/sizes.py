"""How large the largest container of an object is: memory that grows with what others send is found by its length."""

from __future__ import annotations

from collections import deque
from typing import Any

import msgspec

PLAIN = (int, float, str, bytes, bool, type(None), type)


def largest(root: Any) -> tuple[int, str]:
    """(length, where) of the longest dict, list, set, tuple or deque that is reached from an object."""
    seen: set[int] = set()
    waiting: list[tuple[Any, str]] = [(root, type(root).__name__)]
    found = (0, "nothing")
    while waiting:
        value, where = waiting.pop()
        if isinstance(value, PLAIN) or id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, dict):
            found = max(found, (len(value), where))
            waiting += ((each, f"{where}[...]") for each in value.values())
        elif isinstance(value, (list, tuple, set, frozenset, deque)):
            found = max(found, (len(value), where))
            waiting += ((each, f"{where}[...]") for each in value)
        elif not isinstance(value, msgspec.Struct) and hasattr(value, "__dict__"):
            waiting += ((each, f"{where}.{name}") for name, each in vars(value).items())
    return found
