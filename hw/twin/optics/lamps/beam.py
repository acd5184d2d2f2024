"""A lamp that burns, as a camera meets it: from where, where to, and what stands in its light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw.twin.optics.view import LampBeam

Array = NDArray[np.float64]

INTENSITY_W_SR = 1.2  # on the axis, in each of three bands, at full power: some 1000 lm
HALF_RAD = math.radians(25.0)  # in water; even to 0.8 of it, nothing beyond 1.2
EDGE_RAD = 1.2 * HALF_RAD
COSINES = 2048


class Beams(NamedTuple):
    """All lamps in the terms of one camera, float32."""

    place: NDArray[np.float32]  # (n, 3) camera frame
    aim: NDArray[np.float32]  # (n, 3)
    power: NDArray[np.float32]  # (n,) W/sr on the axis
    first: NDArray[
        np.int64
    ]  # (n + 1,) of `bodies`: those that may throw a shadow in lamp k's light are from first[k] on
    bodies: NDArray[np.int64]  # rows of `maps`
    origins: NDArray[np.float32]  # (rows of `bodies`, 3) the lamp, as that body's map has it
    maps: NDArray[np.float32]  # (e, 3, 4) camera to the unit sphere, or cube, of each body
    cubes: NDArray[np.int64]  # (e,)


def beam_table() -> NDArray[np.float32]:
    """(COSINES,) share of the intensity on the axis, by the cosine off it from cos(EDGE_RAD) to 1."""
    angle = np.arccos(np.linspace(math.cos(EDGE_RAD), 1.0, COSINES))
    t = np.clip((1.2 - angle / HALF_RAD) / 0.4, 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)


def make_beams(
    lamps: Sequence[LampBeam], camera: Array, bodies: Sequence[tuple[Array, float]], maps: Array, cubes: ArrayLike
) -> Beams:
    """`camera` (3, 4) to world; `bodies`: centre (3,), world, and radius around it of each row of `maps` (e, 3, 4)."""
    rotation, eye_m = camera[:, :3], camera[:, 3]
    first, found, origins = [0], list[int](), list[Array]()
    for lamp in lamps:
        place_m, aim = np.asarray(lamp.position_m, float), np.asarray(lamp.aim, float)
        local = rotation.T @ (place_m - eye_m)
        for e, (centre_m, radius_m) in enumerate(bodies):
            to_body = centre_m - place_m
            range_m = float(np.linalg.norm(to_body))
            unit = maps[e, :, :3] @ local + maps[e, :, 3]
            if np.abs(unit).max() < 1 if np.asarray(cubes)[e] else unit @ unit < 1:
                continue  # its own housing, or hull
            off = math.acos(min(max(float(to_body @ aim) / max(range_m, 1e-9), -1.0), 1.0))
            if range_m <= radius_m or off <= EDGE_RAD + math.asin(min(radius_m / range_m, 1.0)):
                found.append(e)
                origins.append(unit)
        first.append(len(found))
    places = np.array([rotation.T @ (np.asarray(lamp.position_m, float) - eye_m) for lamp in lamps])
    aims = np.array([rotation.T @ np.asarray(lamp.aim, float) for lamp in lamps])
    return Beams(
        place=places.astype(np.float32).reshape(-1, 3),
        aim=aims.astype(np.float32).reshape(-1, 3),
        power=np.array([INTENSITY_W_SR * lamp.power for lamp in lamps], np.float32),
        first=np.array(first),
        bodies=np.array(found, np.int64),
        origins=np.array(origins, np.float32).reshape(-1, 3),
        maps=np.asarray(maps, np.float32),
        cubes=np.asarray(cubes, np.int64),
    )
