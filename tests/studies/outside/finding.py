"""What an outside judge found: one quantity, by the twin and by the judge."""

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Finding:
    COLUMNS: ClassVar = ("quantity", "twin", "judge", "by")
    quantity: str  # "edge spread, 30 mm before focus"
    judge: str  # "Mitsuba 3.9.1"
    twin: float
    outside: float
    unit: str
    allowed: float  # of the outside figure, as a share; or absolute where `absolute`
    absolute: bool = False

    @property
    def passes(self) -> bool:
        off = abs(self.twin - self.outside)
        return off <= (self.allowed if self.absolute else self.allowed * abs(self.outside))

    @property
    def row(self) -> tuple[str, ...]:
        """What the judge says otherwise is bold."""
        theirs = f"{self.outside:.4g}" if self.passes else f"**{self.outside:.4g}**"
        what = f"{self.quantity}, {self.unit}" if self.unit else self.quantity
        return what, f"{self.twin:.4g}", theirs, self.judge
