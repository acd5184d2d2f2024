"""Time and memory of one reconstruction, in a process of its own: what it needed at most is asked of the system."""

from __future__ import annotations

import multiprocessing
import resource
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from agent.clock.machine import monotonic_s, processor_s
from agent.experiments.reconstruction.noisy import noisy
from agent.experiments.reconstruction.score import distances_to
from agent.experiments.reconstruction.size.basin import SIZE_M, SURFACE_M, basin
from agent.experiments.result import Row
from agent.reconstruction.export import export
from agent.reconstruction.fusion import CELL_M, build
from agent.reconstruction.held_back import psnr_db
from agent.reconstruction.image_model import ImageModel, ImageSettings, image
from agent.reconstruction.plane_sweep import COMPARED, neighbours
from agent.reconstruction.pose_evidence import apart, between, by_motion
from agent.reconstruction.refine_poses import refine
from agent.reconstruction.run import figures_of
from agent.reconstruction.views import Camera, View, stacked

SAMPLED = 50_000  # vertices that are held against the truth: one in so many
MB = 1e6
SHOWN = 20  # pictures are held against what surfels show
SURFELS = ImageSettings(kind="surfels")
COMPILED_CELL_M = 0.02  # of a first, small reconstruction, which is not timed: kernels are compiled by it


def keep(views: Iterable[View], folder: Path) -> None:
    """One file a view, in order."""
    for n, view in enumerate(views):
        arrays: dict[str, Any] = {field.name: np.asarray(getattr(view, field.name)) for field in fields(view)}
        np.savez(folder / f"{n:04d}.npz", **arrays)


def kept(folder: Path, count: int) -> list[View]:
    """The first `count` of them."""
    return [_view(folder / f"{n:04d}.npz") for n in range(count)]


def _view(path: Path) -> View:
    with np.load(path) as file:
        told: dict[str, Any] = dict(file)
    width, height = told["camera"][5:].astype(int).tolist()
    f_px, cx_px, cy_px, bend, ahead_m = told["camera"][:5].tolist()
    told["camera"] = Camera(f_px, cx_px, cy_px, bend, ahead_m, width, height)
    return View(**{**told, "robot": str(told["robot"]), "incarnation": "", "seq": int(told["seq"])})


def measured(folder: Path, count: int, seed: int) -> Row:
    """The first `count` keyframes of a folder as `aucamp reconstruct` goes through them, in a process that does nothing
    else: poses that are off are refined; of exact ones a surface is made, a PLY file beside them, and surfels."""
    processes = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=processes) as pool:
        return pool.submit(_measure, folder, count, seed).result()


def _measure(folder: Path, count: int, seed: int) -> Row:
    _compile(folder, seed)
    views = kept(folder, count)
    refined = _refined(views, seed)
    start = processor_s()
    built = build(views, CELL_M, True, _silent)
    export("ply", built.views, built.mesh, CELL_M, folder)
    seconds = processor_s() - start
    surface_mb, figures = _peak_mb(), figures_of(built, ())
    compared = int((neighbours(stacked(views, 0)).of[:, :COMPARED] >= 0).sum())
    start = processor_s()
    model = image(built.views, built.mesh, CELL_M, SURFELS, _silent, monotonic_s)
    image_s, peak_mb = processor_s() - start, _peak_mb()
    step = max(1, len(built.mesh.vertices_m) // SAMPLED)
    box = np.array([*SIZE_M[:2], SURFACE_M])
    off, _ = distances_to(built.mesh.vertices_m[::step], box, basin(seed).solid)
    return {
        "keyframes": count,
        "robots": len({view.robot for view in views}),
        "seconds": round(seconds, 1),
        "seconds_per_keyframe": round(seconds / count, 3),
        **refined,
        "image_seconds": round(image_s, 1),
        "image_db": round(_shown_db(model, views), 2),
        "surface_mb": round(surface_mb),
        "peak_mb": round(peak_mb),
        "triangles": len(built.mesh.faces),
        "median_mm": round(1e3 * float(np.median(off)), 3),
        "within_10mm": round(100.0 * float(np.mean(off < 0.01)), 1),
        "by_plane_sweep": round(100.0 * built.swept, 1),
        "area_m2": round(figures["area_m2"], 1),
        "compared": round(compared / count, 2),
    }


def _compile(folder: Path, seed: int) -> None:
    """All of it once, coarsely, with a few keyframes."""
    few = kept(folder, 3)
    refine(noisy(few, seed))
    built = build(few, COMPILED_CELL_M, True, _silent)
    image(built.views, built.mesh, COMPILED_CELL_M, SURFELS, _silent, monotonic_s)


def _refined(views: list[View], seed: int) -> Row:
    """How long it takes to find poses that are as wrong as a survey by hand leaves them, and how far off they are then,
    the common motion taken off."""
    believed = noisy(views, seed)
    start = processor_s()
    found = refine(believed)
    seconds = processor_s() - start
    motions = [between(some, views) for some in (believed, found.views)]
    metres, radians = apart([by_motion(view, motions[1]) for view in found.views], views)
    before, _ = apart([by_motion(view, motions[0]) for view in believed], views)
    return {
        "refine_seconds": round(seconds, 2),
        "matches": found.matches,
        "believed_mm": round(1e3 * float(before.mean()), 2),
        "place_mm": round(1e3 * float(metres.mean()), 2),
        "turn_deg": round(float(np.degrees(radians.mean())), 3),
        "refine_mb": round(_peak_mb()),
    }


def _shown_db(model: ImageModel, views: list[View]) -> float:
    """Mean PSNR of some of the pictures that the surfels were fitted to: that nothing went wrong, no more."""
    some = views[:: max(1, len(views) // SHOWN)]
    return float(np.mean([psnr_db(model.look(view)[0], view.picture) for view in some]))


def _peak_mb() -> float:
    """Largest resident memory of this process so far. A process that was started by a larger one may be told that one's
    by getrusage, so Linux is asked for what this program alone has used."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) * 1024.0 / MB
    except OSError:
        pass
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / MB


def _silent(done: int, total: int, what: str = "") -> None:
    """Nobody looks."""
