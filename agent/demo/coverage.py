"""How far a survey has come, by what robots tell each other of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from agent.core.capability_messages import Claim
from agent.core.config import Fleet


class SurveyWatch:
    """The newest claim of each robot; of a fleet without [coverage] there is none."""

    def __init__(self, fleet: Fleet) -> None:
        self.robots, self._settings = tuple(fleet.robot), fleet.coverage
        self._newest: dict[str, Claim] = {}

    def add(self, claim: Claim) -> None:
        before = self._newest.get(claim.src)
        if claim.src in self.robots and (before is None or claim.sent_ns >= before.sent_ns):
            self._newest[claim.src] = claim

    def newest(self) -> dict[str, Claim]:
        """Of each robot that was heard."""
        return self._newest

    def usual_digest(self) -> str:
        """That of most maps; of as many that which was heard first."""
        counts = Counter(claim.digest for claim in self._newest.values()).most_common(1)
        return counts[0][0] if counts else ""

    @property
    def over(self) -> bool:
        """Everybody knows all that is asked for, and has the same map."""
        return not list(self.reasons())

    def shares(self) -> dict[str, float | None]:
        """Of the wanted cells that each robot's map knows well enough; None: never heard."""
        return {name: None if name not in self._newest else self._newest[name].share for name in self.robots}

    def equal(self) -> bool:
        """Whether all have said the same of their maps last."""
        digests = {self._newest[name].digest if name in self._newest else None for name in self.robots}
        return len(digests) == 1 and None not in digests

    def reasons(self) -> Iterator[str]:
        """Why the survey has not succeeded, or not yet."""
        assert self._settings is not None
        for name, share in self.shares().items():
            if share is None:
                yield f"{name} never said what it holds"
            elif share < self._settings.share:
                yield f"{name} knows {100 * share:.1f} % of what is wanted < {100 * self._settings.share:.0f} %"
        if not self.equal():
            yield "the robots' maps differ"

    def as_json(self) -> dict[str, Any]:
        """`coverage` of summary.json. keyframes: how many of each robot's everybody holds."""
        assert self._settings is not None
        held = {name: {has.origin: has.upto for has in claim.has} for name, claim in self._newest.items()}
        keyframes = {name: min((each.get(name, 0) for each in held.values()), default=0) for name in self.robots}
        return {
            "wanted_share": self._settings.share,
            "goal_mm": self._settings.goal_mm,
            "cell_mm": self._settings.cell_mm,
            "faces": list(self._settings.faces),
            "share": self.shares(),
            "maps_equal": self.equal(),
            "digest": {name: claim.digest for name, claim in sorted(self._newest.items())},
            "keyframes": keyframes,
        }

    def lines(self) -> Iterator[str]:
        """For people."""
        told = self.as_json()
        shares = (
            f"{name} {'-' if share is None else format(100 * share, '.1f')} %" for name, share in told["share"].items()
        )
        yield f"known of {', '.join(told['faces'])} and what lies there: {', '.join(shares)}"
        each = ", ".join(f"{name} {count}" for name, count in told["keyframes"].items())
        yield f"keyframes that all hold: {each}; maps {'are equal' if told['maps_equal'] else 'differ'}"
