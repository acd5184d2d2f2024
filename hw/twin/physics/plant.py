"""What an experiment decides about a robot, instead of leaving it to chance: one row of overrides per robot."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.physics.sensors import LATE_SAMPLES, NOISE_M
from hw.twin.physics.thruster import F_MAX_N


class Plant(NamedTuple):
    """The defaults leave a robot as it is drawn."""

    mass_scale: float = 1.0  # on all that resists acceleration, added mass with it; it stays as buoyant as it was
    lag_s: float | None = None  # of every thruster; None: drawn about 0.10 s
    f_max_n: float = F_MAX_N  # thrust at 1900 us
    noise_m: float = NOISE_M  # standard deviation of one pressure sample
    late_samples: int = LATE_SAMPLES  # from the water to the firmware
    dynamic_pressure: float = 1.0  # share of the stagnation pressure that the sensors see


def set_body(body: NDArray[np.void], plant: Plant) -> None:
    """Impose a plant on a drawn record () BODY."""
    for name in ("mass_kg", "displaced_kg", "added_kg", "inertia_kgm2", "added_inertia_kgm2"):
        body[name] *= plant.mass_scale
    if plant.lag_s is not None:
        body["thrust_lag_s"] = plant.lag_s
    body["thrust_gain"] *= plant.f_max_n / F_MAX_N
    body["stagnation"] = plant.dynamic_pressure
