"""The figures of an experiment, as they go into its folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

Figures = Iterator[tuple[str, Figure]]  # file name and figure; the name's suffix says how it is written


def write_figures(figures: Figures, folder: Path) -> None:
    """Write them all; in SVG text stays text, and neither a date nor drawn ids make two runs differ."""
    for name, figure in figures:
        with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
            figure.savefig(folder / name, metadata={"Date": None} if name.endswith(".svg") else None)
