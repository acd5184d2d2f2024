"""The fitted curve, its worth, and a verdict in words."""

from __future__ import annotations

from rich.console import Group

from agent.experiments.calibration.run import Result
from agent.tools.focus_calibration import result_table, verdict


def table(result: Result) -> Group:
    """The same that `aucamp calibrate focus` prints."""
    _, fit, left_out = result.shown
    return Group(result_table(fit, left_out), verdict(fit, left_out))
