"""How a target moves when nobody looks: a velocity that wanders, for ever or only so far.

In each axis dv = -v/T dt + sqrt(q) dW. Without T the velocity is a random walk, right for what rolls and drifts, whose
speed an estimate may follow for long. An animal turns: with T, the time after which it has forgotten its course, its
velocity stays near v_rms = sqrt(q T / 2), and so does what a track believes of it while nobody sees it: the integrated
Ornstein-Uhlenbeck process (Uhlenbeck and Ornstein, Phys. Rev. 36, 1930), as Singer has it for the acceleration (IEEE
Trans. AES-6, 1970).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.core.matrix import IDENTITY
from agent.core.messages import Symmetric

# Of what swims, shares of its motion in each axis as variances: animals swim mostly level. Three tenths of the speed go
# up and down at most; the twin's fish do with half of that.
LEVEL: Symmetric = (1.0, 0.0, 0.0, 1.0, 0.0, 0.09)
SMALL = 0.01  # of h/T: below, differences of what is alike lose digits, and a series is exact to 1e-12


class Dynamics(NamedTuple):
    """Constants of one target."""

    psd_m2_s3: float  # q
    turn_s: float  # T; inf: never
    first_speed_m_s: float  # sigma of each component before any motion was seen

    @property
    def axes(self) -> Symmetric:
        """What both variances are multiplied by."""
        return IDENTITY if self.turn_s == math.inf else LEVEL


class Growth(NamedTuple):
    """Over a step: x += reach_s v, v *= kept, and the covariances that each level axis gains."""

    reach_s: float
    kept: float
    place_m2: float
    both_m2_s: float
    speed_m2_s2: float


ROLLING = Dynamics(4e-6, math.inf, 0.05)  # a ball rolled by a swell changes its speed by 2 mm/s in a second


def swimming(speed_m_s: float, turn_s: float) -> Dynamics:
    """An animal of this speed, most of it level, that keeps a course for about turn_s: speed/sqrt(2) in x and in y."""
    v_rms_m_s = speed_m_s / math.sqrt(2.0)
    return Dynamics(2.0 * v_rms_m_s * v_rms_m_s / turn_s, turn_s, v_rms_m_s)


def growth(dynamics: Dynamics, h_s: float) -> Growth:
    """What h_s brings; turn_s finite."""
    q, T, _ = dynamics
    x = h_s / T
    gone = -math.expm1(-x)  # 1 - e
    kept = 1.0 - gone
    place = _place(x) if x < SMALL else x - gone - 0.5 * gone * gone
    v2 = 0.5 * q * T  # v_rms^2
    return Growth(T * gone, kept, 2.0 * v2 * T * T * place, v2 * T * gone * gone, v2 * gone * (1.0 + kept))


def _place(x: float) -> float:
    """x - 2 (1 - e^-x) + (1 - e^-2x)/2, where it is small."""
    return x * x * x * (1 / 3 - x * (1 / 4 - x * (7 / 60 - x * (1 / 24 - x * 31 / 2520))))
