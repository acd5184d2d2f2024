"""A surface as GLB, which browsers and office programs show."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from agent.process.command import Failed
from agent.reconstruction.export.encoded import encoded
from agent.reconstruction.extract import Mesh


def write_glb(mesh: Mesh, path: Path) -> None:
    """Metres, y up as glTF wants it. Raises Failed where trimesh is not installed."""
    try:
        import trimesh
    except ImportError:
        raise Failed("GLB needs trimesh: pip install 'aucamp[reconstruct]', or choose another --export") from None
    y_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    body = trimesh.Trimesh(
        vertices=mesh.vertices_m @ y_up.T,
        faces=mesh.faces,
        vertex_normals=mesh.normals @ y_up.T,
        vertex_colors=encoded(mesh.colours),
        process=False,
    )
    body.export(str(path), file_type="glb")
