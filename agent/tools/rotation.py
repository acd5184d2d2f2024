"""Small turns as vectors, and rotations: right-handed, rad."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def crossed(vectors: Array) -> Array:
    """(..., 3) -> (..., 3, 3) that multiplies another vector crosswise from the left."""
    out = np.zeros((*vectors.shape, 3))
    x, y, z = np.moveaxis(vectors, -1, 0)
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -z, y, -x
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = z, -y, x
    return out


def turn_of(vector: Array) -> Array:
    """(3,) rad -> the rotation (3, 3) about it (Rodrigues)."""
    angle = float(np.sqrt(vector @ vector))
    K = crossed(vector)
    if angle < 1e-9:
        return np.asarray(np.eye(3) + K, np.float64)
    out: Array = np.eye(3) + np.sin(angle) / angle * K + (1.0 - np.cos(angle)) / angle**2 * K @ K
    return out


def turned_by(rotation: Array) -> Array:
    """The inverse: (3, 3) -> (3,) rad, less than half a turn."""
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    sine, cosine = 0.5 * float(np.sqrt(axis @ axis)), 0.5 * float(np.trace(rotation) - 1.0)
    angle = float(np.arctan2(sine, cosine))
    out: Array = 0.5 * axis * (angle / sine if sine > 1e-9 else 1.0)
    return out
