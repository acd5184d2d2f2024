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
# Seconds grow as pairs of pictures that are compared to this power at most; each keyframe is compared with five others
# at most. 1 is what is asked for; times of a machine that does other things, too, scatter by some per cent, of which
# 5 % over four times as many keyframes are 0.035 of it.
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


def power(rows: Sequence[Row], of: Callable[[Row], float], key: str = "seconds") -> float:
    """p of seconds ~ of(row)^p, least squares of logarithms."""
    amounts, seconds = np.log([of(row) for row in rows]), np.log([row[key] for row in rows])
    return float(np.polyfit(amounts, seconds, 1)[0])


def verdict(rows: Sequence[Row]) -> dict[str, Any]:
    """The largest memory, and what time grows as: of keyframes, and of pairs of pictures that are compared.

    A survey's first keyframes are near its rim, where fewer others look at the same: over few keyframes time grows
    faster than they do, until nearly all have as many neighbours as are asked. Pairs tell that apart from work that
    would go on growing. Of poses corners that were found elsewhere do. Empty where nothing was measured.
    """
    if not rows:
        return {}
    return {
        "peak_mb": max(row["peak_mb"] for row in rows),
        "power_keyframes": round(power(rows, _keyframes), 3),
        "power_pairs": round(power(rows, _pairs), 3),
        "power_refine": round(power(rows, _keyframes, "refine_seconds"), 3),
        "power_matches": round(power(rows, _matches, "refine_seconds"), 3),
        "power_image": round(power(rows, _keyframes, "image_seconds"), 3),
    }


def missed_size(rows: Sequence[Row]) -> list[str]:
    """What is missed of 4 GB, and of time that grows no faster than the pictures that are compared."""
    found = [f"{row['keyframes']} keyframes: {row['peak_mb']:.0f} MB" for row in rows if row["peak_mb"] > MOST_MB]
    if rows and (grown := power(rows, _pairs)) > MOST_POWER:
        found.append(f"time grows as pairs of pictures^{grown:.2f}")
    return found


def _keyframes(row: Row) -> float:
    return float(row["keyframes"])


def _matches(row: Row) -> float:
    return float(row["matches"])


def _pairs(row: Row) -> float:
    return float(row["keyframes"] * row["compared"])
