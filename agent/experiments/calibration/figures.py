"""Measurements, curve and errors."""

from __future__ import annotations

from agent.experiments.calibration.run import Result
from agent.experiments.figure_files import Figures
from agent.tools.focus_calibration import figure


def figures(result: Result) -> Figures:
    """One figure, as `aucamp calibrate focus` draws it."""
    yield "calibration.png", figure(*result.shown)
