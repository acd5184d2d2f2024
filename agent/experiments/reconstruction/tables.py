"""A line for each tank, water and kind of poses; what was missed."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table

from agent.experiments.reconstruction.run import Result
from agent.experiments.result import Row


def table(result: Result) -> Group:
    """The surfaces, and a line for each bar that was missed."""
    return Group(
        surfaces_table(result.cases), pictures_table(result.cases), *(f"missed: {text}" for text in result.missed)
    )


def surfaces_table(cases: list[Row]) -> Table:
    """By focus alone, by the plane sweep alone, by both; PSNR of the surface's own colours."""
    shown = Table(title="surfaces from 45 focus sweeps against the twin's truth")
    left = ("seed", "water", "poses", "surface")
    right = ("mean mm", "median mm", "objects mm", "within 10 mm", "F at 5 mm", "PSNR known, new dB", "CPU s")
    for column in (*left, *right):
        shown.add_column(column, justify="left" if column in left else "right")
    for case in cases:
        for surface in ("focus", "sweep", "both"):
            one = case[surface]
            seconds = {"focus": case["focus"]["seconds"], "sweep": None, "both": case["seconds"]}[surface]
            told = surface == "both" and case["psnr_in"] is not None
            shown.add_row(
                *(f"{case[key]}" for key in left[:3]),
                surface,
                *(f"{one[key]:.2f}" for key in ("mean_mm", "median_mm", "objects_mean_mm")),
                f"{one['complete_10mm']:.1f} %",
                f"{one['f5']:.1f}",
                f"{case['psnr_in']:.1f}, {case['psnr_new']:.1f}" if told else "",
                "" if seconds is None else f"{seconds:.1f}",
            )
    return shown


def pictures_table(cases: list[Row]) -> Table:
    """Image models on photographs held back, each placed first; and how far off their poses were."""
    shown = Table(title="image models on photographs held back")
    left = ("seed", "water", "poses", "model")
    for column in (*left, "places mm", "angles deg", "PSNR known dB", "PSNR new dB", "CPU s"):
        shown.add_column(column, justify="left" if column in left else "right")
    for case in cases:
        if "image" in case:
            shown.add_row(
                *(f"{case[key]}" for key in (*left[:3], "image")),
                f"{case['place_mm']:.1f}",
                f"{case['turn_deg']:.2f}",
                f"{case['psnr_in']:.1f}",
                f"{case['psnr_new']:.1f}",
                f"{case['image_seconds']:.0f}",
            )
    return shown
