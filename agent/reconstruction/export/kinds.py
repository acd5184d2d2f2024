"""What `--export` can be, and which files it gives."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from agent.reconstruction.export.colmap import write_colmap
from agent.reconstruction.export.glb import write_glb
from agent.reconstruction.export.mcap import write_mcap
from agent.reconstruction.export.ply import write_ply
from agent.reconstruction.export.splat import write_splat
from agent.reconstruction.export.transforms import write_transforms
from agent.reconstruction.extract import Mesh
from agent.reconstruction.view import View

Kind = Literal["ply", "glb", "colmap", "transforms.json", "splat", "mcap"]


def export(kind: Kind, views: list[View], mesh: Mesh, cell_m: float, folder: Path) -> Path:
    """Write into the folder, which is there; what was written. Raises Failed where a package is missing."""
    match kind:
        case "ply":
            write_ply(mesh, path := folder / "surface.ply")
        case "glb":
            write_glb(mesh, path := folder / "surface.glb")
        case "splat":
            write_splat(mesh, cell_m, path := folder / "splat.ply")
        case "mcap":
            write_mcap(views, mesh, path := folder / "scene.mcap")
        case "colmap":
            write_colmap(views, mesh, path := folder / "colmap")
        case "transforms.json":
            write_transforms(views, mesh, path := folder / "nerfstudio")
    return path
