"""How fast the dive's clock went, over the run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from replay.files.clock_rate import Moment
from replay.report.figures_posture import thin


def rate(moments: Sequence[Moment], start_ns: int) -> Figure:
    """Run time per time on the wall, as it was noted; times are the clock's, from start_ns on."""
    figure = Figure(figsize=(4.6, 2.4), layout="constrained")
    axes = figure.subplots()
    t_s = np.array([each.now_ns - start_ns for each in moments]) * 1e-9
    every = thin(t_s)
    axes.plot(t_s[every], [each.noted.rate for each in moments[every]], color="black", linewidth=0.9)
    axes.axhline(1.0, color="gray", linestyle="--", linewidth=0.8)
    axes.set(xlabel="time, s", ylabel="times real time")
    axes.set_ylim(bottom=0.0)
    return figure
