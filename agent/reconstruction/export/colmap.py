"""Views and points as a sparse model of COLMAP, in its text form: images/ and sparse/0/ with three files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agent.reconstruction.export.encoded import encoded, write_picture
from agent.reconstruction.export.pinhole import names, pinhole, quaternion
from agent.reconstruction.extract import Mesh
from agent.reconstruction.view import View

MOST_POINTS = 100_000  # of the surface, which is enough for any program to start from


def write_colmap(views: list[View], mesh: Mesh, folder: Path) -> None:
    """The folder is made; camera n belongs to image n, for each robot has its own lens at its own position."""
    sparse, images = folder / "sparse" / "0", folder / "images"
    for one in (sparse, images):
        one.mkdir(parents=True)
    cameras, poses = [], []
    for n, (view, name) in enumerate(zip(views, names(views), strict=True), start=1):
        write_picture(view.picture, images / f"{name}.png")
        p = pinhole(view)
        cameras.append(f"{n} SIMPLE_RADIAL {p.width} {p.height} {_text([p.f_px, p.cx_px, p.cy_px, p.k1])}")
        to_camera = p.rotation.T
        pose = [*quaternion(to_camera).tolist(), *(-to_camera @ p.centre_m).tolist()]
        poses.append(f"{n} {_text(pose)} {n} {name}.png\n")  # the line of its points is empty
    step = max(1, -(-len(mesh.vertices_m) // MOST_POINTS))
    colours = encoded(mesh.colours)
    points = [
        f"{n} {_text(mesh.vertices_m[m].tolist())} {' '.join(str(c) for c in colours[m])} 0"
        for n, m in enumerate(range(0, len(mesh.vertices_m), step), start=1)
    ]
    for file, lines in (("cameras.txt", cameras), ("images.txt", poses), ("points3D.txt", points)):
        (sparse / file).write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def _text(numbers: list[float]) -> str:
    return " ".join(np.format_float_positional(number, trim="0") for number in numbers)
