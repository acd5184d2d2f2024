"""Pictures of printed tags with known corners, drawn by nothing that is under test, from the published table of codes.

A tag's own frame: x to the right and y down on the paper, metres from its middle, z into the paper.
"""

from __future__ import annotations

import numpy as np

from agent.core.ranging.camera_model import CameraFit
from tests.perception.painted import defocus

SIZE_M = 0.08  # black edge to black edge
BLACK, PAPER, WALL = 0.03, 0.70, 0.30  # of the light that a perfect white would give

# tag36h11.c of AprilRobotics/apriltag: codes by id, and the module (x, y) of each bit from the highest on. The border
# is module 0 and 7; a set bit is white.
CODES = {0: 0xD7E00984B, 1: 0xDDA664CA7, 2: 0xDC4A1C821, 3: 0xE17B470E9, 4: 0xEF91D01B1, 586: 0xE8B772FE0}
BIT_X = (1, 2, 3, 4, 5, 2, 3, 4, 3, 6, 6, 6, 6, 6, 5, 5, 5, 4, 6, 5, 4, 3, 2, 5, 4, 3, 4, 1, 1, 1, 1, 1, 2, 2, 2, 3)
BIT_Y = (1, 1, 1, 1, 1, 2, 2, 2, 3, 1, 2, 3, 4, 5, 2, 3, 4, 3, 6, 6, 6, 6, 6, 5, 5, 5, 4, 6, 5, 4, 3, 2, 5, 4, 3, 4)
SAMPLES = 4  # a side of a pixel, each row and column shifted against the next: an upright edge meets 16 places


def modules(number: int) -> np.ndarray:
    """(10, 10) as printed, upright, the white margin included; 1 is white."""
    grid = np.zeros((10, 10))
    grid[0], grid[-1], grid[:, 0], grid[:, -1] = 1, 1, 1, 1
    for bit, (x, y) in enumerate(zip(BIT_X, BIT_Y, strict=True)):
        grid[y + 1, x + 1] = CODES[number] >> (35 - bit) & 1
    return grid


def turned(yaw_deg: float, pitch_deg: float, roll_deg: float) -> np.ndarray:
    """Rotation tag -> camera: about the camera's y, x and z; at zero the tag is seen upright, from in front."""
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(a), np.sin(a)) for a in np.radians((yaw_deg, pitch_deg, roll_deg)))
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return about_y @ about_x @ about_z


def corner_slopes(rotation: np.ndarray, middle_m: tuple[float, float, float], grown: float = 1.0) -> np.ndarray:
    """(4, 2), clockwise from the upper left of the upright tag; the camera's rays meet at z = 0."""
    square = grown * SIZE_M / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    places = square @ rotation.T + middle_m
    return places[:, :2] / places[:, 2:]


def bend(camera: CameraFit, slopes: np.ndarray) -> np.ndarray:
    """Slopes -> pixels."""
    straight = camera.f_px * slopes
    return straight * (1 + camera.bend * (slopes**2).sum(-1, keepdims=True)) + (camera.cx_px, camera.cy_px)


def tag_light(
    camera: CameraFit, number: int, rotation: np.ndarray, middle_m: tuple[float, float, float], light: np.ndarray
) -> None:
    """Lay a tag over a picture of linear light (height, width), in place; each pixel the mean of its samples."""
    paper = bend(camera, corner_slopes(rotation, middle_m, 10 / 8))
    low = np.clip(np.floor(paper.min(axis=0)), 0, (light.shape[1], light.shape[0])).astype(int)
    high = np.clip(np.ceil(paper.max(axis=0)) + 1, 0, (light.shape[1], light.shape[0])).astype(int)
    j, i = np.mgrid[: (high[1] - low[1]) * SAMPLES, : (high[0] - low[0]) * SAMPLES]
    x = low[0] - 0.5 + (i + (j % SAMPLES + 0.5) / SAMPLES) / SAMPLES
    y = low[1] - 0.5 + (j + (i % SAMPLES + 0.5) / SAMPLES) / SAMPLES
    slopes = straighten(camera, (np.stack([x, y], axis=-1) - (camera.cx_px, camera.cy_px)) / camera.f_px)
    rays = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1) @ rotation  # in the tag's frame
    eye = -rotation.T @ middle_m
    on_paper = eye[:2] - rays[..., :2] * (eye[2] / rays[..., 2:])
    at = np.floor(on_paper / (SIZE_M / 8) + 5).astype(int)
    inside = ((at >= 0) & (at < 10)).all(axis=-1)
    at = np.clip(at, 0, 9)
    white = modules(number)[at[..., 1], at[..., 0]]
    part = light[low[1] : high[1], low[0] : high[0]]
    wall = np.repeat(np.repeat(part, SAMPLES, axis=0), SAMPLES, axis=1)
    drawn = np.where(inside, BLACK + (PAPER - BLACK) * white, wall)
    part[:] = drawn.reshape(part.shape[0], SAMPLES, part.shape[1], SAMPLES).mean(axis=(1, 3))


def straighten(camera: CameraFit, seen: np.ndarray) -> np.ndarray:
    """Newton's way from bent to straight slopes, along the radius."""
    radius = np.sqrt((seen**2).sum(-1, keepdims=True)) + 1e-12
    r = radius
    for _ in range(4):
        r = r - (r + camera.bend * r**3 - radius) / (1 + 3 * camera.bend * r**2)
    return seen * (r / radius)


def photograph(
    light: np.ndarray, blur_px: float = 0.0, noise: float = 0.0, gamma: float = 2.2, seed: int = 0
) -> np.ndarray:
    """Linear light (height, width) -> 8 bits, three equal colours: blur over a disc of that diameter, noise, gamma.

    noise: standard deviation at full light; shot noise, and a fifth of it at the least.
    """
    rng = np.random.default_rng(seed)
    blurred = defocus(light, blur_px)
    noisy = blurred + noise * rng.normal(size=light.shape) * np.sqrt(np.maximum(blurred, 0) + 0.04)
    return np.repeat(np.round(255 * np.clip(noisy, 0, 1) ** (1 / gamma)).astype(np.uint8)[..., None], 3, axis=-1)
