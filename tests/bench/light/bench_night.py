"""Three robots in a dark tank that find a ball by each other's light, and three that lend nobody theirs.

Seeds by AUCAMP_NIGHT_SEEDS, fleets by AUCAMP_NIGHT_FLEETS, loss of messages by AUCAMP_NIGHT_LOSS. A dive ends when all
have settled, or after two minutes; with AUCAMP_NIGHT_S it goes on for so long, settled or not. On a machine so busy
that the firmware's cycles get long it arms later, as on a board, and figures differ a little.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from msgspec.structs import replace

from agent.core.config import Fleet
from agent.core.ranging.camera_model import Calibration
from agent.demo.summary import PASS_PERCENT
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from hw.twin.scene import scene_of
from tests.bench.light.lockstep import Ended, calibrated, night

SEEDS = [int(seed) for seed in os.environ.get("AUCAMP_NIGHT_SEEDS", "3").split()]
FLEETS = os.environ.get("AUCAMP_NIGHT_FLEETS", "night night_alone").split()
LOSS = float(os.environ.get("AUCAMP_NIGHT_LOSS", "0"))
WHOLE_S = os.environ.get("AUCAMP_NIGHT_S")
DIVE_S = float(WHOLE_S or 120.0)
WHOLE = 100.0


def run() -> dict[str, dict[str, Any]]:
    rows = {}
    for seed in SEEDS:
        fleets = {name: seeded(name, seed) for name in FLEETS}
        any_of = fleets[FLEETS[0]]
        calibrations = {robot: calibrated(any_of, robot) for robot in any_of.robot}  # the same robots in all of them
        rows |= {f"{name}, seed {seed}": dived(fleet, calibrations) for name, fleet in fleets.items()}
    return rows


def seeded(name: str, seed: int) -> Fleet:
    fleet = load_fleet(fleet_file(name))
    return replace(fleet, twin=replace(fleet.twin, seed=seed))


def dived(fleet: Fleet, calibrations: Mapping[str, Calibration]) -> dict[str, Any]:
    far_mm = 1000.0 * float(np.linalg.norm(scene_of(fleet).solid[0].position_m))
    settled_s, robots = night(fleet, calibrations, DIVE_S, LOSS, WHOLE_S is not None)
    errors_mm = [ended.error_mm for ended in robots.values()]
    percents = [WHOLE if mm is None else 100.0 * mm / far_mm for mm in errors_mm]
    told = "; ".join(f"{robot}: {story(ended)}" for robot, ended in robots.items())
    return {
        "value": max(percents),
        "unit": f"% off, the worst robot (bar {PASS_PERCENT}; {WHOLE:.0f}: it knows nothing)",
        "against": f"{'never settled' if settled_s is None else f'settled after {settled_s:.0f} s'}; {told}",
    }


def story(ended: Ended) -> str:
    first = "never in view" if ended.first_s is None else f"in view after {ended.first_s:.1f} s"
    moves = f"; taken to move or rest anew {ended.epochs} times" if ended.epochs else ""
    nis = "" if ended.nis is None else f", mean NIS {ended.nis:.1f}"
    return f"{first}, {ended.kept} of {ended.kept + ended.rejected} sweeps, {ended.by_lent} by lent light{nis}{moves}"
