"""Whose word counts about whom.

With keys: a robot's evidence counts from any mouth as long as its signature is right. Verifying costs a tenth of a
millisecond, so each neighbour has a budget of it; a wrong signature empties the budget of who passed it on, for honest
robots verify before they do.

Without keys: while a robot is heard directly, only its own mouth counts about it. About robots that are out of reach a
relay is believed: nothing is known against it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from agent.core import signed
from agent.core.savepoint import Revertible

DIRECT_NS = 3_000_000_000  # a robot heard directly this lately speaks for itself
VERIFIED_HZ = 20.0  # signatures of each neighbour, at most; a swarm of ten needs ten a second of all together
BURST = 20.0

Verify = Callable[[bytes, bytes, bytes], bool]  # public key, signature, what was signed
OVERDRAWN = "not yet verified"  # comes again: what is not shown to be held is sent again
HEARSAY = "hearsay"  # no fault of the relay: it cannot know whom we hear ourselves


class Authority(Revertible):
    """One robot's judgement of mouths, for one target."""

    def __init__(self, neighbours: tuple[str, ...], verify: Verify = signed.verify) -> None:
        self._verify = verify
        self.keys: Mapping[str, bytes] | None = None  # public, by robot; None: a fleet without keys
        self._heard_ns: dict[str, int] = {}  # directly
        self._budget: dict[str, tuple[float, int]] = {name: (BURST, 0) for name in neighbours}  # at a time

    def heard(self, src: str, now_ns: int) -> None:
        """A message of this neighbour's came."""
        self._heard_ns[src] = now_ns
        budget, at_ns = self._budget[src]
        self._budget[src] = min(BURST, budget + VERIFIED_HZ * max(0, now_ns - at_ns) * 1e-9), now_ns

    def speaks_for_itself(self, origin: str, now_ns: int) -> bool:
        """Whether a robot was heard directly of late."""
        heard_ns = self._heard_ns.get(origin)
        return heard_ns is not None and now_ns - heard_ns <= DIRECT_NS

    def fault(self, src: str, origin: str, signature: bytes, says: Callable[[], bytes], now_ns: int) -> str | None:
        """Why what `src` passes on as the word of `origin` does not count, in a word to count by; None: it counts.

        says: what the origin signed, made only if it is looked at.
        """
        if self.keys is None:
            return HEARSAY if src != origin and self.speaks_for_itself(origin, now_ns) else None
        key = self.keys.get(origin)
        if key is None:
            return "no key"
        if not signature:
            return "unsigned"
        budget, at_ns = self._budget[src]
        if budget < 1.0:
            return OVERDRAWN
        self._budget[src] = budget - 1.0, at_ns
        if self._verify(key, signature, says()):
            return None
        self._budget[src] = 0.0, at_ns
        return "bad signature"
