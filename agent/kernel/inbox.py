"""Payloads become letters: everything heard is decoded and checked here; what is not believed is counted."""

from __future__ import annotations

from collections.abc import Mapping

from agent.kernel.codec import Refusal, decode
from agent.kernel.config import Tank
from agent.kernel.estimation.evidence_checks import inside
from agent.kernel.messages import SCHEMA, Estimate
from agent.kernel.status import Status
from agent.kernel.step_io import DroppedPayloads, Heard
from agent.kernel.target_state import TargetState


class Inbox:
    """Counters of refusals by kind; the kinds are few, so a stranger cannot make them grow."""

    def __init__(self, targets: Mapping[str, TargetState], tank: Tank, schema: int = SCHEMA) -> None:
        self._targets, self._tank, self._accepted = targets, tank, frozenset({schema})
        self.refused: dict[str, int] = {}

    def receive(
        self, heard: tuple[Heard, ...], refused: tuple[DroppedPayloads, ...], status: Status, now_ns: int
    ) -> None:
        """Give what can be believed to the mailbox and to the protocol of the target that it is about."""
        for turned_away in refused:
            self._count(turned_away.reason, turned_away.count, "transport", "turned away unread", status, now_ns)
        for item in heard:
            try:
                estimate = decode(item.payload, Estimate, accepted=self._accepted)
                if estimate.x_m is not None and not inside(estimate.x_m, self._tank.size_m):
                    raise Refusal("place", "estimate outside the tank")
                target = self._targets.get(estimate.target)
                if target is None:
                    known = ", ".join(self._targets)
                    raise Refusal("target", f"target '{estimate.target}' is not in our fleet file, which has {known}")
                letter = target.mailbox.put(item.src, estimate, item.arrived_ns)
                for kind in target.estimator.hear(letter):
                    self._count(kind, 1, item.src, "part of a message", status, now_ns)
            except Refusal as refusal:
                self._count(refusal.kind, 1, item.src, str(refusal), status, now_ns)

    def _count(self, kind: str, count: int, src: str, why: str, status: Status, now_ns: int) -> None:
        self.refused[kind] = self.refused.get(kind, 0) + count
        text = f"refused from {src} ({kind}): {why}; {self.refused[kind]} so far"
        status.log.note_seldom("warning", kind, text, now_ns)
