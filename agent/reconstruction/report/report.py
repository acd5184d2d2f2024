"""The page of a reconstruction: what came of it, views beside photographs that were held back, how sure what is."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import jinja2
import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from agent.process.command import Show
from agent.reconstruction.build import Built
from agent.reconstruction.export.encoded import encoded
from agent.reconstruction.image.judged import HeldBack
from agent.reconstruction.report.beside import Beside, beside, render_of
from agent.reconstruction.report.looks import (
    BEST_M,
    ELEVATION_DEG,
    FRAMES,
    MOST_VIEWS,
    WORST_M,
    by_sigma,
    by_views,
    looked_at,
    write_turntable,
)
from agent.reconstruction.view import View
from replay.report.page_template import PAGE

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

    placed: what an image model makes of `held`, in the same order; empty where there is none.
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
        _certainty(built),
    ]
    files = [out / "report.html"]
    if video:
        files.append(out / "turntable.mp4")
        write_turntable(built.mesh, files[1], lambda done, total: show(done, total, "turntable"))
    page = jinja2.Environment(autoescape=True).from_string(PAGE)
    robots = ", ".join(figures["robots"])
    about = f"{figures['views']} keyframes of {robots}; {figures['held_back']} more held back."
    text = page.render(title="Reconstruction", verdict="", reasons=[], about=about, sections=sections)
    files[0].write_text(text, encoding="utf-8")
    return files


def _surface(built: Built, figures: dict[str, Any]) -> Section:
    sigma = figures["sigma_mm"]
    rows = [
        ["triangles", "area m2", "size m", "sigma mm, 10/50/90 %", "seen by one view", "depths by plane sweep"],
        [
            figures["triangles"],
            f"{figures['area_m2']:.2f}",
            " x ".join(f"{length:.2f}" for length in figures["size_m"]),
            " / ".join(f"{value:.1f}" for value in sigma.values()),
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
    """No section where there is no image model, or no photograph to hold it against."""
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


def _certainty(built: Built) -> Section:
    mesh = built.mesh
    looks = [
        _picture(looked_at(mesh, colours, 270.0, TOP_DEG), words)
        for colours, words in (
            (by_sigma(mesh), f"standard deviation, {1e3 * BEST_M:g} mm (dark) to {1e3 * WORST_M:g} mm (bright)"),
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
