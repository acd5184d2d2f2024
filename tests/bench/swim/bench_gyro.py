"""How still a robot holds its yaw with a gyro and without: `python -m tests.bench.swim.bench_gyro SEED ...`."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from agent.core.config import Goto
from agent.core.linear_algebra import wrap
from tests.bench.swim.drawn import MIDDLE, drawn, swimming

STILL = Goto(x_m=MIDDLE.x_m, y_m=MIDDLE.y_m, yaw_deg=MIDDLE.yaw_deg)
SETTLE_S, HELD_S = 20.0, 60.0


def held(seed: int, gyro: bool) -> dict[str, float]:
    """Root mean squares over a minute against a tether's pull of 0.05 N: mm and degrees; of yaw also what its own
    estimate was wrong by, and both less their means."""
    with tempfile.TemporaryDirectory() as folder, drawn(swimming(seed, STILL, gyro=gyro), Path(folder)) as one:
        one.run(SETTLE_S)
        rows = []
        for _ in range(round(20 * HELD_S)):
            one.step()
            x, y, psi = one.pose
            rows.append((x - STILL.x_m, y - STILL.y_m, wrap(psi), wrap(one.believed.x[2] - psi)))
    x, y, yaw, missed = np.array(rows).T
    rms = lambda v: float(np.sqrt((v * v).mean()))  # noqa: E731
    return {
        "place_rms_mm": 1e3 * rms(np.hypot(x, y)),
        "yaw_rms_deg": np.degrees(rms(yaw)),
        "yaw_std_deg": float(np.degrees(yaw.std())),
        "estimate_rms_deg": np.degrees(rms(missed)),
        "estimate_std_deg": float(np.degrees(missed.std())),
    }


def run() -> dict[str, dict]:
    """Two seeds; more by hand."""
    without, with_one = ([held(seed, gyro)["yaw_rms_deg"] for seed in (1, 2)] for gyro in (False, True))
    mean, against = float(np.mean(with_one)), float(np.mean(without))
    return {"hold_yaw_with_gyro": {"value": mean, "unit": "deg rms", "against": "without one", "ratio": mean / against}}


if __name__ == "__main__":
    for seed in map(int, sys.argv[1:]):
        for gyro in (False, True):
            print(seed, gyro, json.dumps({key: round(value, 3) for key, value in held(seed, gyro).items()}), flush=True)
