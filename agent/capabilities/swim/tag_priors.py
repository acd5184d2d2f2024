"""What is known of depth, level and gimbal before any tag is seen, and how well."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.core.attitude import Attitude

DEPTH_M = 0.0007  # pressure: what the tare leaves, and the drift of four sensors in the first minutes
LEVEL_DEG = 0.05  # of roll and pitch, from frame to frame: noise of pressure over a base of 0.26 m
LEVEL_DRIFT_DEG = 0.087  # and what stays for minutes; both together are 0.1
WAKE_DEG_S2_M2 = 16.0  # dynamic pressure over the same base: at 0.25 m/s the body pitches by 1.0 degrees
REST_DEG = 0.02  # a servo at rest, after an approach from its low side
TURNING_DEG = 0.3  # and while it turns


class Prior(NamedTuple):
    """One angle, rad, or the depth, m."""

    value: float
    fluctuates: float  # sigma of what differs from frame to frame
    stays: float = 0.0  # sigma of what is the same in every frame

    @property
    def variance(self) -> float:
        return self.fluctuates * self.fluctuates + self.stays * self.stays


class Priors(NamedTuple):
    depth: Prior
    roll: Prior
    pitch: Prior
    pan: Prior
    tilt: Prior


def wake_rad(speed_m_s: float) -> float:
    """Sigma of what roll and pitch are off by as a robot swims."""
    return math.radians(WAKE_DEG_S2_M2 * speed_m_s * speed_m_s)


def priors(
    level: Attitude,
    gimbal_deg: tuple[float, float],
    speed_m_s: float,
    turning: bool,
    zero_deg: float = 0.0,
    lag_deg: float = 0.0,
) -> Priors:
    """What telemetry and pulses say at the time of a frame.

    gimbal_deg: pan and tilt as the servos really do them; turning: whether they may still be moving; zero_deg: sigma of
    their calibrated zeros, which is in every frame the same; lag_deg: of how far they are behind what they are told.
    """
    fluctuates = max(math.radians(LEVEL_DEG), wake_rad(speed_m_s))
    roll, pitch = (
        Prior(math.radians(deg), fluctuates, math.radians(LEVEL_DRIFT_DEG)) for deg in (level.roll_deg, level.pitch_deg)
    )
    servo_deg = math.hypot(TURNING_DEG if turning else REST_DEG, lag_deg)
    pan, tilt = (Prior(math.radians(deg), math.radians(servo_deg), math.radians(zero_deg)) for deg in gimbal_deg)
    return Priors(Prior(level.depth_m, 0.0, DEPTH_M), roll, pitch, pan, tilt)
