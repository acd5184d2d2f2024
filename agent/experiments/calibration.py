"""Range against the sharpest lens position: how well a calibration on the twin's bench foretells distances.

The curve is the paper's h(rho), fitted as `aucamp calibrate run` does it. Each seed is another lens.
"""

from __future__ import annotations

import msgspec
import numpy as np

from agent.experiments.ball_measurements import PosedRobot
from agent.experiments.claim import Claim, Figure, NoSettings, Row, Rows, Share, Value, percentile, rms
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from agent.tools.focus_calibration import badly_foretold, fit_focus, leave_one_out

ROBOT = "r1"
SENSOR = "imx519_640"  # a preset of hw.twin.optics.lens


def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """One lens. Raises CalibrationRefused where its measurements determine no curve."""
    fleet = load_fleet(shipped_fleet())
    fleet = msgspec.structs.replace(fleet, twin=msgspec.structs.replace(fleet.twin, seed=seed))
    measured = PosedRobot(fleet, ROBOT, SENSOR).focus_rows()
    fit, left_out = fit_focus(measured), leave_one_out(measured)
    return [
        {
            "distances": len(left_out),
            "badly_foretold": len(badly_foretold(left_out)),
            "left_out_percent": [100.0 * abs(one.error_m) / one.u_m for one in left_out],
            "rmse_mm": 1e3 * fit.rmse_m,
        }
    ]


def summary(rows: Rows) -> dict[str, Value]:
    lenses = rows["all"]
    return {
        "good": Share(sum(not lens["badly_foretold"] for lens in lenses), len(lenses)),
        "left_out_percent": percentile([off for lens in lenses for off in lens["left_out_percent"]], 95.0),
        "rmse_mm": rms([lens["rmse_mm"] for lens in lenses]),
        "distances": float(np.mean([lens["distances"] for lens in lenses])),
    }


CLAIM = Claim(
    run=run,
    summary=summary,
    measured_on="twin",
    figures=(
        Figure("good", "lenses of which every distance is foretold by the others within 5 %", "%", least=95.0),
        Figure("left_out_percent", "error of a distance that is left out, 95 % within, of the distance", "%"),
        Figure("rmse_mm", "distances by the curve fitted to all, rms error", "mm"),
        Figure("distances", "distances of 16 that have a clear peak, mean"),
    ),
    seeds=60,  # as many as the 95 % take
    explanation="""A board is put before a lens of the twin at 16 distances from 0.22 to 1.2 m, and the lens is swept
        over its range at each; the sharpest lens positions give the curve of range against lens position. A distance
        that is left out is foretold by the curve through the others.""",
)
