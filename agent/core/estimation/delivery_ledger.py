"""What one neighbour is known to hold, and what it is still owed.

Nothing is taken for delivered because it was sent. A version counts as held once the neighbour shows it, in its
digest or by sending it to us; until then it is owed and goes out again, whatever the link does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

from agent.core.messages import Holding
from agent.core.savepoint import Revertible

Key = TypeVar("Key", bound=tuple[Any, ...])  # begins with origin and incarnation

DIGEST_NS = 1_000_000_000  # a digest at least this often: repairs what stopped changing
LINES = 64  # of a digest in one message; longer ones go out in turns


class DeliveryLedger(Revertible, Generic[Key]):
    """Bookkeeping for one neighbour in one epoch."""

    def __init__(self) -> None:
        self._held: dict[Key, int] = {}
        self._sent: dict[Key, int] = {}
        self._turn = 0
        self._digested: tuple[int, int] | None = None  # which state of the table the last digest showed, and when
        self._line = 0

    def forget(self) -> None:
        """The neighbour started again and holds nothing."""
        self._held = {}
        self._digested = None

    def acknowledge(self, key: Key, version: int) -> None:
        """The neighbour's word on what it holds; later words replace earlier ones, downwards too."""
        self._held[key] = version

    def pending(self, versions: Mapping[Key, int], own: tuple[str, int], limit: int) -> list[Key]:
        """What to send now: own evidence first, then what was sent longest ago, at most `limit`."""
        waiting = [key for key, version in versions.items() if version > self._held.get(key, 0)]
        waiting.sort(key=lambda key: (key[:2] != own, self._sent.get(key, -1)))  # stable: else as `versions` has it
        self._turn += 1
        for key in waiting[:limit]:
            self._sent[key] = self._turn
        return waiting[:limit]

    def digest(self, lines: Sequence[Holding], change: int, now_ns: int) -> tuple[Holding, ...]:
        """The lines that go with this message: all when the table changed or a second has passed, else none; of a
        table longer than LINES the next part, with every message."""
        if len(lines) > LINES:
            start, self._line = self._line, self._line + LINES
            if self._line >= len(lines):
                self._line = 0
            return tuple(lines[start : start + LINES])
        if self._digested is not None:
            shown, shown_ns = self._digested
            if change == shown and now_ns - shown_ns < DIGEST_NS:
                return ()
        self._digested = (change, now_ns)
        return tuple(lines)

    def drop(self, kept: Mapping[Key, object]) -> None:
        """Forget about what is no longer in the table."""
        self._held = {key: version for key, version in self._held.items() if key in kept}
        self._sent = {key: turn for key, turn in self._sent.items() if key in kept}
