"""Measurements, curve and errors."""

from __future__ import annotations

from agent.calibration.focus_table import figure
from agent.experiments.calibration.run import Result
from agent.experiments.figure_files import Figures


def figures(result: Result) -> Figures:
    """One figure, as `aucamp calibrate focus` draws it."""
    yield "calibration.png", figure(*result.shown)
