"""One ball alone at three distances: its range from focus alone, from its apparent size alone, and from both."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import get_args

from agent.core.config import Cues
from agent.core.ranging.focus import depth_of_field_in_water_m
from agent.experiments.ball_measurements import ball_measurements
from agent.experiments.result import Row
from agent.experiments.sweeps import WATER_INDEX
from hw.twin.optics.lens import PRESETS

BALL_M, BALL_PLACES = (0.3, 0.5, 1.0), 4  # camera to the ball's centre, and from how many sides each
SPOT_PX, PORT_M = 2.5, 0.005  # blur that a colour sensor cannot tell from a point; lens to window


def ball_rows(sensor: str, seed: int, step: Callable[[], None]) -> list[Row]:
    """A row for each distance and each of the cues; the camera is calibrated as a robot's is.

    Errors are those of the camera's own range; `depth_of_field_m` is what one frame alone could tell, for spots of
    SPOT_PX pixels. `step` is called after each of len(BALL_M) * BALL_PLACES measurements.
    """
    lens, rows = PRESETS[sensor], []
    for distance_m in BALL_M:
        measured = []
        for one in ball_measurements(seed, BALL_PLACES, sensor, distance_m):
            measured.append(one)
            step()
        spot_m = SPOT_PX * lens.pixel_m
        field_m = depth_of_field_in_water_m(distance_m, lens.focal_m, lens.f_number, spot_m, WATER_INDEX, PORT_M)
        for cue in get_args(Cues):
            good = [one[cue] for one in measured if "range_mm" in one[cue]]
            errors_mm = [one["range_mm"] for one in good]
            rows.append(
                {
                    "sensor": sensor,
                    "distance_m": distance_m,
                    "cues": cue,
                    "errors_mm": errors_mm,
                    "rms_mm": rms(errors_mm),
                    "sigma_mm": rms([one["range_sigma_mm"] for one in good]),
                    "refused": sorted({one[cue]["refused"] for one in measured if "refused" in one[cue]}),
                    "depth_of_field_m": field_m if math.isfinite(field_m) else None,
                }
            )
    return rows


def rms(values: list[float]) -> float | None:
    """Root mean square; None of nothing."""
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else None
