"""How much faster than the dive its recordings are checked, from file to verdict: three moored robots in one process,
and one that swims by its tags and by points of floor and walls (the recordings of a fleet are checked side by side).

In CPU time, which a check is nearly all of: what else runs on the machine does not count. The dive that is swum is
rendered first, which takes a minute.
"""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from replay.check.check import check
from tests.bench.swim.lockstep import swim
from tests.places import GOLDEN

RUNS = 7
WANTED = 20.0  # times real time: a dive of ten minutes in half a minute
SWUM_S = 30.0


def run() -> dict[str, dict[str, Any]]:
    """Medians over golden logs without frames; reading frames adds what decompressing them costs."""
    rows = {f"replay_check_{case}": row(GOLDEN / case) for case in ("three", "three_evidence")}
    with tempfile.TemporaryDirectory() as folder:
        swim("r1", 8, SWUM_S, into=Path(folder) / "r1.mcap")
        rows["replay_check_swimming"] = row(Path(folder))
    return rows


def row(run_folder: Path) -> dict[str, Any]:
    speed = statistics.median(times_real_time(run_folder) for _ in range(RUNS))
    against = f"{WANTED:.0f} times, the least that is wanted"
    return {"value": speed, "unit": "x real time", "against": against, "ratio": speed / WANTED}


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
