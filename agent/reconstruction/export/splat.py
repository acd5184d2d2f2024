"""A surface as the PLY of 3D Gaussian splatting: a flat, opaque Gaussian at each vertex, turned as the surface is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Floats
from agent.reconstruction.export.encoded import encoded
from agent.reconstruction.export.ply import write_elements
from agent.reconstruction.extract import Mesh

ACROSS, THICK = 0.55, 0.1  # standard deviations along and across the surface, cells
OPACITY = 0.97
BAND0 = 0.28209479177387814  # the constant spherical harmonic: colour = 0.5 + BAND0 f_dc


def write_splat(mesh: Mesh, cell_m: float, path: Path) -> None:
    """Degree 0: one colour from all sides. Quaternions are (w, x, y, z), scales logarithms of metres."""
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    splats = np.zeros(len(mesh.vertices_m), [(name, "<f4") for name in names])
    turn = from_z(mesh.normals.astype(float))
    for n, axis in enumerate("xyz"):
        splats[axis], splats[f"n{axis}"] = mesh.vertices_m[:, n], mesh.normals[:, n]
        splats[f"f_dc_{n}"] = (encoded(mesh.colours)[:, n] / 255.0 - 0.5) / BAND0
        splats[f"scale_{n}"] = np.log(cell_m * (ACROSS if n < 2 else THICK))
    for n in range(4):
        splats[f"rot_{n}"] = turn[:, n]
    splats["opacity"] = np.log(OPACITY / (1.0 - OPACITY))
    write_elements(path, splats, [])


def from_z(normals: NDArray[np.float64]) -> Floats:
    """Quaternions (n, 4) that turn z onto unit vectors (n, 3)."""
    turn = np.stack([1.0 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))], axis=1)
    turn[turn[:, 0] < 1e-9] = (0.0, 1.0, 0.0, 0.0)
    return np.asarray(turn / np.linalg.norm(turn, axis=1, keepdims=True))
