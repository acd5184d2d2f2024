"""Rows of growing surveys of one basin, what time grows as, and which bars are missed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from agent.experiments.reconstruction.size.basin import MOST
from agent.experiments.reconstruction.size.drawn import drawn_views
from agent.experiments.reconstruction.size.measured import keep, measured
from agent.experiments.result import Row

COUNTS = (125, 250, MOST)
MOST_MB = 4000.0
# Seconds grow as keyframes to this power at most. 1 is what is asked for; times of a machine that does other things, too,
# scatter by some per cent, of which 5 % over four times as many keyframes are 0.035 of it.
MOST_POWER = 1.05


def size_parts(counts: Sequence[int] = COUNTS) -> int:
    """How often `size` says that something is done."""
    return max(counts) + len(counts)


def size(seed: int, step: Callable[[], None] = lambda: None, counts: Sequence[int] = COUNTS) -> list[Row]:
    """A row for each number of keyframes: the first ones of one survey. Each is made in a process of its own."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        keep(drawn_views(seed, max(counts), step), folder)
        rows = []
        for count in counts:
            rows.append({"seed": seed, **measured(folder, count, seed)})
            step()
    return rows


def power(rows: Sequence[Row]) -> float:
    """p of seconds ~ keyframes^p, least squares of logarithms."""
    keyframes, seconds = (np.log([row[key] for row in rows]) for key in ("keyframes", "seconds"))
    return float(np.polyfit(keyframes, seconds, 1)[0])


def verdict(rows: Sequence[Row]) -> dict[str, Any]:
    """{"power": p, "peak_mb": the largest}; empty where nothing was measured."""
    return {"power": round(power(rows), 3), "peak_mb": max(row["peak_mb"] for row in rows)} if rows else {}


def missed_size(rows: Sequence[Row]) -> list[str]:
    """What is missed of 4 GB, and of time that grows no faster than the keyframes."""
    found = [
        f"{row['keyframes']} keyframes: {row['peak_mb']:.0f} MB" for row in rows if row["peak_mb"] > MOST_MB
    ]
    if rows and (grown := power(rows)) > MOST_POWER:
        found.append(f"time grows as keyframes^{grown:.2f}")
    return found
