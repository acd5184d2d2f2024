"""`aucamp reconstruct`: recordings, or a folder of pictures with poses, into a surface, files and a report."""

from __future__ import annotations

import importlib.util
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.clock import machine
from agent.core.config import ConfigError, to_install, write_whole
from agent.process.command import Failed, Progress, Show
from agent.reconstruction import surfels
from agent.reconstruction.export import WORLD, Kind, Space, export
from agent.reconstruction.fusion import CELL_M, Built, build
from agent.reconstruction.held_back import HeldBack, ImageModel, ModelKind, held_back, judged, smaller
from agent.reconstruction.mesh import Mesh, seen_faces
from agent.reconstruction.plane_sweep import Range, neighbours, plane_sweep
from agent.reconstruction.refine_poses import refine
from agent.reconstruction.report import write_report
from agent.reconstruction.sources import DISTANCE_M, Length, recorded_views, transforms_views, unit_m
from agent.reconstruction.views import Floats, View, stacked

# --- the command ---

RESULT = "result.json"
AT_ONCE = 1_000_000  # triangles: those of a large scene as floats, all at once, would be a gigabyte


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    runs: tuple[Path, ...] = ()
    transforms: Path | None = None
    length: Length | None = None  # of the transforms; None: nobody knows their unit
    exports: tuple[Kind, ...] = ("ply",)
    cell_m: float = CELL_M
    stereo: bool = True
    video: bool = True
    refine: bool = True  # poses, by pictures and depths; pictures that others took keep theirs
    model: ModelKind = "surfels"


class Made(NamedTuple):
    """A scene of the size of a tank, in which lengths in metres mean what they say."""

    built: Built
    held: list[View]  # pictures that nothing was made of
    passed_over: dict[str, int]  # sweeps and pictures that gave no view, by reason
    notes: list[str]  # what a person should know of the pictures
    own: float = 1.0  # by what to multiply lengths for those of the scene
    metres: bool = True  # these are; else nobody knows their unit
    space: Space = WORLD  # of what is written


class Result(NamedTuple):
    built: Built  # in the scene's own unit and from its origin, as `held`
    held: list[View]
    files: list[Path]
    passed_over: dict[str, int]
    notes: list[str]
    figures: dict[str, Any]  # of result.json
    model: ImageModel


def run(settings: Settings, out: Path, show: Show) -> Result:
    """Write it all into an empty folder.

    Raises ConfigError for input that is none or damaged, Failed where nothing can be made of it.
    """
    if settings.transforms is not None:
        made = _from_pictures(settings, settings.transforms, show)
    else:
        made = _from_recordings(settings, show)
    views, mesh = scaled(made.built.views, made.own), scaled_mesh(made.built.mesh, made.own)
    files = [export(kind, views, mesh, settings.cell_m * made.own, out, made.space) for kind in settings.exports]
    figures = figures_of(views, mesh, made)
    model = image_model(
        settings.model,
        made.built.views,
        made.built.mesh,
        settings.cell_m,
        lambda done, total: show(done, total, "learning the picture"),
    )
    placed = judged(model.look, made.held)
    figures["image"] = image_figures(model, placed)
    files += write_report(made.built, made.held, placed, figures, settings.cell_m, out, settings.video, show)
    path = out / RESULT
    write_whole(path, json.dumps(figures, indent=1) + "\n")
    built, held = Built(views, mesh, made.built.swept), scaled(made.held, made.own)
    return Result(built, held, [*files, path], made.passed_over, made.notes, figures, model)


def _from_recordings(settings: Settings, show: Show) -> Made:
    views, passed_over = recorded_views(settings.runs, lambda done, total: show(done, total, "reading sweeps"))
    if not views:
        why = ", ".join(f"{count} with {reason}" for reason, count in passed_over.items())
        raise Failed(f"no whole sweep of the focus to build on in these recordings{f': {why}' if why else ''}")
    used, held = held_back(views)
    if settings.refine:
        used = refine(used, lambda done, total: show(done, total, "refining poses")).views
    return Made(_built(used, settings, settings.stereo, show), held, passed_over, [])


def _from_pictures(settings: Settings, folder: Path, show: Show) -> Made:
    """Pictures that others took have poses alone, and lengths of an unknown unit, unless one is known."""
    unit = 1.0 if settings.length is None else unit_m(folder, settings.length)
    posed = transforms_views(folder, show)
    origin = origin_of(posed.views)
    views = [replace(view, position_m=view.position_m - origin) for view in posed.views]
    by = scale_of(views)
    used, held = held_back(scaled(views, by))
    found = with_depths(used, lambda done, total: show(done, total, "looking for depths"))
    x, y, z = (float(f"{unit * one:.15g}") for one in origin)
    known = settings.length is not None
    space = Space("metres, axes of the scene", "sigma_m") if known else Space("units and axes of the scene", "sigma")
    space = space._replace(origin=(x, y, z))
    notes = list(posed.notes)
    if space.away:
        notes.append(f"the scene lies far from zero: files count from its {space.away}")
    return Made(_built(found, settings, True, show), held, posed.passed_over, notes, unit / by, known, space)


def _built(views: Sequence[View], settings: Settings, stereo: bool, show: Show) -> Built:
    built = build(views, settings.cell_m, stereo, show)
    if not len(built.mesh.faces):
        raise Failed("no two depths agree on a surface: check poses and calibration, or make --cell-mm larger")
    return built


def image_model(kind: ModelKind, views: Sequence[View], mesh: Mesh, cell_m: float, progress: Progress) -> ImageModel:
    """What the scene looks like, learnt from all views, whose poses are taken as they are.

    mesh: the surface, from cells of cell_m; a field starts from one of its own, of the views' depths. Raises
    ConfigError for a field without torch.
    """
    if kind == "surfels":
        return surfels.learnt(views, mesh, cell_m, progress)
    if importlib.util.find_spec("torch") is None:
        raise ConfigError(f"a field needs torch: {to_install('reconstruct')}, or leave out --model")
    from agent.reconstruction import field  # torch takes seconds to import, and may be absent

    return field.learnt(views, field.FieldSettings(), progress, machine.monotonic_s)


def image_figures(model: ImageModel, placed: Sequence[HeldBack]) -> dict[str, Any]:
    """What the image model is, and what it is worth on photographs that nothing was made of."""
    return {
        "kind": model.kind,
        "steps": model.steps,
        "psnr_held_back_db": round(float(np.mean([one.psnr_db for one in placed])), 2) if placed else None,
        "beta_mm": None if model.beta_mm is None else round(model.beta_mm, 2),
        "beta_clamped": model.beta_clamped,
    }


def figures_of(views: Sequence[View], mesh: Mesh, made: Made) -> dict[str, Any]:
    """Counts, and how sure what was seen of the surface is.

    Lengths are in metres, or, where nobody knows the unit, in the scene's own: their names say which.
    """
    size = [float(f"{length:.4g}") for length in np.ptp(mesh.vertices_m, axis=0).tolist()]
    seen = mesh.views > 0
    sigma = {f"p{percent}": float(np.percentile(mesh.sigma_m[seen], percent)) for percent in (10, 50, 90)}
    area, of_seen = area_m2(mesh), area_m2(mesh._replace(faces=seen_faces(mesh)))
    if made.metres:
        lengths: dict[str, Any] = {
            "area_m2": round(area, 4),
            "size_m": size,
            "sigma_mm": {name: round(1e3 * value, 2) for name, value in sigma.items()},
        }
    else:
        lengths = {
            "area_units2": float(f"{area:.4g}"),
            "size_units": size,
            "sigma_units": {name: float(f"{value:.3g}") for name, value in sigma.items()},
        }
    if made.space.away:
        lengths["origin_m" if made.metres else "origin_units"] = list(made.space.origin)
    return {
        "views": len(views),
        "held_back": len(made.held),
        "robots": sorted({view.robot for view in views}),
        "vertices": len(mesh.vertices_m),
        "triangles": len(mesh.faces),
        **lengths,
        "concluded": round(1.0 - of_seen / area, 4),  # share of the area
        "seen_by_one": round(float(np.mean(mesh.views[seen] == 1)), 4),
        "by_plane_sweep": round(made.built.swept, 4),
    }


def area_m2(mesh: Mesh) -> float:
    """Of all triangles."""
    total = 0.0
    for first in range(0, len(mesh.faces), AT_ONCE):
        a, b, c = (mesh.vertices_m[mesh.faces[first : first + AT_ONCE, k]] for k in range(3))
        total += 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    return total


# --- pictures that come with poses alone ---
#
# Their depths are those of a plane sweep over the whole range, then of a finer one around it. Such scenes have any
# unit, so they are brought to the size of a tank first: what cameras look at is then DISTANCE_M away, and lengths in
# metres mean what they say. What is written of them is in their own unit again.

NEAR, FAR = 0.25, 5.0  # shares of that, between which things are looked for
EVERYWHERE = Range(NEAR * DISTANCE_M, FAR * DISTANCE_M)
STEPS = 2.0  # of the wide sweep, as sigma: what its depths are good for
FAR_AWAY = 1000.0  # times as far as cameras are apart: floats of 32 bits are then off by a hundredth of a cell
SMALLER = 2  # times, are the pictures that are looked through first

Depths = NDArray[np.float32]


def scale_of(views: Sequence[View]) -> float:
    """By what to multiply lengths. Raises Failed where cameras look at nothing together."""
    centre = looked_at(views)
    distances = [float((centre - view.position_m) @ view.rotation[:, 2]) for view in views]
    typical = float(np.median(distances))
    if not typical > 0.0:
        raise Failed("the cameras do not look at one scene: what is nearest to all their axes is behind them")
    return DISTANCE_M / typical


def origin_of(views: Sequence[View]) -> Floats:
    """What a scene (3,) is counted from: zero, or, where it lies so far away that numbers of 32 bits, as most formats
    have, would not tell its places apart, a round place among its cameras."""
    places = np.array([view.position_m for view in views])
    middle = np.median(places, axis=0)
    spread = float(np.median(np.linalg.norm(places - middle, axis=1)))
    if spread == 0.0 or float(np.abs(middle).max()) <= FAR_AWAY * spread:
        return np.zeros(3)
    step = 10.0 ** math.floor(math.log10(spread))
    return np.asarray(np.rint(middle / step) * step)


def looked_at(views: Sequence[View]) -> Floats:
    """The place (3,) that is nearest to the optical axes of all views, least squares."""
    normal, right = 1e-9 * np.eye(3), np.zeros(3)
    for view in views:
        axis = view.rotation[:, 2]
        across = np.eye(3) - np.outer(axis, axis)
        normal += across
        right += across @ view.position_m
    return np.asarray(np.linalg.solve(normal, right))


def scaled(views: Sequence[View], by: float) -> list[View]:
    """All lengths multiplied."""
    if by == 1.0:  # views of a dive: a copy of all their pictures' depths would be for nothing
        return list(views)
    return [
        replace(
            view,
            camera=view.camera._replace(ahead_m=view.camera.ahead_m * by),
            position_m=view.position_m * by,
            depth_m=(view.depth_m * by).astype(np.float32),
            sigma_m=(view.sigma_m * by).astype(np.float32),
        )
        for view in views
    ]


def scaled_mesh(mesh: Mesh, by: float) -> Mesh:
    return mesh._replace(vertices_m=mesh.vertices_m * by, sigma_m=(mesh.sigma_m * by).astype(np.float32))


def with_depths(views: Sequence[View], progress: Progress) -> list[View]:
    """Views of a scene of the size of a tank, with depths where two neighbours have the same.

    In smaller pictures first: that is most of the work saved, and windows are larger there, in which more has texture.
    """
    small = [smaller(view, SMALLER) for view in views]
    first = _looked_for(small, None, lambda done, total: progress(done, 2 * total))
    before = np.full(stacked(views, 0).depth_m.shape, np.nan, np.float32)
    for n, depth in enumerate(first):
        large = np.kron(depth, np.ones((SMALLER, SMALLER), np.float32))
        before[n, : large.shape[0], : large.shape[1]] = large
    found = _looked_for(views, before, lambda done, total: progress(total + done, 2 * total))
    step = (1.0 / EVERYWHERE.near_m - 1.0 / EVERYWHERE.far_m) / EVERYWHERE.hypotheses
    return [
        replace(view, depth_m=depth, sigma_m=(STEPS * step * depth**2).astype(np.float32))
        for view, depth in zip(views, found, strict=True)
    ]


def _looked_for(views: Sequence[View], before: Depths | None, progress: Progress) -> list[Depths]:
    """Depths (height, width) of each view, all along the line of sight where there was none before."""
    guess = [replace(view, depth_m=np.full_like(view.depth_m, DISTANCE_M)) for view in views]
    near_by = neighbours(stacked(guess, 0))
    found = plane_sweep(stacked(views), near_by, progress, EVERYWHERE, before).depth_m
    return [found[n, : view.camera.height, : view.camera.width] for n, view in enumerate(views)]
