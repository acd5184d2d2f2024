"""What an outside judge found: one quantity, by the twin and by the judge."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
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
