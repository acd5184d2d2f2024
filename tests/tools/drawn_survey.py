"""A corner of a tank full of tags that somebody films: tags and corners drawn about where they should be."""

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from agent.capabilities.swim.landmarks import axes
from agent.core.config import Landmarks, Tag, Tank
from agent.core.step_io import SeenTag
from agent.tools.tag_bundle import SurveyFrame

TANK = Tank(size_m=(1.5, 1.2, 0.6), surface_m=0.5)
F_PX, SIZE_PX = 900.0, (640, 480)
SIDE_M = 0.08
SIGMA_M, SIGMA_DEG, SIZE_SPREAD = 0.0005, 0.1, 0.0006
SQUARE = np.array([(-1, 1, 0), (1, 1, 0), (1, -1, 0), (-1, -1, 0)]) * SIDE_M / 2


class Truth(NamedTuple):
    middle_m: np.ndarray  # (n, 3)
    rotation: np.ndarray  # (n, 3, 3) columns right, up, out
    size: np.ndarray  # (n,) of the nominal one


def listed() -> Landmarks:
    """What was wanted: tags on two walls and on the floor between them."""
    at = np.arange(0.15, 1.1, 0.24)
    places = [("y0", (x, 0.0, 0.2)) for x in at] + [("x0", (0.0, y, 0.2)) for y in at[:3]]
    places += [("floor", (x, y, 0.0)) for x in at[:4] for y in at[:3]]
    tags = [
        Tag(id=k, face=face, position_m=tuple(map(float, p)), turn_deg=20.0 * (k % 4))
        for k, (face, p) in enumerate(places)
    ]
    return Landmarks(size_m=SIDE_M, sigma_m=SIGMA_M, sigma_deg=SIGMA_DEG, tag=tuple(tags))


def drawn(rng, landmarks: Landmarks) -> Truth:
    """Where they are, each number as wrong as a survey states."""
    n = len(landmarks.tag)
    nominal = np.array([np.column_stack([*axes(tag), np.cross(*axes(tag))]) for tag in landmarks.tag])
    middles = np.array([tag.position_m for tag in landmarks.tag])
    turned = Rotation.from_rotvec(np.radians(rng.normal(0, SIGMA_DEG, (n, 3)))).as_matrix()
    return Truth(middles + rng.normal(0, SIGMA_M, (n, 3)), turned @ nominal, 1 + rng.normal(0, SIZE_SPREAD, n))


def film(rng, truth: Truth, frames: int) -> list[SurveyFrame]:
    """Somebody swims along with the camera, looking into the corner."""
    out = []
    while len(out) < frames:
        eye = rng.uniform((0.5, 0.4, 0.25), (1.1, 0.9, 0.48))
        ahead = rng.uniform((0.0, 0.0, 0.0), (0.9, 0.6, 0.25)) - eye
        out.append(SurveyFrame(F_PX, SIZE_PX[0], seen(rng, truth, eye, ahead)))
        if len(out[-1].tags) < 2:
            out.pop()
    return out


SMALL_PX, FOUND_PX = 30.0, 0.4  # sides below which a tag's edges cannot be fitted; its corners then scatter by that
LEAST_PX = 14.0  # smaller ones are not found


def basin_film(rng, truth: Truth, ids: tuple[int, ...], frames: int) -> list[SurveyFrame]:
    """A camera is taken about a basin of 3 x 2 m and looks everywhere: most of what it sees is far away."""
    out = []
    while len(out) < frames:
        eye = rng.uniform((0.6, 0.6, 0.25), (2.4, 1.4, 0.42))
        yaw, tilt = np.radians(rng.uniform((-180.0, -50.0), (180.0, 0.0)))
        ahead = np.array([np.cos(yaw) * np.cos(tilt), np.sin(yaw) * np.cos(tilt), np.sin(tilt)])
        tags = tuple(
            replace(as_found(rng, tag), id=ids[tag.id])
            for tag in seen(rng, truth, eye, ahead)
            if tag.size_px > LEAST_PX
        )
        if len(tags) > 1:
            out.append(SurveyFrame(F_PX, SIZE_PX[0], tags))
    return out


def as_found(rng, tag: SeenTag) -> SeenTag:
    if tag.size_px > SMALL_PX:
        return tag
    noisy = np.array(tag.corners) + rng.normal(0, FOUND_PX / F_PX, (4, 2))
    return replace(tag, edges=False, corners=tuple(map(tuple, noisy.tolist())))


def seen(rng, truth: Truth, eye, ahead) -> tuple[SeenTag, ...]:
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, (0, 0, 1)) / np.linalg.norm(np.cross(ahead, (0, 0, 1)))
    turn = np.stack([right, np.cross(ahead, right), ahead])
    turn = Rotation.from_rotvec((0, 0, rng.normal(0, 0.1))).as_matrix() @ turn
    tags = []
    for k, (middle, rotation, size) in enumerate(zip(*truth, strict=True)):
        point = (middle + size * SQUARE @ rotation.T - eye) @ turn.T
        facing = rotation[:, 2] @ (eye - middle) / np.linalg.norm(eye - middle)
        slopes = point[:, :2] / point[:, 2:]
        if point[:, 2].min() < 0.1 or facing < 0.3 or (np.abs(F_PX * slopes) > np.array(SIZE_PX) / 2 - 10).any():
            continue
        rho_px = F_PX * float(np.hypot(*slopes.mean(axis=0)))
        offset_px = 0.04 + 0.15 * (rho_px / (0.55 * SIZE_PX[0])) ** 3
        noise_px = rng.normal(0, 0.08, (4, 2)) + rng.normal(0, offset_px, 2)
        noisy = slopes + 0.0012 * rng.normal() * (slopes - slopes.mean(axis=0)) + noise_px / F_PX
        side_px = F_PX * float(np.hypot(*(np.roll(slopes, 1, axis=0) - slopes).T).min())
        tags.append(SeenTag(k, tuple(map(tuple, noisy.tolist())), side_px, rho_px, True))
    return tuple(tags)
