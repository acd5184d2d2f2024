"""How well a survey's surface shows the floor of its basin, which is flat and at height 0, by the twin's own scene.

`aucamp demo --fleet survey --seed 13 --out DIVE`, `aucamp reconstruct DIVE --out SCENE`, and then
`python -m tests.studies.surveyed_floor SCENE/surface.ply` prints a line. What lies on the floor is left out.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from hw.twin.scene import Scene, load_scene

VERTEX = np.dtype([(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")] + [
    *((name, "u1") for name in ("red", "green", "blue")), ("sigma_m", "<f4"), ("views", "u1"),
])  # fmt: skip
HIGHEST_M = 0.06  # of what is still taken for the floor, above it or below
APART_M = 0.05  # from walls and from what lies there


def vertices(path: Path) -> NDArray[np.void]:
    """Of a surface.ply, as VERTEX. Raises ValueError for another layout."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode("ascii").splitlines()
    kept = lines[: next(n for n, line in enumerate(lines) if line.startswith("element face"))]
    names = tuple(line.split()[-1] for line in kept if line.startswith("property"))
    if "format binary_little_endian 1.0" not in lines or names != VERTEX.names:
        raise ValueError(f"{path}: is no surface.ply of aucamp reconstruct")
    count = next(int(line.split()[-1]) for line in lines if line.startswith("element vertex"))
    return np.frombuffer(body, VERTEX, count)


def on_floor(found: NDArray[np.void], scene: Scene, size_m: tuple[float, float, float]) -> NDArray[np.bool_]:
    """Vertices that show the floor, and nothing that lies on it."""
    kept = np.abs(found["z"]) < HIGHEST_M
    for axis, length_m in zip("xy", size_m, strict=False):
        kept &= (found[axis] > APART_M) & (found[axis] < length_m - APART_M)
    for solid in scene.solid:
        x_m, y_m, _ = solid.position_m
        reach_m = math.hypot(*solid.radii_m[:2]) if solid.kind == "box" else max(solid.radii_m)
        kept &= np.hypot(found["x"] - x_m, found["y"] - y_m) > reach_m + APART_M
    return np.asarray(kept, np.bool_)


def told(height_m: NDArray[np.float32], sigma_m: NDArray[np.float32]) -> str:
    height_mm, size_mm = 1e3 * height_m, 1e3 * np.abs(height_m)
    return (
        f"floor, {len(height_m)} vertices: {np.median(size_mm):.2f} mm off in the median, "
        f"{100 * np.mean(size_mm < 10.0):.1f} % within 10 mm, {height_mm.mean():+.2f} mm in the mean, "
        f"{math.sqrt(float(np.mean((height_m / sigma_m) ** 2))):.2f} times its standard deviation, rms"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("surface", type=Path, nargs="+")
    fleet = load_fleet(shipped_fleet("survey"))
    scene = load_scene(fleet.twin.scene)
    for path in parser.parse_args().surface:
        found = vertices(path)
        floor = found[on_floor(found, scene, fleet.tank.size_m)]
        seen = floor[np.isfinite(floor["sigma_m"]) & (floor["sigma_m"] > 0)]
        sys.stdout.write(f"{path}: {told(seen['z'], seen['sigma_m'])}\n")


if __name__ == "__main__":
    main()
