"""Scenes from focus sweeps: surfaces by focus alone, by comparing pictures alone, and by both, against the twin's
truth; and what a scene looks like, on photographs held back. Poses are exact, off as a survey by hand leaves them, or
refined.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple, cast, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from agent.core.config import WaterKind
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Value
from agent.experiments.reconstruction.render import BOX_M, MOORED, Rendered, noisy, render
from agent.reconstruction.fusion import CELL_M, fuse, merged, surface_of, swept_twice
from agent.reconstruction.held_back import ImageModel, judged
from agent.reconstruction.mesh import Mesh, mesh_of
from agent.reconstruction.pose_evidence import apart, between, by_motion
from agent.reconstruction.refine_poses import refine
from agent.reconstruction.run import image_model
from agent.reconstruction.views import Floats, Stack, View, see, stacked, surface_points
from hw.twin.optics.raycast import turned
from hw.twin.scene import Solid

# --- scores ---
# How true a surface is: each of its points against the twin's solids and walls, each place that was seen against it;
# and how good image models and refined poses are.
#
# Truth of points is the scene itself, truth of places what the painter's ray caster sees from the trained stations.

NEAR_M, F_M = 10e-3, 5e-3  # a place counts as covered within the first; precision and recall of F within the second
THIN_M = 4e-3  # cells of which one true place is kept: of the floor no more than of a stone
WITHIN = 2.0  # standard deviations
HIDDEN = 1.01  # a place is seen if nothing is nearer by more than this factor


class Score(NamedTuple):
    """Millimetres, and per cent."""

    median_mm: float
    objects_mm: float | None  # mean over points that are nearest to a solid; None: there is none
    complete_10mm: float  # share of the places that two trained views see
    f5: float  # harmonic mean of precision and recall


def score(points_m: Floats, rendered: Rendered, truth_m: Floats) -> Score:
    """Points (n, 3) of a surface against one tank; truth_m (m, 3) from `seen_twice`."""
    distance, of_solid = distances_to(points_m, BOX_M, rendered.scene.solid)
    nearest = nearest_m(truth_m, points_m, NEAR_M)
    precision, recall = float(np.mean(distance < F_M)), float(np.mean(nearest < F_M))
    return Score(
        median_mm=1e3 * float(np.median(distance)),
        objects_mm=1e3 * float(distance[of_solid].mean()) if of_solid.any() else None,
        complete_10mm=100.0 * float(np.mean(nearest < NEAR_M)),
        f5=100.0 * 2.0 * precision * recall / max(precision + recall, 1e-9),
    )


def distances_to(points_m: Floats, box: Floats, things: Sequence[Solid]) -> tuple[Floats, NDArray[np.bool_]]:
    """From each point (n, 3) to the nearest true surface, metres, and whether that is a thing's; box (3,): size of the
    water. Boxes may be turned, ellipsoids stand straight."""
    walls = np.minimum(np.abs(points_m), np.abs(points_m - box)).min(axis=1)
    solids = np.full(len(points_m), np.inf)
    for solid in things:
        of_one = _to_box if solid.kind == "box" else _to_ellipsoid
        there = (points_m - solid.position_m) @ turned(solid.turn_deg)
        solids = np.minimum(solids, of_one(there, np.array(solid.radii_m)))
    return np.minimum(walls, solids), solids < walls


def _to_box(points: Floats, half: Floats) -> Floats:
    over = np.abs(points) - half
    inside = np.minimum(over.max(axis=1), 0.0)
    return np.asarray(np.abs(np.linalg.norm(np.maximum(over, 0.0), axis=1) + inside))


def _to_ellipsoid(points: Floats, radii: Floats) -> Floats:
    """Distance by a few steps of projection along the gradient of |p / r|; exact on a ball, 1 % within a radius."""
    foot = points.copy()
    for _ in range(8):
        scaled = foot / radii
        size = np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-9)
        foot = foot / size  # onto the surface
        normal = foot / radii**2
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        foot = points - normal * ((points - foot) * normal).sum(axis=1, keepdims=True)
    scaled = foot / radii
    foot = foot / np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-9)
    return np.asarray(np.linalg.norm(points - foot, axis=1))


def seen_twice(rendered: Rendered) -> Floats:
    """True places (m, 3) that at least two trained views see, one of each cell of THIN_M."""
    points = np.concatenate([surface_points(view).reshape(-1, 3) for view in rendered.true])
    cells = np.floor(points / THIN_M).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    places = points[np.sort(first)]
    seen = np.zeros(len(places), np.int64)
    for view in rendered.true:
        seen += _visible(view, places)
    return places[seen >= 2]


def _visible(view: View, places: Floats) -> NDArray[np.bool_]:
    pixels, z = see(view, places)
    with np.errstate(invalid="ignore"):
        col, row = (np.where(np.isfinite(pixels[:, k]), np.rint(pixels[:, k]), -1).astype(np.int64) for k in (0, 1))
    inside = (col >= 0) & (row >= 0) & (col < view.camera.width) & (row < view.camera.height)
    behind = z > HIDDEN * view.depth_m[np.where(inside, row, 0), np.where(inside, col, 0)] + 2e-3
    return np.asarray(inside & ~behind)


def nearest_m(of_m: Floats, among_m: Floats, most_m: float) -> Floats:
    """From each point (n, 3) to the nearest of others (m, 3), metres; most_m where there is none within it."""
    distance, _ = cKDTree(among_m).query(of_m, distance_upper_bound=most_m)
    return np.asarray(np.minimum(distance, most_m))


# --- image models on photographs held back, and poses before and after they were refined ---
# Refined poses are known but for one motion of everything: held-back views are carried into the model's world,
# and points of its surface back into the true one, before anything is compared.


def psnr_known_new(model: ImageModel, rendered: Rendered, views: Sequence[View]) -> tuple[float, float]:
    """Mean PSNR, dB, of photographs from stations that were trained on, and from others; views: those that the model
    learnt from, with the poses that they had then."""
    there = between(rendered.trained, views)
    known, new = (
        float(np.mean([one.psnr_db for one in judged(model.look, [by_motion(view, there) for view in group])]))
        for group in (rendered.known, rendered.new)
    )
    return known, new


def off_mm(views: Sequence[View], true: Sequence[View]) -> float:
    """How far cameras are from their true places, mean over views, once the motion of everything is taken off."""
    motion = between(views, true)
    metres, _ = apart([by_motion(view, motion) for view in views], true)
    return 1e3 * float(metres.mean())


def into_truth(points_m: Floats, views: Sequence[View], rendered: Rendered) -> Floats:
    """Points (n, 3) of a surface made with these views, in the world in which the twin knows where everything is."""
    motion = between(views, rendered.trained)
    return np.asarray(points_m @ motion.rotation.T + motion.shift_m)


def concluded(mesh: Mesh, places_m: Floats, rendered: Rendered, truth_m: Floats) -> Row:
    """What the surface gains by what nobody saw; places_m (n, 3): its vertices in the true world."""
    nobody = mesh.views == 0
    found: Row = {
        "concluded_share": 100.0 * float(nobody.mean()),
        "whole_complete_10mm": score(places_m, rendered, truth_m).complete_10mm,
        "concluded_median_mm": None,
        "concluded_within": None,
    }
    if nobody.any():
        distance, _ = distances_to(places_m[nobody], BOX_M, rendered.scene.solid)
        found["concluded_median_mm"] = 1e3 * float(np.median(distance))
        found["concluded_within"] = 100.0 * float(np.mean(distance < WITHIN * mesh.sigma_m[nobody]))
    return found


# --- the claim ---

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
    mesh = surface_of(better, CELL_M)
    model = image_model("surfels", better, mesh, CELL_M, lambda done, total: None)
    focus, both, (known_db, new_db) = told(by_focus), told(together), psnr_known_new(model, rendered, views)
    return {
        "poses": poses,
        "focus_median_mm": focus.median_mm,
        "focus_complete_10mm": focus.complete_10mm,
        "sweep_objects_mm": told(by_focus._replace(depth_m=found.depth_m, sigma_m=found.sigma_m)).objects_mm,
        "median_mm": both.median_mm,
        "f5": both.f5,
        **concluded(mesh, into_truth(mesh.vertices_m, views, rendered), rendered, truth_m),
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
    for key in ("concluded_share", "concluded_median_mm", "concluded_within", "whole_complete_10mm") if exact else ():
        values = [row[key] for tank in exact for row in tank if row[key] is not None]
        found[key] = float(np.mean(values)) if values else math.nan
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
        Figure("concluded_share", "of the vertices of the whole surface nobody saw", "%"),
        Figure("concluded_median_mm", "what was concluded there: its median error, mean of the tanks", "mm"),
        Figure("concluded_within", "it is within two of its standard deviations", "%"),
        Figure("whole_complete_10mm", "seen or concluded within 10 mm, of what two views see", "%"),
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
