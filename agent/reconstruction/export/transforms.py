"""Views as nerfstudio's transforms.json, with pictures, depths and the surface's points beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from agent.reconstruction.export.encoded import write_picture
from agent.reconstruction.export.pinhole import names, pinhole
from agent.reconstruction.export.ply import write_ply
from agent.reconstruction.extract import Mesh
from agent.reconstruction.view import View

DEPTH_UNIT_M = 1e-4  # of the 16-bit depth pictures, which so reach 6.5 m; 0: unknown
TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # theirs look along -z, y up


def write_transforms(views: list[View], mesh: Mesh, folder: Path) -> None:
    """The folder is made."""
    for name in ("images", "depths"):
        (folder / name).mkdir(parents=True)
    frames = []
    for view, name in zip(views, names(views), strict=True):
        write_picture(view.picture, folder / "images" / f"{name}.png")
        from_centre = np.nan_to_num((view.depth_m - view.camera.ahead_m) / DEPTH_UNIT_M)
        cv2.imwrite(str(folder / "depths" / f"{name}.png"), np.clip(np.rint(from_centre), 0, 65535).astype(np.uint16))
        frames.append({"file_path": f"images/{name}.png", "depth_file_path": f"depths/{name}.png", **frame(view)})
    write_ply(mesh, folder / "points.ply")
    top = {"camera_model": "OPENCV", "depth_unit_scale_factor": DEPTH_UNIT_M, "ply_file_path": "points.ply"}
    (folder / "transforms.json").write_text(json.dumps({**top, "frames": frames}, indent=1) + "\n", encoding="utf-8")


def frame(view: View) -> dict[str, Any]:
    """Camera and pose of one view, each with its own intrinsics."""
    p = pinhole(view)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = p.rotation, p.centre_m
    lens = {"fl_x": p.f_px, "fl_y": p.f_px, "cx": p.cx_px, "cy": p.cy_px, "w": p.width, "h": p.height}
    return {**lens, "k1": p.k1, "k2": 0.0, "p1": 0.0, "p2": 0.0, "transform_matrix": (pose @ TO_OPENGL).tolist()}
