"""Test pictures with known truth, drawn by nothing that is under test: a ball and a board behind a thin lens."""

from __future__ import annotations

import cv2
import numpy as np

from agent.core.ranging.camera_model import CameraFit

CAMERA = CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5)
PX_PER_POSITION = 0.021  # blur diameter per lens position away from the sharp one
POLE, PER_DIOPTRE = 102.0, 102.0  # lens position at infinity; positions per 1/m of vergence, n/u


def sharp_position(u_m: float) -> float:
    return POLE + PER_DIOPTRE * 1.333 / u_m


def rays(camera: CameraFit = CAMERA) -> np.ndarray:
    """(height, width, 3), z = 1."""
    v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    return np.stack([(u - camera.cx_px) / camera.f_px, (v - camera.cy_px) / camera.f_px, np.ones_like(u)], axis=-1)


def grain(shape: tuple[int, int], seed: int) -> np.ndarray:
    """Texture with detail at several scales, about -1 to 1."""
    rng = np.random.default_rng(seed)
    out = np.zeros(shape)
    for size, weight in ((1.0, 0.5), (3.0, 0.6), (12.0, 1.0)):
        field = cv2.GaussianBlur(rng.normal(0, 1, shape), (0, 0), size)
        out += weight * field / field.std()
    return np.clip(out / 2.5, -1, 1)


def defocus(light: np.ndarray, diameter_px: float) -> np.ndarray:
    """Mean over a disc, each pixel of the kernel weighted by its area (16 x 16 points a pixel)."""
    if diameter_px < 0.1:
        return light
    half = int(np.ceil(diameter_px / 2 + 0.5))
    fine = (np.arange((2 * half + 1) * 16) + 0.5) / 16 - half - 0.5
    disc = (fine[:, None] ** 2 + fine[None, :] ** 2 <= diameter_px**2 / 4).astype(float)
    kernel = disc.reshape(2 * half + 1, 16, 2 * half + 1, 16).sum(axis=(1, 3))
    return cv2.filter2D(light, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT_101)


def expose(light: np.ndarray, seed: int) -> np.ndarray:
    """Linear light -> 8 bit, gamma 2.2, with shot and read noise."""
    rng = np.random.default_rng(seed)
    noisy = light + rng.normal(0, 1, light.shape) * np.sqrt(np.maximum(light, 0) / 4000 + 0.004**2)
    return (255 * np.clip(noisy, 0, 1) ** (1 / 2.2) + 0.5).astype(np.uint8)


def ball_light(centre_m: tuple[float, float, float], radius_m: float = 0.07, seed: int = 3) -> np.ndarray:
    """Linear light (480, 640, 3) of a mottled red ball before a grey wall; centre in the camera frame."""
    m = rays()
    c = np.asarray(centre_m)
    mm, mc = (m * m).sum(-1), (m * c).sum(-1)
    disc = mc**2 - mm * ((c * c).sum() - radius_m**2)
    hit = disc > 0
    n = (m * ((mc - np.sqrt(np.maximum(disc, 0))) / mm)[..., None] - c) / radius_m
    shade = 0.6 - 0.3 * n[..., 1]
    texture = grain(hit.shape, seed)
    red = np.stack([0.05 + 0.02 * texture, 0.05 + 0.02 * texture, 0.42 + 0.18 * texture], axis=-1) * shade[..., None]
    wall = np.repeat((0.30 + 0.08 * grain(hit.shape, seed + 1))[..., None], 3, axis=-1) * (1.05, 1.0, 0.95)
    return np.where(hit[..., None], red, wall)


def ball_frame(
    centre_m: tuple[float, float, float], blur_px: float = 0.0, seed: int = 3, radius_m: float = 0.07
) -> np.ndarray:
    return expose(defocus(ball_light(centre_m, radius_m, seed), blur_px), seed)
