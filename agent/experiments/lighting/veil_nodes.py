"""The nodes of both tables of scattered light, drawn by Monte Carlo: of the kernel's along a camera's axis, of the
twin's at a point of the water."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.light.model import single_veil
from agent.core.config import Beam, WaterOptics
from agent.experiments.lighting.monte_carlo import POINT, SURFACE, Medium, Setting, scattered

Array = NDArray[np.float64]
Report = Callable[[int, int], None]

HALF_RAD = math.radians(25.0)

# of the kernel's table
TAU = (0.1, 0.3, 0.6, 1.2, 2.0, 3.0, 4.5, 6.5)  # scattering lengths from camera to target
SHARE = (0.35, 0.55, 0.70, 0.80, 0.90)  # b / (a + b)
ANGLE_DEG = (3.0, 6.0, 12.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0)  # at the target, from camera to lamp
RATIO = (0.25, 0.5, 1.0, 1.5)  # lamp to target over camera to target
DEPTH_M, RADIUS_M = 1.25, 0.07

# of the twin's
POINT_TAU = (0.03, 0.1, 0.25, 0.5, 1.0, 1.75, 2.75, 4.0, 6.0)  # scattering lengths from the lamp
OFF_DEG = (0.0, 15.0, 25.0, 35.0, 50.0, 80.0, 120.0, 180.0)  # off the lamp's axis
WAY_DEG = (0.0, 20.0, 45.0, 75.0, 105.0, 140.0, 180.0)  # of the light that is asked for, off the ray from the lamp
SPIN_DEG = (0.0, 90.0, 180.0)  # of it about that ray; 0: away from the lamp's axis
POINT_SHARE = (0.40, 0.60, 0.75, 0.85)
FADE = 0.35  # of the scattering coefficient: with absorption, about how the scattered light falls off beside 1/r^2


def all_over_single(report: Report) -> tuple[Array, Array]:
    """(8, 5, 9, 4) logarithm of all orders over the kernel's single one, and its standard error."""
    shape = (len(TAU), len(SHARE), len(ANGLE_DEG), len(RATIO))
    found, error = np.zeros(shape), np.zeros(shape)
    nodes = list(product(*map(enumerate, (TAU, SHARE, ANGLE_DEG, RATIO))))
    for n, ((i, tau), (j, share), (k, angle_deg), (m, ratio)) in enumerate(nodes):
        found[i, j, k, m], error[i, j, k, m] = one_node(tau, share, math.radians(angle_deg), ratio, n)
        report(n + 1, len(nodes))
    return found, error


def one_node(
    tau: float, share: float, angle_rad: float, ratio: float, seed: int, most: int = 60
) -> tuple[float, float]:
    """Logarithm of the factor, and its standard error."""
    b = tau / DEPTH_M
    a = b * (1.0 / share - 1.0)
    range_m = ratio * DEPTH_M
    ahead_m, aside_m = DEPTH_M - range_m * math.cos(angle_rad), range_m * math.sin(angle_rad)
    water = WaterOptics(absorption_per_m=(a,) * 3, scattering_per_m=(b,) * 3)
    single = single_veil(DEPTH_M, RADIUS_M, ahead_m, aside_m, water, Beam(intensity_w_sr=1.0))[0]
    drawn = scattered(
        beside(DEPTH_M, RADIUS_M, ahead_m, aside_m), Medium(a, b), orders=12, paths=500, most=most, seed=seed
    )
    return math.log(drawn.total / single), drawn.error / drawn.total


def beside(depth_m: float, radius_m: float, ahead_m: float, aside_m: float) -> Setting:
    """A camera at the origin that looks along z at a ball, and a lamp that aims at it too."""
    range_m = math.hypot(depth_m - ahead_m, aside_m)
    return Setting(
        lamp_m=(aside_m, 0.0, ahead_m),
        aim=(-aside_m / range_m, 0.0, (depth_m - ahead_m) / range_m),
        half_rad=HALF_RAD,
        length_m=depth_m - radius_m,
        ball_m=(0.0, 0.0, depth_m),
        ball_radius_m=radius_m,
    )


def of_points(report: Report, paths: int = 300, most: int = 20) -> tuple[Array, Array, Array, Array]:
    """(4, 9, 8, 7, 3) logarithm of the light of two and more orders that a point of the water sends somewhere, times
    tau^2 and what brings it near to even, for b = 1; and (4, 9, 8) of what arrives scattered at a surface there.
    Then the standard errors of both."""
    volume = np.zeros((len(POINT_SHARE), len(POINT_TAU), len(OFF_DEG), len(WAY_DEG), len(SPIN_DEG)))
    surface = np.zeros(volume.shape[:3])
    volume_error, surface_error = np.zeros(volume.shape), np.zeros(surface.shape)
    nodes = list(product(*map(enumerate, (POINT_SHARE, POINT_TAU, OFF_DEG))))
    for n, ((i, share), (j, tau), (k, off_deg)) in enumerate(nodes):
        medium = Medium(1.0 / share - 1.0, 1.0)
        scale = tau**2 * math.exp((medium.absorption_per_m + FADE) * tau)
        seen = Setting((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), HALF_RAD)
        for what, setting in _asked(seen, tau, math.radians(off_deg)):
            drawn = scattered(
                setting,
                medium,
                SURFACE if what is None else POINT,
                orders=12,
                paths=paths,
                error=0.04,
                most=most,
                seed=n,
            )
            value = math.log(max(drawn.total * scale, 1e-12))
            if what is None:
                surface[i, j, k], surface_error[i, j, k] = value, drawn.error / drawn.total
            else:
                volume[i, j, k, what[0], what[1]] = value
                volume_error[i, j, k, what[0], what[1]] = drawn.error / drawn.total
        report(n + 1, len(nodes))
    return volume, surface, volume_error, surface_error


def _asked(seen: Setting, tau: float, off_rad: float) -> Iterator[tuple[tuple[int, int] | None, Setting]]:
    """A camera's rays through one point, by their nodes; None: the surface that faces the lamp there."""
    sin, cos = math.sin(off_rad), math.cos(off_rad)
    start_m = (tau * sin, 0.0, tau * cos)
    out, away = (sin, 0.0, cos), (cos, 0.0, -sin)  # from the lamp, and from its axis
    yield None, seen._replace(start_m=start_m, way=(-out[0], -out[1], -out[2]))
    for (k, way_deg), (m, spin_deg) in product(enumerate(WAY_DEG), enumerate(SPIN_DEG)):
        way, spin = math.radians(way_deg), math.radians(spin_deg)
        side = (away[0] * math.cos(spin), math.sin(spin), away[2] * math.cos(spin))
        light = tuple(o * math.cos(way) + s * math.sin(way) for o, s in zip(out, side, strict=True))
        yield (k, m), seen._replace(start_m=start_m, way=(-light[0], -light[1], -light[2]))
