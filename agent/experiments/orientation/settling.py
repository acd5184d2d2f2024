"""When a robot is back at depth and level, from the twin's truth, one sample per control cycle of 10 ms.

A time that does not exist is `None`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.experiments.result import Row
from agent.experiments.spread import rms

SAMPLE_S = 0.01
DEPTH_M, TILT_DEG = 0.01, 2.0  # as far off as the paper's "recovered" may be
LIMIT_S = 6.0  # who takes longer never settled
STAY_S = 1.0  # watched beyond the limit: passing through the band is not settling

Samples = NDArray[np.floating[Any]]


class Track(NamedTuple):
    """What one robot truly did. t_s is 0 when the push ends, or at the command of a step."""

    t_s: Samples  # (n,)
    depth_m: Samples  # (n,) of the hull's centre
    roll_deg: Samples  # (n,)
    pitch_deg: Samples  # (n,)

    def since(self, t_s: float) -> Track:
        """The part from t_s on."""
        return Track(*(row[self.t_s >= t_s - SAMPLE_S / 2] for row in self))

    def before(self, t_s: float) -> Track:
        """The part before t_s."""
        return Track(*(row[self.t_s < t_s - SAMPLE_S / 2] for row in self))


def at_depth(track: Track, goal_m: float) -> NDArray[np.bool_]:
    """Which samples are, (n,)."""
    return np.asarray(np.abs(track.depth_m - goal_m) < DEPTH_M)


def is_level(track: Track) -> NDArray[np.bool_]:
    """Which samples are, (n,)."""
    return np.asarray((np.abs(track.roll_deg) < TILT_DEG) & (np.abs(track.pitch_deg) < TILT_DEG))


def for_good_s(good: NDArray[np.bool_]) -> float | None:
    """Seconds from the first sample until `good` stays true to the last; None beyond LIMIT_S.

    ValueError where the samples do not reach to LIMIT_S + STAY_S: then nobody can know.
    """
    if len(good) * SAMPLE_S < LIMIT_S + STAY_S - SAMPLE_S / 2:
        raise ValueError(f"{len(good) * SAMPLE_S:.2f} s of samples, {LIMIT_S + STAY_S} s are needed")
    bad = np.flatnonzero(~good)
    after_s = 0.0 if bad.size == 0 else (int(bad[-1]) + 1) * SAMPLE_S
    return after_s if after_s <= LIMIT_S else None


def score_push(track: Track, goal_m: float, hover_s: float) -> Row:
    """Recovery from the end of the push; the worst on the way; and how still the last hover_s before it were."""
    after = track.since(0.0)
    off_m = track.depth_m - goal_m
    still = track.since(track.t_s[0]).before(track.t_s[0] + hover_s)
    return {
        "recovery_s": for_good_s(at_depth(after, goal_m) & is_level(after)),
        "push_off_mm": 1e3 * float(np.abs(off_m).max()),
        "push_tilt_deg": float(np.hypot(track.roll_deg, track.pitch_deg).max()),
        "hover_depth_rms_mm": 1e3 * rms(still.depth_m - goal_m),
        "hover_tilt_rms_deg": rms(np.hypot(still.roll_deg, still.pitch_deg)),
    }


def score_step(track: Track, start_m: float, goal_m: float) -> Row:
    """Settling of depth alone from the command, overshoot past the goal, the worst tilt on the way."""
    after = track.since(0.0)
    past_m = (after.depth_m - goal_m) * math.copysign(1.0, goal_m - start_m)
    return {
        "settle_s": for_good_s(at_depth(after, goal_m)),
        "overshoot_mm": max(0.0, 1e3 * float(past_m.max())),
        "step_tilt_deg": float(np.hypot(after.roll_deg, after.pitch_deg).max()),
    }
