"""Scenes from focus sweeps: surface by focus alone, by comparing pictures alone, and by both, against the twin's truth;
how many sweeps robots need that share what they saw; and how time and memory grow with a survey.

Seed 0 is the tank that things were chosen on; the others were not looked at for that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import msgspec
import numpy as np
from rich.console import Group
from rich.table import Table

from agent.clock.machine import processor_s
from agent.core.config import WaterKind
from agent.experiments.experiment import ExperimentResult, PosesKind, Row, ScenePart, Sensor
from agent.experiments.reconstruction.coverage import RUNS, coverage, missed_coverage, swum
from agent.experiments.reconstruction.render import Rendered, noisy, render, sweeps_of_a_world
from agent.experiments.reconstruction.score import (
    Score,
    into_truth,
    missed_pictures,
    picture_row,
    pose_row,
    score,
    seen_twice,
)
from agent.experiments.reconstruction.size import missed_size, size, size_parts, verdict
from agent.process.command import Failed, Progress, step_by_step
from agent.reconstruction.fusion import CELL_M, fuse, merged, swept_twice
from agent.reconstruction.held_back import ModelKind
from agent.reconstruction.mesh import Mesh, coloured, mesh_of
from agent.reconstruction.plane_sweep import neighbours, plane_sweep
from agent.reconstruction.refine_poses import refine
from agent.reconstruction.run import image_model
from agent.reconstruction.views import Floats, View, stacked

SENSOR: Sensor = "crop_1280"
WATERS: tuple[WaterKind, ...] = ("tap", "coastal")
POSES: tuple[PosesKind, ...] = ("exact", "noisy", "refined")
BARS = {"focus_median_mm": 2.5, "focus_complete_10mm": 83.0, "sweep_objects_mm": 1.0, "f5": 85.0}  # exact poses


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # the first of the tanks
    seeds: int = 5
    waters: tuple[WaterKind, ...] = WATERS
    poses: tuple[PosesKind, ...] = POSES
    model: ModelKind = "surfels"
    only: ScenePart | None = None


class Result(ExperimentResult, frozen=True, kw_only=True):
    """One case for each tank, water and kind of poses."""

    schema: int = 1
    source: str = "twin"
    sensor: str = SENSOR
    cases: list[Row]
    coverage: dict[str, Any]  # keyframes until 90 % is known to 4 mm: shared, alone, loss30; means over the seeds
    coverage_runs: dict[str, list[int]]  # of each seed
    coverage_equal: dict[str, bool]  # whether all robots' maps were the same bytes in the end
    swimmers: list[Row]  # of each seed, what three robots that swim know after each minute
    size: list[Row]  # surveys of 125, 250, 500 keyframes: seconds, memory, how true
    size_verdict: dict[str, float]  # largest memory; powers of keyframes and of compared pairs that time grows as
    missed: list[str]

    @property
    def failed(self) -> bool:
        return bool(self.missed)


class Surfaces(NamedTuple):
    """Three surfaces of the same views, and the CPU time that each took."""

    focus: Mesh
    sweep: Mesh
    both: Mesh
    views: list[View]  # with the depths that the last is made of
    focus_s: float
    both_s: float


MakeWorld = Callable[[int, WaterKind, Sensor, Callable[[], None]], Rendered]


def run(settings: Settings, progress: Progress, world: MakeWorld = render) -> Result:
    """Progress counts sweeps, surfaces and surveys."""
    waters = settings.waters if settings.only in (None, "scenes") else ()
    seeds = range(settings.seed, settings.seed + settings.seeds)
    surveyed = seeds if settings.only in (None, "coverage") else ()
    swimming = seeds if settings.only in (None, "swimmers") else ()
    large = seeds[:1] if settings.only in (None, "size") else ()
    each = sweeps_of_a_world() + len(settings.poses)
    total = len(seeds) * len(waters) * each + RUNS * len(surveyed) + len(swimming) + size_parts() * len(large)
    step = step_by_step(progress, total)
    cases = []
    for seed in seeds:
        for water in waters:
            rendered = world(seed, water, SENSOR, step)
            truth = seen_twice(rendered)
            for poses in settings.poses:
                cases.append(case(rendered, truth, poses, settings.model))
                step()
    told = coverage(surveyed, step) if surveyed else dict[str, Any](coverage={}, coverage_runs={}, coverage_equal={})
    swum_rows = []
    for seed in swimming:
        swum_rows.append(swum(seed))
        step()
    rows = [row for seed in large for row in size(seed, step)]
    absent = missed(cases) + missed_pictures(cases) + missed_coverage(told) + missed_size(rows)
    return Result(cases=cases, swimmers=swum_rows, size=rows, size_verdict=verdict(rows), missed=absent, **told)


def case(rendered: Rendered, truth_m: Floats, poses: PosesKind, model: ModelKind) -> Row:
    """Surfaces from one tank's views, and an image model on them, scored."""
    views = rendered.trained if poses == "exact" else noisy(rendered.trained, rendered.seed)
    start = processor_s()
    if poses == "refined":
        views = refine(views).views
    refined_s = processor_s() - start
    made = surfaces(views)
    focus, sweep, both = (_scored(mesh, views, rendered, truth_m) for mesh in (made.focus, made.sweep, made.both))
    return {
        "seed": rendered.seed,
        "water": rendered.water,
        "poses": poses,
        "median_mm": both.median_mm,
        "complete_10mm": both.complete_10mm,
        "f5": both.f5,
        "seconds": made.both_s,
        "refine_seconds": refined_s if poses == "refined" else None,
        **pose_row(views, rendered),
        **_pictured(made, rendered, views, model),
        "both": both._asdict(),
        "sweep": sweep._asdict(),
        "focus": {**focus._asdict(), "seconds": made.focus_s},
    }


def _pictured(made: Surfaces, rendered: Rendered, views: list[View], kind: ModelKind) -> Row:
    start = processor_s()
    model = image_model(kind, made.views, made.both, CELL_M, lambda done, total: None)
    seconds = processor_s() - start
    return {**picture_row(model, rendered, views), "image_seconds": seconds}


def surfaces(views: list[View]) -> Surfaces:
    """CPU seconds are those of compiled code: a first call that compiles is not counted."""
    stack = stacked(views)
    mesh_of(fuse(stacked(views[:1]), 4 * CELL_M))
    start = processor_s()
    focus = mesh_of(fuse(stack, CELL_M))
    focus_s = processor_s() - start
    plane_sweep(stacked([_unknown(view) for view in views[:2]]), neighbours(stacked(views[:2])))
    start = processor_s()
    found = swept_twice(views, stack, CELL_M)
    together = merged(stack, found)
    both = coloured(mesh_of(fuse(together, CELL_M)), together)
    both_s = processor_s() - start
    if not np.isfinite(found.depth_m).any():
        raise Failed("the plane sweep found nothing in any of these pictures")
    sweep = mesh_of(fuse(stack._replace(depth_m=found.depth_m, sigma_m=found.sigma_m), CELL_M))
    better = [
        replace(view, depth_m=together.depth_m[n][inside], sigma_m=together.sigma_m[n][inside])
        for n, view in enumerate(views)
        if (inside := np.s_[: view.camera.height, : view.camera.width])
    ]
    return Surfaces(focus, sweep, both, better, focus_s, both_s)


def _unknown(view: View) -> View:
    """A view in which nothing is known: kernels compile on it and do nothing."""
    nothing = np.full_like(view.depth_m, np.nan)
    return replace(view, depth_m=nothing, sigma_m=nothing)


def _scored(mesh: Mesh, views: list[View], rendered: Rendered, truth_m: Floats) -> Score:
    return score(into_truth(mesh.vertices_m, views, rendered), rendered, truth_m)


def missed(cases: list[Row]) -> list[str]:
    """Targets that a case with exact poses does not reach."""
    found = []
    for one in cases:
        if one["poses"] != "exact":
            continue
        name = f"seed {one['seed']}, {one['water']}"
        told = [
            (one["focus"]["median_mm"] <= BARS["focus_median_mm"],
             f"median by focus {one['focus']['median_mm']:.2f} mm"),
            (one["focus"]["complete_10mm"] >= BARS["focus_complete_10mm"],
             f"within 10 mm by focus {one['focus']['complete_10mm']:.1f} %"),
            (one["sweep"]["objects_mean_mm"] <= BARS["sweep_objects_mm"],
             f"objects by the sweep {one['sweep']['objects_mean_mm']:.2f} mm"),
            (one["f5"] >= BARS["f5"], f"F at 5 mm {one['f5']:.1f}"),
        ]  # fmt: skip
        found += [f"{name}: {words}" for reached, words in told if not reached]
    return found


# --- tables ---


def table(result: Result) -> Group:
    """The surfaces, pictures and surveys that were asked for, and a line for each target that was missed."""
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
    """A line for each tank, water and kind of poses: by focus alone, by the plane sweep alone, by both."""
    shown = Table(title="surfaces from 45 focus sweeps against the twin's truth")
    left = ("seed", "water", "poses", "surface")
    right = ("mean mm", "median mm", "objects mm", "within 10 mm", "F at 5 mm", "CPU s")
    for column in (*left, *right):
        shown.add_column(column, justify="left" if column in left else "right")
    for case in cases:
        for surface in ("focus", "sweep", "both"):
            one = case[surface]
            seconds = {"focus": case["focus"]["seconds"], "sweep": None, "both": case["seconds"]}[surface]
            shown.add_row(
                *(f"{case[key]}" for key in left[:3]),
                surface,
                *(f"{one[key]:.2f}" for key in ("mean_mm", "median_mm", "objects_mean_mm")),
                f"{one['complete_10mm']:.1f} %",
                f"{one['f5']:.1f}",
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
        shown.add_row(
            *(f"{case[key]}" for key in (*left[:3], "image")),
            f"{case['place_mm']:.1f}",
            f"{case['turn_deg']:.2f}",
            f"{case['psnr_in']:.1f}",
            f"{case['psnr_new']:.1f}",
            f"{case['image_seconds']:.0f}",
        )
    return shown
