"""Views drawn in closed form: planes and balls with a texture that is a function of the place, seen by any camera."""

import numpy as np

from agent.reconstruction.views import Camera, View, diagonal_prior, pixel_grid, ray_slopes

CAMERA = Camera(220.0, 79.2, 60.4, 0.39, 0.004, 160, 120)


def looking_at(position: tuple[float, float, float], target: tuple[float, float, float]) -> np.ndarray:
    """(3, 3) camera to world; down is the world's -z as far as can be."""
    ahead = np.array(target, float) - position
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead], axis=1)


def texture(points: np.ndarray) -> np.ndarray:
    """Light (..., 3) of places (..., 3): waves of 6 to 60 mm in all directions."""
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(40, 3))
    directions *= (2 * np.pi / rng.uniform(0.012, 0.06, 40) / np.linalg.norm(directions, axis=1))[:, None]
    waves = np.cos(points @ directions.T + rng.uniform(0, 6, 40)) @ rng.normal(size=(40, 3))
    return 0.4 + 0.04 * waves


def plane_depth(camera: Camera, rotation: np.ndarray, position: np.ndarray, normal: np.ndarray, offset: float):
    """Depth (height, width) at which rays meet {p: normal p = offset}; NaN where they do not."""
    rays = np.concatenate([ray_slopes(camera, pixel_grid(camera)), np.ones((camera.height, camera.width, 1))], axis=-1)
    start = position + camera.ahead_m * rotation[:, 2]
    t = (offset - start @ normal) / (rays @ rotation.T @ normal)
    return np.where(t > 0, t + camera.ahead_m, np.nan)


def ball_depth(camera: Camera, rotation: np.ndarray, position: np.ndarray, centre: np.ndarray, radius: float):
    """The same of a ball."""
    rays = np.concatenate([ray_slopes(camera, pixel_grid(camera)), np.ones((camera.height, camera.width, 1))], axis=-1)
    rays = rays @ rotation.T
    start = position + camera.ahead_m * rotation[:, 2] - centre
    a, b, c = (rays**2).sum(-1), rays @ start, start @ start - radius**2
    root = b * b - a * c
    t = (-b - np.sqrt(np.where(root > 0, root, np.nan))) / a
    return np.where(t > 0, t + camera.ahead_m, np.nan)


def drawn_view(seq: int, position, target, depth_of, sigma_m: float = 2e-3, camera: Camera = CAMERA) -> View:
    """depth_of(camera, rotation, position) -> (height, width)."""
    rotation, place = looking_at(position, target), np.array(position, float)
    depth = depth_of(camera, rotation, place)
    x, y = np.moveaxis(ray_slopes(camera, pixel_grid(camera)), -1, 0)
    lengths = depth - camera.ahead_m
    points = np.stack([x * lengths, y * lengths, depth], axis=-1) @ rotation.T + place
    picture = np.where(np.isfinite(depth)[..., None], texture(np.nan_to_num(points)), 0.0)
    return View(
        "r1", "a", seq, camera, rotation, place, diagonal_prior(1e-4, 1e-4), picture.astype(np.float32),
        depth.astype(np.float32), np.where(np.isfinite(depth), sigma_m, np.nan).astype(np.float32),
    )  # fmt: skip
