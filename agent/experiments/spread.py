"""How cases are summed up of which some never come to an end: a median of which half never do is no number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def spread(times_s: Sequence[float | None]) -> dict[str, float | int | None]:
    """Median, 95th percentile (the smallest time that at least 95 % of the cases keep) and how many never did."""
    ordered = np.sort([math.inf if t is None else t for t in times_s])

    def finite(value: float) -> float | None:
        return value if math.isfinite(value) else None

    n = len(ordered)
    middle = 0.5 * (float(ordered[(n - 1) // 2]) + float(ordered[n // 2]))
    return {
        "median": finite(middle),
        "p95": finite(float(ordered[-(-95 * n // 100) - 1])),
        "never": sum(t is None for t in times_s),
    }


def rms(values: NDArray[np.floating[Any]] | Sequence[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def number_or_never(value: float | None) -> str:
    """A figure as tables show it."""
    return "never" if value is None else f"{value:.2f}"
