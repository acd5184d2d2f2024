"""A textured floor as a camera above it sees it, with known slopes: drawn by nothing that is under test."""

from __future__ import annotations

import cv2
import numpy as np

from agent.core.ranging.camera_model import CameraFit
from tests.perception.painted import grain
from tests.perception.printed import straighten

PX_PER_M = 900.0
DOWN = np.radians(50.0)  # the optical axis below the horizon
# Camera x right, y down, z ahead; floor frame x ahead, y left, z up.
LOOK = np.array([[0.0, -np.sin(DOWN), np.cos(DOWN)], [-1.0, 0.0, 0.0], [0.0, -np.cos(DOWN), -np.sin(DOWN)]])


def texture(side: int = 1800) -> np.ndarray:
    """Linear light of the floor, x along rows."""
    return (0.35 + 0.25 * grain((side, side), 11)).astype(np.float32)


def pose(x_m: float, y_m: float, yaw_deg: float, height_m: float = 0.45) -> tuple[np.ndarray, np.ndarray]:
    """Rotation camera -> floor, and the camera's place over it."""
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ LOOK, np.array([x_m, y_m, height_m])


def frame(floor: np.ndarray, camera: CameraFit, rotation: np.ndarray, place_m: np.ndarray, seed: int) -> np.ndarray:
    """(height, width, 3), with noise and gamma."""
    v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    seen = np.stack([u - camera.cx_px, v - camera.cy_px], axis=-1) / camera.f_px
    slopes = straighten(camera, seen)
    on_floor = meet(slopes, rotation, place_m)
    at = (PX_PER_M * on_floor + len(floor) / 2).astype(np.float32)
    light = cv2.remap(floor, at[..., 1], at[..., 0], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    noisy = light + 0.015 * np.random.default_rng(seed).normal(size=light.shape) * np.sqrt(light + 0.04)
    return np.repeat(np.round(255 * np.clip(noisy, 0, 1) ** (1 / 2.2)).astype(np.uint8)[..., None], 3, axis=-1)


def meet(slopes: np.ndarray, rotation: np.ndarray, place_m: np.ndarray) -> np.ndarray:
    """(..., 2) slopes -> (..., 2) points of the floor."""
    rays = np.concatenate([slopes, np.ones((*slopes.shape[:-1], 1))], axis=-1) @ rotation.T
    return place_m[:2] - rays[..., :2] * (place_m[2] / rays[..., 2:])


def seen_from(points_m: np.ndarray, rotation: np.ndarray, place_m: np.ndarray) -> np.ndarray:
    """(..., 2) points of the floor -> (..., 2) slopes."""
    there = (np.concatenate([points_m, np.zeros((*points_m.shape[:-1], 1))], axis=-1) - place_m) @ rotation
    return there[..., :2] / there[..., 2:]
