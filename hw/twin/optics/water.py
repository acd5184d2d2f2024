"""What water does to light: I = J exp(-bD z) + Binf (1 - exp(-bB z)), per colour (Akkaynak and Treibitz, CVPR 2018).

z is the length of the way through the water. bD, of the object's own light, and bB, of the veil, differ: the
restoration that assumes one coefficient is wrong by construction, as it is in the sea. Colours are blue green red.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw.twin.scene import SceneWater

Colour = NDArray[np.float64]  # (3,)

# Diffuse attenuation 1/m of Jerlov's types in bands around 460, 535 and 610 nm
# (Jerlov 1976, table XXVII; types I to IB as revised by Austin and Petzold; integrated over the bands).
KD_PER_M = {
    "air": (0.0, 0.0, 0.0),
    "tap": (0.020, 0.063, 0.251),  # I: in a tank the grey veil of particles matters more than colour
    "pool": (0.037, 0.072, 0.258),  # IB
    "coastal": (0.367, 0.215, 0.348),  # 3C
    "turbid": (0.846, 0.507, 0.521),  # 7C
}

LOST = 0.4  # share of scattering that daylight does not survive; most of it goes on downwards
LEVEL_SHARE = 0.1  # of daylight that particles send level, per scattering; assumed


class Water(NamedTuple):
    """Coefficients 1/m per colour; `veil` is Binf as a share of the light at the surface."""

    down: Colour  # daylight with depth
    direct: Colour  # bD
    scatter: Colour  # bB
    veil: Colour  # Binf


def draw_water(water: SceneWater, rng: np.random.Generator) -> Water:
    """One tank's water: Kd <= bD <= the beam coefficient, and a veil that the literature's ranges allow."""
    kd = np.array(KD_PER_M[water.preset])
    direct, scatter, path_m, share = rng.uniform((1, 0.8, 1, 0.1), (1.8, 2.5, 8, 0.6))
    if water.absorption_per_m is not None and water.scattering_per_m is not None:
        a, b = np.array(water.absorption_per_m), np.array(water.scattering_per_m)
        return Water(down=a + LOST * b, direct=a + b, scatter=a + b, veil=LEVEL_SHARE * b / (a + b))
    clear = water.preset == "air"
    return Water(
        down=kd,
        direct=kd * direct,
        scatter=kd * scatter + (0.0 if clear else water.grey_per_m),
        veil=np.zeros(3) if clear else np.exp(-kd * path_m) * share,
    )


def transmission_and_veil(water: Water, range_m: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(..., 3) share of J that arrives over `range_m` (...), and (..., 3) veil in front of it."""
    z = np.asarray(range_m, float)[..., None]
    return np.exp(-water.direct * z), water.veil * -np.expm1(-water.scatter * z)


def daylight(water: Water, depth_m: ArrayLike) -> NDArray[np.float64]:
    """(..., 3) share of the light at the surface that is left at `depth_m` (...)."""
    return np.asarray(np.exp(-water.down * np.maximum(np.asarray(depth_m, float), 0.0)[..., None]))
