"""What the doctor has found, in lines for people and as JSON for programs."""

from __future__ import annotations

from typing import Any, NamedTuple

from agent.ground.finding import Finding


class Diagnosis(NamedTuple):
    """All findings, in the order in which they were made."""

    findings: tuple[Finding, ...]
    name: str  # as whom it was looked

    @property
    def well(self) -> bool:
        return all(finding.level == "ok" for finding in self.findings)

    @property
    def verdict(self) -> str:
        """One line at the end."""
        count = sum(finding.level != "ok" for finding in self.findings)
        things = "one thing" if count == 1 else f"{count} things"
        return "well" if self.well else f"not well: {things} to mend"

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        about = {"well": self.well, "verdict": self.verdict, "as": self.name}
        return {**about, "findings": [finding._asdict() for finding in self.findings]}
