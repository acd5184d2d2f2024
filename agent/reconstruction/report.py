"""The page of a reconstruction: its surface, views beside photographs that were held back, and how sure it is."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import jinja2
import matplotlib
import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from agent.core.config import write_whole
from agent.process.command import Progress, Show
from agent.reconstruction.export import GAMMA, encoded
from agent.reconstruction.fusion import Built
from agent.reconstruction.held_back import HeldBack
from agent.reconstruction.mesh import Mesh, Rendered, pieces_of, rendered
from agent.reconstruction.sources import DISTANCE_M
from agent.reconstruction.views import Camera, Floats, View
from replay.files.frames import film
from replay.report.page import PAGE

# --- rendered views beside photographs that nothing was made of ---

Render = Callable[[View], Rendered]  # what a view would see; pixels that it cannot tell have no depth


class Beside(NamedTuple):
    """One photograph and its rendering, (height, width, 3) red green blue bytes."""

    name: str
    photograph: NDArray[np.uint8]
    rendering: NDArray[np.uint8]
    psnr_db: float | None  # over the pixels that show the surface, of encoded light; None: none does
    shown: float  # share of the pixels that do


def render_of(mesh: Mesh) -> Render:
    """Surface colours: as the surface was seen, through as much water as the mean of the cameras that saw it."""
    pieces = pieces_of(mesh)
    return lambda view: rendered(mesh, mesh.colours, view.camera, view.rotation, view.position_m, pieces)


def beside(view: View, render: Render) -> Beside:
    """Hold a view against what is rendered for its pose."""
    seen = render(view)
    there = np.isfinite(seen.depth_m)
    photograph, rendering = encoded(view.picture), encoded(seen.picture)
    name = f"{view.robot} {view.seq}"
    return Beside(name, photograph, rendering, psnr_db(view.picture, seen.picture, there), float(there.mean()))


def psnr_db(a: NDArray[np.float32], b: NDArray[np.float32], where: NDArray[np.bool_]) -> float | None:
    """Of light encoded with 1 / 2.2, over the pixels of a mask; None where it is empty."""
    if not where.any():
        return None
    first, second = (np.clip(one[where], 0.0, 1.0).astype(float) ** (1.0 / GAMMA) for one in (a, b))
    return 10.0 * math.log10(1.0 / max(float(np.mean((first - second) ** 2)), 1e-12))


# --- the surface from where no robot was, by its colours or by how sure it is ---

WIDTH, HEIGHT, F_PX = 800, 600, 900.0
ELEVATION_DEG = 38.0  # from which the turntable looks down
FRAMES, FPS = 120, 20.0  # once round in six seconds
BEST_M, WORST_M = 1e-3, 20e-3  # ends of the scale of sigma
MOST_VIEWS = 10  # end of the scale of views
GROUND = np.array([1.0, 1.0, 1.0], np.float32)


def by_sigma(mesh: Mesh) -> NDArray[np.float32]:
    """A colour (n, 3) for each vertex: dark where it is known to BEST_M, bright at WORST_M, on a logarithmic scale."""
    share = np.log(np.clip(mesh.sigma_m, BEST_M, WORST_M) / BEST_M) / math.log(WORST_M / BEST_M)
    return _mapped("inferno", share)


def by_views(mesh: Mesh) -> NDArray[np.float32]:
    """A colour (n, 3) for each vertex: dark where one view saw it, bright from MOST_VIEWS on."""
    return _mapped("viridis", (np.clip(mesh.views, 1, MOST_VIEWS) - 1.0) / (MOST_VIEWS - 1.0))


def looked_at(mesh: Mesh, colours: NDArray[np.float32], bearing_deg: float, elevation_deg: float) -> NDArray[np.uint8]:
    """(height, width, 3) red green blue; only what faces the eye, so that the view goes through walls into a tank."""
    low, high = np.quantile(mesh.vertices_m, (0.01, 0.99), axis=0)
    middle, size = (low + high) / 2.0, float(np.linalg.norm(high - low))
    b, e = math.radians(bearing_deg), math.radians(elevation_deg)
    back = np.array([math.cos(b) * math.cos(e), math.sin(b) * math.cos(e), math.sin(e)])
    right = np.array([-math.sin(b), math.cos(b), 0.0])
    rotation: Floats = np.stack([right, np.cross(-back, right), -back], axis=1)
    camera = Camera(F_PX, (WIDTH - 1) / 2.0, (HEIGHT - 1) / 2.0, 0.0, 0.0, WIDTH, HEIGHT)
    eye = middle + back * 0.95 * size * F_PX / HEIGHT
    facing = ((eye - mesh.vertices_m[mesh.faces[:, 0]]) * _normals(mesh)).sum(axis=1) > 0.0
    seen = rendered(mesh._replace(faces=np.ascontiguousarray(mesh.faces[facing])), colours, camera, rotation, eye)
    return encoded(np.where(np.isnan(seen.depth_m)[..., None], GROUND, seen.picture))


def write_turntable(mesh: Mesh, path: Path, progress: Progress) -> None:
    """A film once round the scene. Raises OSError where it cannot be written."""
    with film(path, FPS) as made:
        for done, image in enumerate(_round(mesh), start=1):
            made.add(image[..., ::-1])
            progress(done, FRAMES)


def _round(mesh: Mesh) -> Iterator[NDArray[np.uint8]]:
    for n in range(FRAMES):
        yield looked_at(mesh, mesh.colours, 360.0 * n / FRAMES, ELEVATION_DEG)


def _normals(mesh: Mesh) -> Floats:
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _mapped(name: str, share: NDArray[np.floating]) -> NDArray[np.float32]:
    shown = matplotlib.colormaps[name](share)[:, :3]
    return np.asarray(shown**2.2, np.float32)  # linear light, which is encoded again


# --- the page ---

TOP_DEG = 89.9
MOST_SHOWN = 12


class Section(NamedTuple):
    id: str
    title: str
    note: str
    tables: list[dict[str, Any]]
    figures: list[Markup]


def write_report(
    built: Built,
    held: Sequence[View],
    placed: Sequence[HeldBack],
    figures: dict[str, Any],
    out: Path,
    video: bool,
    show: Show,
) -> list[Path]:
    """report.html and turntable.mp4 into the folder; adds what the photographs say to `figures`.

    built, held: of the size of a tank, whatever the scene's own unit is; figures: in that unit.
    placed: what the image model makes of `held`, in the same order.
    """
    render = render_of(built.mesh)
    # Without photographs to spare, those that it was made of are shown, and not counted.
    compared = [beside(view, render) for view in (held or built.views)[:MOST_SHOWN]]
    known = [one.psnr_db for one in compared if one.psnr_db is not None]
    figures["psnr_held_back_db"] = round(float(np.mean(known)), 2) if held and known else None
    figures["shown_held_back"] = round(float(np.mean([one.shown for one in compared])), 4) if held else None
    sections = [
        _surface(built, figures),
        _photographs(compared, bool(held)),
        *_model(placed, figures),
        _certainty(built, in_metres(figures)),
    ]
    files = [out / "report.html"]
    if video:
        files.append(out / "turntable.mp4")
        write_turntable(built.mesh, files[1], lambda done, total: show(done, total, "turntable"))
    page = jinja2.Environment(autoescape=True).from_string(PAGE)
    robots = ", ".join(figures["robots"])
    about = f"{figures['views']} keyframes of {robots}; {figures['held_back']} more held back."
    text = page.render(title="Reconstruction", verdict="", reasons=[], about=about, sections=sections)
    write_whole(files[0], text)
    return files


def in_metres(figures: dict[str, Any]) -> bool:
    """Whether the scene's unit is known."""
    return "area_m2" in figures


def _surface(built: Built, figures: dict[str, Any]) -> Section:
    if in_metres(figures):
        names = ["area m2", "size m", "sigma mm, 10/50/90 %"]
        area, size, sigma = figures["area_m2"], figures["size_m"], figures["sigma_mm"]
    else:
        names = ["area, the scene's units", "size, units", "sigma, units, 10/50/90 %"]
        area, size, sigma = figures["area_units2"], figures["size_units"], figures["sigma_units"]
    rows = [
        ["triangles", *names, "seen by one view", "depths by plane sweep"],
        [
            figures["triangles"],
            f"{area:.3g}",
            " x ".join(f"{length:.3g}" for length in size),
            " / ".join(f"{value:.2g}" for value in sigma.values()),
            f"{figures['seen_by_one']:.0%}",
            f"{figures['by_plane_sweep']:.0%}",
        ],
    ]
    looks = [_picture(looked_at(built.mesh, built.mesh.colours, bearing, ELEVATION_DEG), f"{bearing} degrees")
             for bearing in (235, 55)]  # fmt: skip
    note = f"From two sides, what faces away left out; turntable.mp4 goes all round in {FRAMES} pictures."
    return Section("surface", "Surface", note, [{"about": "", "rows": rows}], looks)


def _photographs(compared: Sequence[Beside], held: bool) -> Section:
    rows: list[list[str]] = [["view", "PSNR dB", "of the picture shows surface"]]
    shown = []
    for one in compared:
        psnr = "-" if one.psnr_db is None else f"{one.psnr_db:.1f}"
        rows.append([one.name, psnr, f"{one.shown:.0%}"])
        shown.append(_picture(np.hstack([one.photograph, one.rendering]), f"{one.name}: photograph, rendering"))
    which = "that nothing was made of" if held else "that the surface was made of, for there are too few to spare any"
    note = f"Photographs {which}, and the surface's own colours as seen from there. Black: no surface."
    return Section("photographs", "Beside photographs", note, [{"about": "", "rows": rows}], shown)


def _model(placed: Sequence[HeldBack], figures: dict[str, Any]) -> list[Section]:
    """No section where there is no photograph to hold it against."""
    if not placed:
        return []
    rows, shown = [["view", "PSNR dB", "before it was placed"]], []
    for one in placed[:MOST_SHOWN]:
        name = f"{one.view.robot} {one.view.seq}"
        rows.append([name, f"{one.psnr_db:.1f}", f"{one.unplaced_db:.1f}"])
        both = np.hstack([encoded(one.view.picture), encoded(one.light)])
        shown.append(_picture(both, f"{name}: photograph, {figures['image']['kind']}"))
    note = "What the image model shows where the photograph found its place in it; nothing was learnt from these."
    return [Section("image", "Image model", note, [{"about": "", "rows": rows}], shown)]


def _certainty(built: Built, metres: bool) -> Section:
    mesh = built.mesh
    best, worst = (f"{1e3 * end:g} mm" if metres else f"{100 * end / DISTANCE_M:.1f} %" for end in (BEST_M, WORST_M))
    of = "" if metres else " of the distance to the cameras"
    looks = [
        _picture(looked_at(mesh, colours, 270.0, TOP_DEG), words)
        for colours, words in (
            (by_sigma(mesh), f"standard deviation, {best} (dark) to {worst} (bright){of}"),
            (by_views(mesh), f"views that saw it, 1 (dark) to {MOST_VIEWS} and more (bright)"),
        )
    ]
    note = "From above. White: nothing is known. Standard deviations are those of independent views with exact poses."
    return Section("certainty", "How sure, and what was seen", note, [], looks)


def _picture(image: NDArray[np.uint8], words: str) -> Markup:
    """A picture (height, width, 3) red green blue inside the page."""
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
    text = base64.b64encode(data.tobytes()).decode()
    style = "max-width:100%"
    return Markup('<img alt="{0}" style="{1}" src="data:image/jpeg;base64,{2}"><figcaption>{0}</figcaption>').format(
        escape(words), style, text
    )
