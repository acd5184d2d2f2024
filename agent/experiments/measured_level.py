"""What four drifting pressure sensors make of a robot's depth, roll and pitch: drawn from the twin's own figures."""

from __future__ import annotations

import math

import numpy as np

from agent.core.messages import Vector
from hw.twin.physics.body import SENSOR_M
from hw.twin.physics.sensors import CORNERS, DRIFT_M_S, NOISE_M

DIVE_S = 120.0  # sensors have drifted for up to so long
AVERAGED = 10  # samples of a sensor, 0.1 s: what the control module's observer makes of them


def level_of(depth_m: float, roll_deg: float, pitch_deg: float, rng: np.random.Generator) -> Vector:
    """Depth (m), roll and pitch (degrees) as they are measured at some time of a dive, from what they are."""
    drift = rng.normal(0.0, DRIFT_M_S, 4) * rng.uniform(0.0, DIVE_S)
    error_m = drift + rng.normal(0.0, NOISE_M / math.sqrt(AVERAGED), 4)
    # z rises to the left with roll, and falls ahead with pitch: a sensor that reads too deep stands too low.
    roll_off, pitch_off = (float(math.degrees((error_m * CORNERS[:, k]).sum() / (4.0 * SENSOR_M))) for k in (1, 0))
    return depth_m + float(error_m.mean()), roll_deg - roll_off, pitch_deg + pitch_off
