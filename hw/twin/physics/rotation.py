"""Rotations for the compiled kernels: vectors and quaternions are tuples, so that nothing is allocated.

A quaternion (w, x, y, z) turns body into world; R = Rz(yaw) Ry(pitch) Rx(roll), positive pitch is nose down.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hw.compiled import compiled

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

# Camera axes (right, down, forward) as columns in the gimbal frame (forward, left, up).
GIMBAL_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@compiled()
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled()
def to_world(q: Quaternion, v: Vector) -> Vector:
    """Body vector -> world: v + 2 w (r x v) + 2 r x (r x v) with r the vector part."""
    r = (q[1], q[2], q[3])
    t = cross(r, v)
    s = cross(r, t)
    return (
        v[0] + 2 * (q[0] * t[0] + s[0]),
        v[1] + 2 * (q[0] * t[1] + s[1]),
        v[2] + 2 * (q[0] * t[2] + s[2]),
    )


@compiled()
def to_body(q: Quaternion, v: Vector) -> Vector:
    return to_world((q[0], -q[1], -q[2], -q[3]), v)


@compiled()
def turned(q: Quaternion, w: Vector, dt_s: float) -> Quaternion:
    """The quaternion after dt_s at body rates w (rad/s), unit length again."""
    h = 0.5 * dt_s
    a = q[0] - h * (q[1] * w[0] + q[2] * w[1] + q[3] * w[2])
    b = q[1] + h * (q[0] * w[0] + q[2] * w[2] - q[3] * w[1])
    c = q[2] + h * (q[0] * w[1] + q[3] * w[0] - q[1] * w[2])
    d = q[3] + h * (q[0] * w[2] + q[1] * w[1] - q[2] * w[0])
    n = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    return a * n, b * n, c * n, d * n


def quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> NDArray[np.float64]:
    """(4,) quaternion of the Euler angles."""
    cr, sr = math.cos(roll_rad / 2), math.sin(roll_rad / 2)
    cp, sp = math.cos(pitch_rad / 2), math.sin(pitch_rad / 2)
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def matrix(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) body -> world; the length of q does not matter."""
    w, x, y, z = q / math.sqrt(float(np.sum(q * q)))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def euler_rad(q: NDArray[np.float64]) -> tuple[float, float, float]:
    """Roll, pitch, yaw."""
    R = matrix(q)
    roll, yaw = math.atan2(R[2, 1], R[2, 2]), math.atan2(R[1, 0], R[0, 0])
    return roll, -math.asin(min(max(R[2, 0], -1.0), 1.0)), yaw


def gimbal(pan_deg: float, tilt_deg: float) -> NDArray[np.float64]:
    """(3, 3) gimbal -> body: Rz(pan) Ry(-tilt), so pan is positive to the left and tilt positive upwards."""
    return matrix(quaternion(0.0, -math.radians(tilt_deg), math.radians(pan_deg)))
