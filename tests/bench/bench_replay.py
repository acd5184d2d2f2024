"""How much faster than the dive its recordings are checked: three robots in one process, from file to verdict.

In CPU time, which a check is nearly all of: what else runs on the machine does not count.
"""

from __future__ import annotations

import json
import statistics
import time
from pathlib import Path
from typing import Any

from replay.check.check import check
from tests.places import GOLDEN

RUNS = 7
WANTED = 20.0  # times real time, for the whole fleet: a dive of ten minutes in half a minute


def run() -> dict[str, dict[str, Any]]:
    """Medians over golden logs without frames; reading frames adds what decompressing them costs."""
    rows = {}
    for case in ("three", "three_evidence"):
        speed = statistics.median(times_real_time(GOLDEN / case) for _ in range(RUNS))
        against = f"{WANTED:.0f} times, the least that is wanted"
        rows[f"replay_check_{case}"] = {
            "value": speed,
            "unit": "x real time",
            "against": against,
            "ratio": speed / WANTED,
        }
    return rows


def times_real_time(run_folder: Path) -> float:
    """Seconds of the longest recording over CPU seconds."""
    began_s = time.process_time()
    result = check([run_folder])
    cpu_s = time.process_time() - began_s
    if result.exit_code != 0:
        raise RuntimeError(f"{run_folder} is not reproduced: this measures the wrong thing")
    return max(each.recorded_s for each in result.results) / cpu_s


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
