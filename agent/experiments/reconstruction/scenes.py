"""Scenes from focus sweeps: surfaces by focus alone, by comparing pictures alone, and by both, against the twin's
truth; and what a scene looks like, on photographs held back. Poses are exact, off as a survey by hand leaves them, or
refined.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, cast, get_args

import msgspec
import numpy as np

from agent.core.config import WaterKind
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Value
from agent.experiments.reconstruction.render import MOORED, Rendered, noisy, render
from agent.experiments.reconstruction.score import Score, into_truth, off_mm, psnr_known_new, score, seen_twice
from agent.reconstruction.fusion import CELL_M, fuse, merged, swept_twice
from agent.reconstruction.mesh import coloured, mesh_of
from agent.reconstruction.refine_poses import refine
from agent.reconstruction.run import image_model
from agent.reconstruction.views import Floats, Stack, stacked

WATERS: tuple[WaterKind, ...] = ("tap", "coastal")
Poses = Literal["exact", "noisy", "refined"]
POSES: tuple[Poses, ...] = get_args(Poses)


def judged_scene(rendered: Rendered, truth_m: Floats, poses: Poses, seed: int) -> Row:
    """Surfaces from one tank's views, and an image model on the one by both, scored."""
    views = rendered.trained if poses == "exact" else noisy(rendered.trained, seed)
    if poses == "refined":
        views = refine(views).views
    by_focus = stacked(views)
    found = swept_twice(views, by_focus, CELL_M)
    together = merged(by_focus, found)

    def told(stack: Stack) -> Score:
        mesh = mesh_of(fuse(stack, CELL_M))
        return score(into_truth(mesh.vertices_m, views, rendered), rendered, truth_m)

    depths = zip(views, together.depth_m, together.sigma_m, strict=True)
    better = [replace(view, depth_m=depth_m, sigma_m=sigma_m) for view, depth_m, sigma_m in depths]
    mesh = coloured(mesh_of(fuse(together, CELL_M)), together)
    model = image_model("surfels", better, mesh, CELL_M, lambda done, total: None)
    focus, both, (known_db, new_db) = told(by_focus), told(together), psnr_known_new(model, rendered, views)
    return {
        "poses": poses,
        "focus_median_mm": focus.median_mm,
        "focus_complete_10mm": focus.complete_10mm,
        "sweep_objects_mm": told(by_focus._replace(depth_m=found.depth_m, sigma_m=found.sigma_m)).objects_mm,
        "median_mm": both.median_mm,
        "f5": both.f5,
        "known_db": known_db,
        "new_db": new_db,
        "off_mm": off_mm(views, rendered.trained),
    }


# --- the claim ---

TANKS = 80.0  # per cent of the tanks that have to keep a limit


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    exact_only: bool = False  # no poses that are off
    robots: int = len(MOORED)  # of the five
    sensor: Literal["crop_1280", "imx519_640"] = "crop_1280"  # presets of hw.twin.optics.lens


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """A row for each kind of poses: frames are rendered once for all."""
    rendered = render(seed, cast(WaterKind, case), settings.sensor, settings.robots)
    truth_m = seen_twice(rendered)
    kinds = POSES[:1] if settings.exact_only else POSES
    return [judged_scene(rendered, truth_m, poses, seed) for poses in kinds]


def summary(rows: Rows) -> dict[str, Value]:
    """A tank is as good as in the water in which it is worst; refined poses lose against exact ones."""
    exact, noisy_, refined = (of_poses(rows, poses) for poses in POSES)
    found: dict[str, Value] = {}
    for key in ("focus_median_mm", "sweep_objects_mm", "median_mm") if exact else ():
        found[key] = Quantile([max(_or_never(row[key]) for row in tank) for tank in exact], TANKS)
    for key in ("focus_complete_10mm", "f5", "known_db", "new_db") if exact else ():
        found[key] = Quantile([min(row[key] for row in tank) for tank in exact], 100.0 - TANKS)
    for key in ("f5", "known_db", "new_db") if exact and refined else ():
        pairs = [zip(*tanks, strict=True) for tanks in zip(exact, refined, strict=True)]
        found[f"lost_{key}"] = Quantile([max(a[key] - b[key] for a, b in tank) for tank in pairs], TANKS)
    for name, tanks in (("noisy", noisy_), ("refined", refined)):
        for key in ("off_mm", "f5") if tanks else ():
            found[f"{name}_{key}"] = float(np.mean([row[key] for tank in tanks for row in tank]))
    return found


def of_poses(rows: Rows, poses: Poses) -> list[tuple[Row, ...]]:
    """Of each seed its rows in all waters."""
    return list(zip(*([row for row in each if row["poses"] == poses] for each in rows.values()), strict=True))


def _or_never(value: float | None) -> float:
    return math.inf if value is None else value


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=WATERS,
    quick={"exact_only": True, "robots": 1, "sensor": "imx519_640"},
    measured_on="twin",
    figures=(
        Figure("focus_median_mm", "surface by focus alone: its median error", "mm", most=2.5),
        Figure("focus_complete_10mm", "it is within 10 mm of so much of what two views see", "%", least=83.0),
        Figure("sweep_objects_mm", "by comparing pictures alone: mean error on things", "mm", most=1.0),
        Figure("median_mm", "surface by both: its median error", "mm"),
        Figure("f5", "its F of precision and recall within 5 mm", "%", least=85.0),
        Figure("known_db", "photographs from known stations: PSNR", "dB", least=30.0),
        Figure("new_db", "photographs from new stations", "dB", least=27.0),
        Figure("noisy_off_mm", "poses as surveyed by hand are off, mean", "mm"),
        Figure("noisy_f5", "F by such poses, mean", "%"),
        Figure("refined_off_mm", "the same poses refined are off, mean", "mm"),
        Figure("refined_f5", "F by refined poses, mean", "%"),
        Figure("lost_f5", "F lost by refined poses, against exact ones", "%", most=5.0),
        Figure("lost_known_db", "PSNR that they lose at known stations", "dB", most=1.0),
        Figure("lost_new_db", "PSNR that they lose at new stations", "dB", most=1.0),
    ),
    seeds=14,  # as many as the 80 % take
    explanation="""Five moored robots sweep a tank from 45 views; each seed draws a ball, four stones and the lenses;
        seed 0 has the paper's tank, on which parameters were chosen. Surfaces are held against the twin's solids and
        walls, pictures of surfels against photographs that they have not seen. A figure with a target is one that four
        of five tanks keep, each in the water in which it is worst.""",
)
