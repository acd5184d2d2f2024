"""How much faster than real time five robots, each with its firmware process, go through a push in lock-step."""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from agent.experiments.orientation import FIND_S, HOVER_S, LIMIT_S, PUSH, PUSH_S, STAY_S, Case, respond

ROUNDS = 3
VIRTUAL_S = FIND_S + HOVER_S + PUSH_S + LIMIT_S + STAY_S  # the seconds before arming are not counted
TARGET = 3.0  # times real time, of three robots


def run() -> dict[str, dict[str, Any]]:
    """Virtual seconds per second, start of the processes included; CPython's firmware."""
    cases = [Case("observer", k, 0.10, 1.0) for k in range(5)]
    speeds = []
    for _ in range(ROUNDS):
        with tempfile.TemporaryDirectory() as folder:
            start_s = time.perf_counter()
            respond(cases, PUSH, 0, Path(folder), sys.executable)
            speeds.append(VIRTUAL_S / (time.perf_counter() - start_s))
    speed = statistics.median(speeds)
    against = f"target {TARGET} x real time"
    return {"lock_step_five_robots": {"value": speed, "unit": "x", "against": against, "ratio": speed / TARGET}}


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
