"""How true a surface is: each of its points against the twin's solids and walls, each place that was seen against it;
and how good image models and refined poses are.

Truth of points is the scene itself, truth of places what the painter's ray caster sees from the trained stations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from agent.experiments.reconstruction.render import BOX_M, Rendered
from agent.reconstruction.held_back import ImageModel, judged
from agent.reconstruction.pose_evidence import apart, between, by_motion
from agent.reconstruction.views import Floats, View, see, surface_points
from hw.twin.optics.raycast import turned
from hw.twin.scene import Solid

NEAR_M, F_M = 10e-3, 5e-3  # a place counts as covered within the first; precision and recall of F within the second
THIN_M = 4e-3  # cells of which one true place is kept: of the floor no more than of a stone
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
