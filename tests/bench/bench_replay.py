"""How much faster than the dive its recordings are checked: three robots in one process, from file to verdict."""

from __future__ import annotations

import json
import statistics
from pathlib import Path
from typing import Any

from replay.check import check

GOLDEN = Path(__file__).parents[1] / "golden"
RUNS = 7
WANTED = 20.0  # times real time, for the whole fleet: a dive of ten minutes in half a minute


def run() -> dict[str, dict[str, Any]]:
    """Medians over golden logs without frames; reading frames adds what decompressing them costs."""
    rows = {}
    for case in ("three", "three_evidence"):
        results = [check([GOLDEN / case]) for _ in range(RUNS)]
        if any(result.exit_code != 0 for result in results):
            raise RuntimeError(f"{case} is not reproduced: this measures the wrong thing")
        speed = statistics.median(result.speed for result in results)
        against = f"{WANTED:.0f} times, the least that is wanted"
        rows[f"replay_check_{case}"] = {
            "value": speed,
            "unit": "x real time",
            "against": against,
            "ratio": speed / WANTED,
        }
    return rows


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
