"""Placeholder until the Monte Carlo has run."""

TAU = (0.1, 1.0)
SCATTERING_SHARE = (0.4, 0.9)
ANGLE_DEG = (3.0, 120.0)
RATIO = (0.25, 1.5)
LOG_TIMES = (0.0,) * 16
