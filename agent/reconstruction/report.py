"""The pages of a reconstruction: a report of its surface, of views beside photographs that were held back and of how
sure it is; and the scene to be turned by hand.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
from collections.abc import Callable, Iterator, Sequence
from importlib.resources import files
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
from agent.reconstruction.mesh import Mesh, Rendered, pieces_of, rendered, seen_faces
from agent.reconstruction.sources import DISTANCE_M
from agent.reconstruction.views import Camera, Floats, View
from replay.files.frames import film
from replay.report.page import PAGE, PALETTE

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
GREY = np.float32(0.4)
GROUND = np.array([1.0, 1.0, 1.0], np.float32)


def by_sigma(mesh: Mesh) -> NDArray[np.float32]:
    """A colour (n, 3) for each vertex: dark where it is known to BEST_M, bright at WORST_M, on a logarithmic scale."""
    share = np.log(np.clip(mesh.sigma_m, BEST_M, WORST_M) / BEST_M) / math.log(WORST_M / BEST_M)
    return _mapped("inferno", share)


def by_views(mesh: Mesh) -> NDArray[np.float32]:
    """A colour (n, 3) for each vertex: dark where one view saw it, bright from MOST_VIEWS on; grey where none did."""
    colours = _mapped("viridis", (np.clip(mesh.views, 1, MOST_VIEWS) - 1.0) / (MOST_VIEWS - 1.0))
    return np.where((mesh.views > 0)[:, None], colours, GREY)


def looked_at(
    mesh: Mesh, colours: NDArray[np.float32], bearing_deg: float, elevation_deg: float, planes: Planes | None = None
) -> NDArray[np.uint8]:
    """(height, width, 3) red green blue; only what faces the eye, so that the view goes through walls into a tank.
    planes: of the mesh's faces, where more than one view is drawn."""
    stand = _stand(mesh, bearing_deg, elevation_deg)
    b, eye = math.radians(bearing_deg), stand.eye_m
    right = np.array([-math.sin(b), math.cos(b), 0.0])
    rotation: Floats = np.stack([right, np.cross(-stand.back, right), -stand.back], axis=1)
    camera = Camera(F_PX, (WIDTH - 1) / 2.0, (HEIGHT - 1) / 2.0, 0.0, 0.0, WIDTH, HEIGHT)
    planes = planes or planes_of(mesh)
    facing = planes.normals @ eye > planes.offsets
    seen = rendered(mesh._replace(faces=np.ascontiguousarray(mesh.faces[facing])), colours, camera, rotation, eye)
    return encoded(np.where(np.isnan(seen.depth_m)[..., None], GROUND, seen.picture))


class Planes(NamedTuple):
    """Of the faces of a mesh: an eye e sees the front of those with normal . e > offset."""

    normals: Floats  # (n, 3), of any length
    offsets: Floats  # (n,)


def planes_of(mesh: Mesh) -> Planes:
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    return Planes(normals, (a * normals).sum(axis=1))


class Stand(NamedTuple):
    """Where an eye has all of a scene before it."""

    middle_m: Floats  # (3,) that it looks at
    across_m: float  # size of the scene, a few far vertices apart
    back: Floats  # (3,) from the middle to the eye, a unit vector
    eye_m: Floats


def _stand(mesh: Mesh, bearing_deg: float, elevation_deg: float) -> Stand:
    low, high = np.quantile(mesh.vertices_m, (0.01, 0.99), axis=0)
    middle, across = (low + high) / 2.0, float(np.linalg.norm(high - low))
    b, e = math.radians(bearing_deg), math.radians(elevation_deg)
    back = np.array([math.cos(b) * math.cos(e), math.sin(b) * math.cos(e), math.sin(e)])
    return Stand(middle, across, back, middle + back * 0.95 * across * F_PX / HEIGHT)


def write_turntable(mesh: Mesh, path: Path, progress: Progress) -> None:
    """A film once round the scene. Raises OSError where it cannot be written."""
    with film(path, FPS) as made:
        for done, image in enumerate(_round(mesh), start=1):
            made.add(image[..., ::-1])
            progress(done, FRAMES)


def _round(mesh: Mesh) -> Iterator[NDArray[np.uint8]]:
    planes = planes_of(mesh)
    for n in range(FRAMES):
        yield looked_at(mesh, mesh.colours, 360.0 * n / FRAMES, ELEVATION_DEG, planes)


def _mapped(name: str, share: NDArray[np.floating]) -> NDArray[np.float32]:
    shown = matplotlib.colormaps[name](share)[:, :3]
    return np.asarray(shown**2.2, np.float32)  # linear light, which is encoded again


# --- the scene to be turned by hand: one page, which has its scene and what draws it inside ---

MOST_TRIANGLES = 400_000  # of the page: some 5 MB, which a telephone turns fluently
COARSER = 1.4  # cells of the next try, where there are more
START_DEG = 235.0  # bearing of the eye
BESIDE = 0.25  # of the scene's size: cameras that are so far from its middle, in the mean, are on one side of it
VIEWER = files("agent.reconstruction") / "viewer"
MODULES = {"three": "three.module.min.js", "controls": "OrbitControls.js"}


def write_scene(mesh: Mesh, cell_m: float, cameras_m: Floats, legends: Sequence[str], said: str, path: Path) -> None:
    """scene.html: the surface and its points, turned by mouse, touch or keyboard.

    mesh: from cells of cell_m; cameras_m (n, 3): where they were; legends: what the colours by sigma and by views
    mean; said: of the whole.
    """
    mesh, cell_m = coarser(mesh, cell_m, MOST_TRIANGLES)
    mesh, seen_vertices, seen_faces = seen_first(mesh)
    low, size = mesh.vertices_m.min(axis=0), np.maximum(np.ptp(mesh.vertices_m, axis=0), 1e-9)
    steps = np.rint((mesh.vertices_m - low) / size * 65535.0).astype("<u2")
    corners = np.diff(mesh.faces.ravel().astype("<i4"), prepend=np.int32(0))  # differences pack three times as well
    colours = {"picture": mesh.colours, "standard deviation": by_sigma(mesh), "views": by_views(mesh)}
    data = b"".join([corners.tobytes(), steps.tobytes(), *(encoded(one).tobytes() for one in colours.values())])
    stand = _stand(mesh, *_side(mesh, cameras_m))
    about = {
        "faces": len(mesh.faces),
        "vertices": len(mesh.vertices_m),
        "seen_faces": seen_faces,
        "seen_vertices": seen_vertices,
        "low": low.tolist(),
        "size": size.tolist(),
        "middle": stand.middle_m.tolist(),
        "eye": stand.eye_m.tolist(),
        "across": stand.across_m,
        "cell": cell_m,
        "colours": [{"name": name, "legend": text} for name, text in zip(colours, ("", *legends), strict=True)],
        "said": said,
    }
    imports = {name: "data:text/javascript;base64," + _base64((VIEWER / file).read_bytes())
               for name, file in MODULES.items()}  # fmt: skip
    page = jinja2.Environment().from_string((VIEWER / "scene.html").read_text(encoding="utf-8"))
    text = page.render(
        palette=PALETTE,
        imports=json.dumps({"imports": imports}),
        about=json.dumps(about),
        data=_base64(gzip.compress(data, mtime=0)),
    )
    write_whole(path, text)


def _side(mesh: Mesh, cameras_m: Floats) -> tuple[float, float]:
    """Bearing and elevation of the eye, degrees: where the cameras were, or from above where they were all round."""
    stand = _stand(mesh, 0.0, 0.0)
    x, y, z = (cameras_m.mean(axis=0) - stand.middle_m).tolist()
    if math.hypot(x, y, z) < BESIDE * stand.across_m:
        return START_DEG, ELEVATION_DEG
    return math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, math.hypot(x, y)))


def coarser(mesh: Mesh, cell_m: float, most: int) -> tuple[Mesh, float]:
    """The same surface of so many triangles at most, and the cells that vertices are then means of."""
    found = mesh
    while len(found.faces) > most:
        cell_m *= COARSER
        cube = np.floor(mesh.vertices_m / cell_m).astype(np.int64)
        _, which, count = np.unique(cube, axis=0, return_inverse=True, return_counts=True)
        which = which.ravel()
        vertices, normals, colours, sigma = (
            np.stack([np.bincount(which, column) / count for column in values.reshape(len(which), -1).T], axis=1)
            for values in (mesh.vertices_m, mesh.normals, mesh.colours, mesh.sigma_m)
        )
        views = np.zeros(len(count), np.uint8)
        np.maximum.at(views, which, mesh.views)
        faces = which[mesh.faces].astype(np.int32)
        whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        found = Mesh(
            vertices,
            faces[whole],
            normals.astype(np.float32),
            colours.astype(np.float32),
            sigma[:, 0].astype(np.float32),
            views,
        )
    return found, cell_m


def seen_first(mesh: Mesh) -> tuple[Mesh, int, int]:
    """Vertices and triangles that were seen before those that were concluded; how many of each were seen."""
    concluded = mesh.views == 0
    order = np.argsort(concluded, kind="stable")
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order))
    beyond = concluded[mesh.faces].any(axis=1)
    faces = number[mesh.faces[np.argsort(beyond, kind="stable")]]
    arrays = {name: getattr(mesh, name)[order] for name in ("vertices_m", "normals", "colours", "sigma_m", "views")}
    return mesh._replace(faces=faces, **arrays), int((~concluded).sum()), int((~beyond).sum())


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()


# --- the report ---

TOP_DEG = 89.9
MOST_SHOWN = 12


class Section(NamedTuple):
    id: str
    title: str
    note: str | Markup
    tables: list[dict[str, Any]]
    figures: list[Markup]


def write_report(
    built: Built,
    held: Sequence[View],
    placed: Sequence[HeldBack],
    figures: dict[str, Any],
    cell_m: float,
    out: Path,
    video: bool,
    show: Show,
) -> list[Path]:
    """report.html, scene.html and turntable.mp4 into the folder; adds what the photographs say to `figures`.

    built, held: of the size of a tank, whatever the scene's own unit is; figures: in that unit.
    placed: what the image model makes of `held`, in the same order.
    """
    render = render_of(built.mesh)
    # Without photographs to spare, those that it was made of are shown, and not counted.
    compared = [beside(view, render) for view in (held or built.views)[:MOST_SHOWN]]
    known = [one.psnr_db for one in compared if one.psnr_db is not None]
    figures["psnr_held_back_db"] = round(float(np.mean(known)), 2) if held and known else None
    figures["shown_held_back"] = round(float(np.mean([one.shown for one in compared])), 4) if held else None
    of_seen = render_of(built.mesh._replace(faces=seen_faces(built.mesh)))
    seen = [float(np.isfinite(of_seen(view).depth_m).mean()) for view in held[:MOST_SHOWN]]
    figures["seen_held_back"] = round(float(np.mean(seen)), 4) if held else None
    sections = [
        _surface(built, figures),
        _photographs(compared, bool(held)),
        *_model(placed, figures),
        _certainty(built, in_metres(figures)),
    ]
    written = [out / "report.html", out / "scene.html"]
    cameras_m = np.array([view.position_m for view in built.views])
    said = f"{figures['triangles']} triangles; {figures['concluded']:.0%} of the surface was concluded, not seen."
    write_scene(built.mesh, cell_m, cameras_m, _legends(in_metres(figures)), said, written[1])
    if video:
        written.append(out / "turntable.mp4")
        write_turntable(built.mesh, written[2], lambda done, total: show(done, total, "turntable"))
    page = jinja2.Environment(autoescape=True).from_string(PAGE)
    robots = ", ".join(figures["robots"])
    about = f"{figures['views']} keyframes of {robots}; {figures['held_back']} more held back."
    text = page.render(title="Reconstruction", verdict="", reasons=[], about=about, sections=sections)
    write_whole(written[0], text)
    return written


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
        ["triangles", *names, "concluded, not seen", "seen by one view", "depths by plane sweep"],
        [
            figures["triangles"],
            f"{area:.3g}",
            " x ".join(f"{length:.3g}" for length in size),
            " / ".join(f"{value:.2g}" for value in sigma.values()),
            f"{figures['concluded']:.0%}",
            f"{figures['seen_by_one']:.0%}",
            f"{figures['by_plane_sweep']:.0%}",
        ],
    ]
    looks = [_picture(looked_at(built.mesh, built.mesh.colours, bearing, ELEVATION_DEG), f"{bearing} degrees")
             for bearing in (235, 55)]  # fmt: skip
    note = Markup(
        'From two sides, what faces away left out. <a href="scene.html">scene.html</a> is the scene to be turned by '
        f"hand; turntable.mp4 goes all round in {FRAMES} pictures. Of the surface {figures['concluded']:.0%} was "
        "concluded from what lies around it, and seen by nobody; standard deviations in the table are of the rest."
    )
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
    looks = [
        _picture(looked_at(mesh, colours, 270.0, TOP_DEG), words)
        for colours, words in zip((by_sigma(mesh), by_views(mesh)), _legends(metres), strict=True)
    ]
    note = "From above. White: nothing is known. Standard deviations are those of independent views with exact poses."
    return Section("certainty", "How sure, and what was seen", note, [], looks)


def _legends(metres: bool) -> tuple[str, str]:
    """What the colours by sigma and by views mean."""
    best, worst = (f"{1e3 * end:g} mm" if metres else f"{100 * end / DISTANCE_M:.1f} %" for end in (BEST_M, WORST_M))
    of = "" if metres else " of the distance to the cameras"
    return (
        f"standard deviation, {best} (dark) to {worst} (bright){of}",
        f"views that saw it, 1 (dark) to {MOST_VIEWS} and more (bright); grey: concluded from what lies around it",
    )


def _picture(image: NDArray[np.uint8], words: str) -> Markup:
    """A picture (height, width, 3) red green blue inside the page."""
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
    text = _base64(data.tobytes())
    style = "max-width:100%"
    return Markup('<img alt="{0}" style="{1}" src="data:image/jpeg;base64,{2}"><figcaption>{0}</figcaption>').format(
        escape(words), style, text
    )
