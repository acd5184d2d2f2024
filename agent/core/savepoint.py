"""A savepoint: all that the kernel remembers, so that a step which breaks can be undone.

The kernel's state is Revertible objects, and dicts, lists, deques and sets, of things that never change: numbers,
tuples, frozen structs. A shallow copy of each container is enough, and takes a hundredth of the time of a deep one.
What lies in a tuple, a struct or an array is not looked into: tests/core/test_savepoint.py refuses state there.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from typing import Any

ROWS = (list, deque, set)
CONSTANT: set[type] = set()  # classes that were met and are known not to change


class Revertible:
    """Base of each class of the kernel whose objects change: a step that breaks puts back their attributes.

    It adds nothing to an object. The attributes lie in `__dict__`: such a class has no `__slots__`.
    """


class Savepoint:
    """The state of everything that can be reached from one object, at one moment."""

    def __init__(self, root: Revertible) -> None:
        self._objects: list[tuple[dict[str, Any], dict[str, Any]]] = []
        self._dicts: list[tuple[dict[Any, Any], dict[Any, Any]]] = []
        self._rows: list[tuple[Any, Any]] = []  # lists, deques and sets
        self._save(root)

    def restore(self) -> None:
        """Put everything back, in place: who shares a container goes on sharing it."""
        for now, then in (*self._objects, *self._dicts):
            now.clear()
            now.update(then)
        for row, before in self._rows:
            row.clear()
            row.update(before) if isinstance(row, set) else row.extend(before)

    def _save(self, root: Revertible) -> None:
        seen: set[int] = set()
        found: list[Any] = [root]
        while found:
            each = found.pop()
            if id(each) in seen:
                continue
            seen.add(id(each))
            kind: type = type(each)
            held: Collection[Any]
            if kind is dict:
                self._dicts.append((each, dict(each)))
                held = each.values()
            elif kind in ROWS:
                self._rows.append((each, tuple(each)))
                held = each
            else:
                self._objects.append((each.__dict__, dict(each.__dict__)))
                held = each.__dict__.values()
            # Hundreds of one kind that never changes are passed over at once.
            if unsure := set(map(type, held)) - CONSTANT:
                CONSTANT.update(kind for kind in unsure if not changes(kind))
                found += [one for one in held if type(one) not in CONSTANT]


def changes(kind: type) -> bool:
    """Whether things of this class may change."""
    return kind is dict or kind in ROWS or issubclass(kind, Revertible)
