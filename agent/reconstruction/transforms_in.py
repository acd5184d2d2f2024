"""Pictures that others took: a folder in nerfstudio's layout -> views without depths of their own.

Nothing there says how far anything is. A view gets a depth range instead, as a prior as wide as the scene: the plane
sweep then looks all along the line of sight. Scenes have any unit and any size.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from agent.core.config import ConfigError
from agent.process.command import Show
from agent.reconstruction.camera import Camera, Floats
from agent.reconstruction.composite import linear, shrunk_frame
from agent.reconstruction.keyframe import reduction
from agent.reconstruction.view import View, diagonal_prior

TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
GAMMA = 2.2
LENS = ("k1", "k2", "k3", "k4", "p1", "p2")


def transforms_views(path: Path, show: Show) -> list[View]:
    """Views of a transforms.json, or of the folder that has one. Raises ConfigError with one line."""
    file = path / "transforms.json" if path.is_dir() else path
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        frames = list(data["frames"])
    except (OSError, ValueError, KeyError, TypeError):
        raise ConfigError(f"{file}: no transforms.json; give a folder in nerfstudio's layout, or its file") from None
    views = []
    for n, frame in enumerate(frames):
        show(n, len(frames), "reading pictures")
        views.append(_view(file, data, frame, n))
    return views


def _view(file: Path, data: dict[str, Any], frame: dict[str, Any], n: int) -> View:
    try:
        name = frame["file_path"]
        pose = np.array(frame["transform_matrix"], float).reshape(4, 4) @ TO_OPENCV
    except (KeyError, TypeError, ValueError):
        raise ConfigError(f"{file}: frame {n} has no file_path or no transform_matrix of 4 x 4") from None
    image = _image(file.parent / name)
    height, width = image.shape[:2]
    f, camera, image = _pinhole(file, {**data, **frame}, image, n)
    times = reduction(width)
    small = shrunk_frame(image, 1.0, (0.0, 0.0), times, GAMMA) if times > 1 else linear(image, GAMMA)
    half = (times - 1) / 2.0
    intrinsics = Camera(
        f / times, (camera[0] - half) / times, (camera[1] - half) / times, 0.0, 0.0, width // times, height // times
    )
    rotation: Floats = pose[:3, :3] / np.cbrt(np.linalg.det(pose[:3, :3]))
    unknown = np.full(small.shape[:2], np.nan, np.float32)
    return View(
        "pictures", "", n, intrinsics, rotation, pose[:3, 3], diagonal_prior(1e-3, 1e-3), small, unknown, unknown
    )


def _image(path: Path) -> np.ndarray:
    found = [path, *(path.with_name(path.name + ending) for ending in (".png", ".jpg", ".jpeg"))]
    there = next((one for one in found if one.is_file()), None)
    image = None if there is None else cv2.imread(str(there), cv2.IMREAD_COLOR)
    if image is None:
        raise ConfigError(f"{path}: no such picture, or none that can be read")
    return np.asarray(image, np.uint8)


def _pinhole(
    file: Path, about: dict[str, Any], image: np.ndarray, n: int
) -> tuple[float, tuple[float, float], np.ndarray]:
    """Focal length and centre of the picture as a straight pinhole would have taken it, and that picture."""
    height, width = image.shape[:2]
    try:
        narrow = "fl_x" not in about
        fx: float = 0.5 * width / math.tan(0.5 * float(about["camera_angle_x"])) if narrow else float(about["fl_x"])
        fy = float(about.get("fl_y", fx))
        cx, cy = float(about.get("cx", width / 2.0)) - 0.5, float(about.get("cy", height / 2.0)) - 0.5
        k1, k2, k3, _, p1, p2 = (float(about.get(name) or 0.0) for name in LENS)
    except (KeyError, TypeError, ValueError):
        raise ConfigError(f"{file}: frame {n} has no fl_x and no camera_angle_x") from None
    scale = width / float(about.get("w") or width)  # a folder of smaller copies has the intrinsics of the large ones
    fx, fy, cx, cy = fx * scale, fy * scale, (cx + 0.5) * scale - 0.5, (cy + 0.5) * scale - 0.5
    straight = not any((k1, k2, k3, p1, p2)) and fx == fy
    if not straight:
        lens = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        flat = np.array([[fx, 0.0, cx], [0.0, fx, cy], [0.0, 0.0, 1.0]])
        image = np.asarray(cv2.undistort(image, lens, np.array([k1, k2, p1, p2, k3]), None, flat), np.uint8)
    return fx, (cx, cy), image
