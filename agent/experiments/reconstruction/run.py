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

from agent.clock.machine import monotonic_s, processor_s
from agent.core.config import WaterKind
from agent.experiments.choices import PosesKind, ScenePart, Sensor
from agent.experiments.reconstruction.coverage import RUNS, coverage, missed_coverage
from agent.experiments.reconstruction.noisy import noisy
from agent.experiments.reconstruction.pictures import into_truth, missed_pictures, picture_row, pose_row
from agent.experiments.reconstruction.render import Rendered, render, sweeps_of_a_world
from agent.experiments.reconstruction.score import Score, score, seen_twice
from agent.experiments.reconstruction.size.size import missed_size, size, size_parts, verdict
from agent.experiments.reconstruction.swum import swum
from agent.experiments.result import ExperimentResult, Row
from agent.process.command import Failed, Progress, step_by_step
from agent.reconstruction.fusion import CELL_M, fuse, merged, swept_twice
from agent.reconstruction.image_model import ImageSettings, image
from agent.reconstruction.mesh import Mesh, coloured, mesh_of
from agent.reconstruction.plane_sweep import neighbours, plane_sweep
from agent.reconstruction.refine_poses import refine
from agent.reconstruction.report import psnr_db, render_of
from agent.reconstruction.views import Floats, View, stacked

SENSOR: Sensor = "crop_1280"
WATERS: tuple[WaterKind, ...] = ("tap", "coastal")
POSES: tuple[PosesKind, ...] = ("exact", "noisy", "refined")
BARS = {"focus_median_mm": 2.5, "focus_complete_10mm": 83.0, "sweep_objects_mm": 1.0, "f5": 85.0}  # exact poses


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    waters: tuple[WaterKind, ...] = WATERS
    poses: tuple[PosesKind, ...] = POSES
    image: ImageSettings | None = ImageSettings(kind="surfels")  # None: surfaces alone
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
    surveyed = settings.seeds if settings.only in (None, "coverage") else ()
    swimming = settings.seeds if settings.only in (None, "swimmers") else ()
    large = settings.seeds[:1] if settings.only in (None, "size") else ()
    each = sweeps_of_a_world() + len(settings.poses)
    total = len(settings.seeds) * len(waters) * each + RUNS * len(surveyed) + len(swimming) + size_parts() * len(large)
    step = step_by_step(progress, total)
    cases = []
    for seed in settings.seeds:
        for water in waters:
            rendered = world(seed, water, SENSOR, step)
            truth = seen_twice(rendered)
            for poses in settings.poses:
                cases.append(case(rendered, truth, poses, settings.image))
                step()
    told = coverage(surveyed, step) if surveyed else dict[str, Any](coverage={}, coverage_runs={}, coverage_equal={})
    swum_rows = []
    for seed in swimming:
        swum_rows.append(swum(seed))
        step()
    rows = [row for seed in large for row in size(seed, step)]
    absent = missed(cases) + missed_pictures(cases) + missed_coverage(told) + missed_size(rows)
    return Result(cases=cases, swimmers=swum_rows, size=rows, size_verdict=verdict(rows), missed=absent, **told)


def case(rendered: Rendered, truth_m: Floats, poses: PosesKind, picture: ImageSettings | None = None) -> Row:
    """Surfaces from one tank's views, scored; pictures by the surface's own colours, where poses are exact, and by an
    image model where one is asked for."""
    views = rendered.trained if poses == "exact" else noisy(rendered.trained, rendered.seed)
    start = processor_s()
    if poses == "refined":
        views = refine(views).views
    refined_s = processor_s() - start
    made = surfaces(views)
    focus, sweep, both = (_scored(mesh, views, rendered, truth_m) for mesh in (made.focus, made.sweep, made.both))
    exact = poses == "exact"  # else views that are held back would have to be aligned first
    return {
        "seed": rendered.seed,
        "water": rendered.water,
        "poses": poses,
        "median_mm": both.median_mm,
        "complete_10mm": both.complete_10mm,
        "f5": both.f5,
        "psnr_in": mean_psnr(made.both, rendered.known) if exact else None,
        "psnr_new": mean_psnr(made.both, rendered.new) if exact else None,
        "seconds": made.both_s,
        "picture": "surface colours",
        "refine_seconds": refined_s if poses == "refined" else None,
        **pose_row(views, rendered),
        **(_pictured(made, rendered, views, picture) if picture else {}),
        "both": both._asdict(),
        "sweep": sweep._asdict(),
        "focus": {**focus._asdict(), "seconds": made.focus_s},
    }


def _pictured(made: Surfaces, rendered: Rendered, views: list[View], settings: ImageSettings) -> Row:
    """In place of the surface's own colours, which stay in the row by another name."""
    start = processor_s()
    model = image(made.views, made.both, CELL_M, settings, lambda done, total: None, monotonic_s)
    seconds = processor_s() - start
    return {**picture_row(model, rendered, views), "picture": model.kind, "image_seconds": seconds}


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


def mean_psnr(mesh: Mesh, held: list[View]) -> float:
    """dB over all pixels of views that nothing was made of; where there is no surface a rendering is black."""
    render_one = render_of(mesh)
    everywhere = [np.ones(view.depth_m.shape, bool) for view in held]
    each = [psnr_db(view.picture, render_one(view).picture, k) for view, k in zip(held, everywhere, strict=True)]
    return float(np.mean([value for value in each if value is not None]))


def missed(cases: list[Row]) -> list[str]:
    """Bars that a case with exact poses does not reach."""
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
