"""Gimbal and lens: where the camera points, how it searches for a target, and when it sweeps the focus."""
