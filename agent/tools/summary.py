"""Several enhancements side by side: means over the pictures, colours kept, and how many pictures were made worse."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from rich.table import Table

from agent.tools.metrics import Quality

WORSE_DB = 0.3  # below the picture as it was: less is not seen


class Summary(NamedTuple):
    """Means over the pictures; `hue_kept` over their warm and vivid pixels together, not a number where none is."""

    psnr_db: float
    ssim: float
    uciqe: float
    uiqm: float
    hue_kept: float
    made_worse: float  # share of the pictures


def summary(after: Sequence[Quality], before: Sequence[Quality]) -> Summary:
    """`before`: the figures of the pictures as they were, in the same order."""
    psnr_db, ssim, uciqe, uiqm = np.mean([q[:4] for q in after], axis=0).tolist()
    worse = np.mean([ours.psnr_db < theirs.psnr_db - WORSE_DB for ours, theirs in zip(after, before, strict=True)])
    return Summary(psnr_db, ssim, uciqe, uiqm, hue_kept(after), float(worse))


def hue_kept(figures: Sequence[Quality]) -> float:
    """Share of the pixels that are warm and vivid in the references; not a number where none is."""
    pixels = sum(q.warm.pixels for q in figures)
    return sum(q.warm.kept for q in figures) / pixels if pixels else math.nan


def table(rows: Mapping[str, Summary], title: str) -> Table:
    """A line for each way."""
    shown = Table(title=title)
    for column in ("way", "PSNR dB", "SSIM", "UCIQE", "UIQM", "hue kept", "made worse"):
        shown.add_column(column, justify="left" if column == "way" else "right")
    for way, s in rows.items():
        shown.add_row(way, *cells(s[:4]), percent(s.hue_kept), percent(s.made_worse))
    return shown


def cells(figures: Sequence[float]) -> list[str]:
    """PSNR, SSIM, UCIQE and UIQM of one line."""
    return [f"{figures[0]:.2f}", *(f"{value:.3f}" for value in figures[1:])]


def percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.0f} %"
