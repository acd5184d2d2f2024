"""A surface as seen from where no robot was: from above, and once round it; by its colours or by how sure it is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from numpy.typing import NDArray

from agent.process.command import Failed, Progress
from agent.reconstruction.camera import Camera, Floats
from agent.reconstruction.export.encoded import encoded
from agent.reconstruction.extract import Mesh
from agent.reconstruction.raster import rendered

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
    """(height, width, 3) red green blue; only what faces the eye, so that one looks through walls into a tank."""
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
    """A film once round the scene. Raises Failed where it cannot be written."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), FPS, (WIDTH, HEIGHT))
    if not writer.isOpened():
        raise Failed(f"{path}: a film cannot be written there; give --out another place, or --no-video")
    try:
        for done, image in enumerate(_round(mesh), start=1):
            writer.write(image[..., ::-1])
            progress(done, FRAMES)
    finally:
        writer.release()


def _round(mesh: Mesh) -> Iterator[NDArray[np.uint8]]:
    for n in range(FRAMES):
        yield looked_at(mesh, mesh.colours, 360.0 * n / FRAMES, ELEVATION_DEG)


def _normals(mesh: Mesh) -> Floats:
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _mapped(name: str, share: NDArray[np.floating]) -> NDArray[np.float32]:
    shown = matplotlib.colormaps[name](share)[:, :3]
    return np.asarray(shown**2.2, np.float32)  # linear light, which is encoded again
