"""A case is worth reading when it is small: parts are left out as long as the fault stays (delta debugging).

Zeller and Hildebrandt, Simplifying and isolating failure-inducing input, IEEE Transactions on Software Engineering,
2002: halves first, then smaller parts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def shrink(parts: list[T], fails: Callable[[list[T]], bool], tries: int) -> list[T]:
    """As few of the parts, in their order, as still fail; all of them if they do not fail a second time."""
    if not fails(parts):
        return parts
    size = max(1, len(parts) // 2)
    while tries > 0:
        shorter = False
        at = 0
        while at < len(parts) and tries > 0:
            rest = parts[:at] + parts[at + size :]
            tries -= 1
            if rest and fails(rest):
                parts, shorter = rest, True
            else:
                at += size
        if size == 1 and not shorter:
            break
        size = max(1, size // 2)
    return parts
