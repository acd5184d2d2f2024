"""A line for each tank, water and kind of poses; what was missed."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table

from agent.experiments.reconstruction.run import Result
from agent.experiments.result import Row


def table(result: Result) -> Group:
    """The surfaces, pictures and surveys that were asked for, and a line for each bar that was missed."""
    scenes = (surfaces_table(result.cases), pictures_table(result.cases)) if result.cases else ()
    surveys = (coverage_table(result),) if result.coverage else ()
    swimmers = (swimmers_table(result.swimmers),) if result.swimmers else ()
    sizes = (size_table(result),) if result.size else ()
    return Group(*scenes, *surveys, *swimmers, *sizes, *(f"missed: {text}" for text in result.missed))


def coverage_table(result: Result) -> Table:
    """Keyframes until nine tenths are known, of each seed."""
    shown = Table(title="keyframes of five moored robots until 90 % is known to 4 mm")
    for column in ("robots", "mean", "of that alone", "each seed", "maps"):
        shown.add_column(column, justify="right" if column in ("mean", "of that alone") else "left")
    for kind, mean in result.coverage.items():
        equal = result.coverage_equal.get(kind)
        each = " ".join(map(str, result.coverage_runs[kind]))
        maps = "" if equal is None else "equal" if equal else "differ"
        shown.add_row(kind, f"{mean:.1f}", f"{mean / result.coverage['alone']:.2f}", each, maps)
    return shown


def swimmers_table(rows: list[Row]) -> Table:
    """What is known of the floor after each minute, and how much of what is mapped is not there."""
    shown = Table(title="three robots that swim; share of the floor known to 10 mm, depths drawn")
    minutes = len(rows[0]["known"])
    for column in (
        "seed",
        *(f"{k} min" for k in range(1, minutes + 1)),
        "keyframes",
        "cells of things",
        "of these empty",
    ):
        shown.add_column(column, justify="right")
    for row in rows:
        known = (f"{100 * share:.1f} %" for share in row["known"])
        made = " ".join(map(str, row["keyframes"]))
        shown.add_row(str(row["seed"]), *known, made, str(row["things"]), str(row["empty"]))
    return shown


def size_table(result: Result) -> Table:
    """Growing surveys, and what time grows as."""
    shown = Table(title="surveys of 10 x 6 m, depths drawn; surface by plane sweep and focus as PLY; poses; surfels")
    columns = {
        "seed": "seed",
        "robots": "robots",
        "keyframes": "keyframes",
        "compared": "neighbours",
        "area_m2": "surface m2",
        "triangles": "triangles",
        "seconds": "CPU s",
        "seconds_per_keyframe": "CPU s a keyframe",
        "refine_seconds": "poses CPU s",
        "place_mm": "places mm",
        "image_seconds": "surfels CPU s",
        "peak_mb": "memory MB",
        "median_mm": "median mm",
        "within_10mm": "within 10 mm %",
    }
    for column in columns.values():
        shown.add_column(column, justify="right")
    for row in result.size:
        shown.add_row(*(str(row[key]) for key in columns))
    told = result.size_verdict
    shown.caption = (
        f"time grows as keyframes^{told['power_keyframes']:.2f}, as pairs compared^{told['power_pairs']:.2f}; "
        f"that of poses as keyframes^{told['power_refine']:.2f}, as matches^{told['power_matches']:.2f}; "
        f"that of surfels as keyframes^{told['power_image']:.2f}"
    )
    return shown


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
