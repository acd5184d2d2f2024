"""One gimbal servo: commanded angle -> scale and zero error -> lag and slew of the motor -> play of the gears."""

from __future__ import annotations

import math

from hw.compiled import compiled

SERVO_LAG_S = 0.04
SLEW_DEG_S = 300.0  # 0.2 s per 60 deg, a usual figure of digital hobby servos
PLAY_DEG = 0.5  # full width of the backlash: the camera hangs behind the motor by half of it
STOP_MARGIN_DEG = 3.0  # mechanical stops lie outside the limits that the fleet file allows


@compiled()
def motor_deg_after(
    motor_deg: float, nominal_deg: float, gain: float, zero_deg: float, low_deg: float, high_deg: float, dt_s: float
) -> float:
    """Angle of the motor after dt_s of following the commanded nominal angle."""
    target = min(max(zero_deg + gain * nominal_deg, low_deg), high_deg)
    move = (target - motor_deg) * (1.0 - math.exp(-dt_s / SERVO_LAG_S))
    return motor_deg + min(max(move, -SLEW_DEG_S * dt_s), SLEW_DEG_S * dt_s)


@compiled()
def shaft_deg_after(shaft_deg: float, motor_deg: float) -> float:
    """Angle of what the servo carries: it stays until the motor has taken up the play, then it is dragged along."""
    return min(max(shaft_deg, motor_deg - PLAY_DEG / 2), motor_deg + PLAY_DEG / 2)
