"""A surface as PLY (binary, little endian), which every viewer of meshes reads; with sigma_m and views a vertex."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.export.encoded import encoded
from agent.reconstruction.extract import Mesh

FORMATS = {"f4": "float", "u1": "uchar"}


def write_ply(mesh: Mesh, path: Path) -> None:
    """World frame, metres, z up."""
    vertices = np.empty(
        len(mesh.vertices_m),
        [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
        + [(name, "u1") for name in ("red", "green", "blue")]
        + [("sigma_m", "<f4"), ("views", "u1")],
    )
    for n, axis in enumerate("xyz"):
        vertices[axis], vertices[f"n{axis}"] = mesh.vertices_m[:, n], mesh.normals[:, n]
    for n, colour in enumerate(("red", "green", "blue")):
        vertices[colour] = encoded(mesh.colours)[:, n]
    vertices["sigma_m"], vertices["views"] = mesh.sigma_m, mesh.views
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", (3,))])
    faces["count"], faces["corners"] = 3, mesh.faces
    ending = [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    write_elements(path, vertices, ending, faces)


def write_elements(
    path: Path, vertices: NDArray[np.void], ending: list[str], rest: NDArray[np.void] | None = None
) -> None:
    """A PLY file whose vertices have the fields of a structured array, floats and bytes."""
    names = vertices.dtype.names or ()
    properties = [f"property {FORMATS[vertices.dtype[name].str[1:]]} {name}" for name in names]
    head = ["ply", "format binary_little_endian 1.0", "comment aucamp, metres, z up"]
    head += [f"element vertex {len(vertices)}", *properties, *ending, "end_header"]
    with path.open("wb") as file:
        file.write("\n".join(head).encode() + b"\n")
        vertices.tofile(file)
        if rest is not None:
            rest.tofile(file)
