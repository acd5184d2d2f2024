"""Messages decoded and validated: everything heard is decoded and checked here; what is not believed is counted."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import UNSET

from agent.core.codec import Refusal, decode
from agent.core.config import Tank
from agent.core.estimation.evidence_table import inside, is_covariance
from agent.core.messages import Estimate
from agent.core.status import Status
from agent.core.step_io import DroppedPayloads, Heard
from agent.core.step_transaction import Revertible
from agent.core.target_state import TargetState
from agent.robot.arbiter import Equipment

FOR_PEOPLE = ("clock", "fleet file", "schema")  # refusals that people have to put right
FAULT_NS = 10_000_000_000  # how long such a thing is told after it was last seen


class Inbox(Revertible):
    """Counters of refusals by kind; the kinds are few, so a stranger cannot make them grow."""

    def __init__(
        self, targets: Mapping[str, TargetState], tank: Tank, common: str, schema: int, equipment: Equipment
    ) -> None:
        """common: digest of what all fleet files share. schema: of the messages that are taken in. equipment: takes
        what is about no target."""
        self._targets, self._tank, self._common, self._equipment = targets, tank, common, equipment
        self._accepted = frozenset({schema})
        self.refused: dict[str, int] = {}
        self._faults: dict[tuple[str, str], tuple[str, int]] = {}  # neighbour and kind: what is wrong, and when last

    def receive(
        self, heard: tuple[Heard, ...], refused: tuple[DroppedPayloads, ...], status: Status, now_ns: int
    ) -> None:
        """Give what can be believed to the latest-message cache and to the protocol of the target that it is about."""
        for turned_away in refused:
            src = turned_away.src or "a stranger"
            self._count(turned_away.reason, turned_away.count, src, "turned away unread", status, now_ns)
        for item in heard:
            try:
                self._take(item, status, now_ns)
            except Refusal as refusal:
                self._count(refusal.kind, 1, item.src, str(refusal), status, now_ns)
                if refusal.kind in FOR_PEOPLE:
                    self._faults[item.src, refusal.kind] = f"{item.src}: {refusal}", now_ns

    def faults(self, now_ns: int) -> tuple[str, ...]:
        """What is wrong with neighbours, and for people to put right."""
        self._faults = {about: held for about, held in self._faults.items() if now_ns - held[1] <= FAULT_NS}
        doubled = {name for target in self._targets.values() for name in target.cache.doubled(now_ns)}
        two = (f"two robots call themselves {name}; give each a name of its own" for name in sorted(doubled))
        return (*(text for text, _ in self._faults.values()), *two)

    def _take(self, item: Heard, status: Status, now_ns: int) -> None:
        """One payload. Raises Refusal where it is not believed."""
        if item.topic is not UNSET:
            self._equipment.take(item, self._accepted)
            return
        estimate = decode(item.payload, Estimate, accepted=self._accepted)
        if estimate.common and self._common and estimate.common != self._common:
            raise Refusal("fleet file", "its fleet file is another one; give all robots of a fleet the same file")
        if estimate.x_m is not None and not inside(estimate.x_m, self._tank.size_m):
            raise Refusal("place", "estimate outside the tank")
        if estimate.cov_m2 is not None and not is_covariance(estimate.cov_m2, self._tank.size_m):
            raise Refusal("content", "cov_m2 is no covariance of a place in the tank")
        target = self._targets.get(estimate.target)
        if target is None:
            known = ", ".join(self._targets)
            raise Refusal("target", f"target '{estimate.target}' is not in our fleet file, which has {known}")
        letter = target.cache.put(item.src, estimate, item.arrived_ns)
        for kind in target.estimator.hear(letter):
            self._count(kind, 1, item.src, "part of a message", status, now_ns)

    def _count(self, kind: str, count: int, src: str, why: str, status: Status, now_ns: int) -> None:
        self.refused[kind] = self.refused.get(kind, 0) + count
        text = f"refused from {src} ({kind}): {why}; {self.refused[kind]} so far"
        status.log.note_seldom("warning", kind, text, now_ns)
