"""The tables of light of all orders of scattering: the kernel's along a camera's axis, the twin's at a point of the
water. Drawn by Monte Carlo at nodes, and smoothed.

`python -m tests.studies.veil.tables [kernel] [twin]` makes both, in minutes of one core. The same seeds make the same
tables on one machine.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg

from agent.capabilities.light.model import single_veil
from agent.core.config import Beam, WaterOptics
from tests.places import ROOT
from tests.studies.veil.particles import HALF_RAD, POINT, SURFACE, Array, Medium, Setting, beside, scattered

# --- nodes ---

# Of the kernel's table:
TAU = (0.1, 0.3, 0.6, 1.2, 2.0, 3.0, 4.5, 6.5)  # scattering lengths from camera to target
SHARE = (0.35, 0.55, 0.70, 0.80, 0.90)  # b / (a + b)
ANGLE_DEG = (3.0, 6.0, 12.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0)  # at the target, from camera to lamp
RATIO = (0.25, 0.5, 1.0, 1.5)  # lamp to target over camera to target
DEPTH_M, RADIUS_M = 1.25, 0.07

# Of the twin's table:
POINT_TAU = (0.03, 0.1, 0.25, 0.5, 1.0, 1.75, 2.75, 4.0, 6.0)  # scattering lengths from the lamp
OFF_DEG = (0.0, 15.0, 25.0, 35.0, 50.0, 80.0, 120.0, 180.0)  # off the lamp's axis
WAY_DEG = (0.0, 20.0, 45.0, 75.0, 105.0, 140.0, 180.0)  # of the light that is asked for, off the ray from the lamp
SPIN_DEG = (0.0, 90.0, 180.0)  # of it about that ray; 0: away from the lamp's axis
POINT_SHARE = (0.40, 0.60, 0.75, 0.85)
FADE = 0.35  # of the scattering coefficient: with absorption, about how the scattered light falls off beside 1/r^2


def all_over_single() -> tuple[Array, Array]:
    """(8, 5, 9, 4) logarithm of all orders over the kernel's single one, and its standard error."""
    shape = (len(TAU), len(SHARE), len(ANGLE_DEG), len(RATIO))
    found, error = np.zeros(shape), np.zeros(shape)
    nodes = list(product(*map(enumerate, (TAU, SHARE, ANGLE_DEG, RATIO))))
    for n, ((i, tau), (j, share), (k, angle_deg), (m, ratio)) in enumerate(nodes):
        found[i, j, k, m], error[i, j, k, m] = one_node(tau, share, math.radians(angle_deg), ratio, n)
        report(n + 1, len(nodes))
    return found, error


def one_node(tau: float, share: float, angle_rad: float, ratio: float, seed: int) -> tuple[float, float]:
    """Logarithm of the factor, and its standard error."""
    b = tau / DEPTH_M
    a = b * (1.0 / share - 1.0)
    range_m = ratio * DEPTH_M
    ahead_m, aside_m = DEPTH_M - range_m * math.cos(angle_rad), range_m * math.sin(angle_rad)
    water = WaterOptics(absorption_per_m=(a,) * 3, scattering_per_m=(b,) * 3)
    single = single_veil(DEPTH_M, RADIUS_M, ahead_m, aside_m, water, Beam(intensity_w_sr=1.0))[0]
    setting = beside(DEPTH_M, RADIUS_M, ahead_m, aside_m)
    drawn = scattered(setting, Medium(a, b), orders=12, paths=500, most=60, seed=seed)
    return math.log(drawn.total / single), drawn.error / drawn.total


def of_points() -> tuple[Array, Array, Array, Array]:
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
            asked = SURFACE if what is None else POINT
            drawn = scattered(setting, medium, asked, orders=12, paths=300, error=0.04, most=20, seed=n)
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


def report(done: int, of: int) -> None:
    if done % 50 == 0 or done == of:
        sys.stderr.write(f"\r{done}/{of}")


# --- smoothing: as near to drawn values as their errors ask, and bent as little as that allows ---

BEND = 0.15  # standard deviation of a second difference between neighbours, in the logarithm: what real ones have
ROUNDS = 4000
WORST = 3.0  # errors: what lies further off, counts as that far (Huber), so that an outlier pulls no neighbour along


def smoothed(values: Array, error: Array) -> Array:
    """Least squares of (value - drawn) / error and second differences / BEND along each axis, by conjugate gradients;
    three passes with new weights for outliers."""
    fitted, error = values, np.maximum(error, 0.01)
    for _ in range(3):
        off = np.abs(values - fitted) / error
        trust = np.minimum(1.0, WORST / np.maximum(off, 1e-9)) / error**2
        fitted = _solved(values, trust)
    return fitted


def _solved(values: Array, trust: Array) -> Array:
    def apply(x: Array) -> Array:
        x = x.reshape(values.shape)
        return (trust * x + _bending(x) / BEND**2).ravel()

    system = LinearOperator((values.size, values.size), apply, dtype=np.float64)
    found, _ = cg(system, (trust * values).ravel(), values.ravel(), rtol=1e-9, maxiter=ROUNDS)
    return np.asarray(found).reshape(values.shape)


def _bending(x: Array) -> Array:
    """The second differences' transpose times themselves, along each axis of three nodes or more."""
    total = np.zeros_like(x)
    for axis in range(x.ndim):
        if x.shape[axis] < 3:
            continue
        second = np.diff(x, 2, axis=axis)
        pad = [(0, 0)] * x.ndim
        for shift, factor in ((0, 1.0), (1, -2.0), (2, 1.0)):
            pad[axis] = (shift, 2 - shift)
            total += factor * np.pad(second, pad)
    return total


# --- the tables as files ---

KERNEL = ROOT / "agent/capabilities/light/veil_table.py"
TWIN = ROOT / "hw/twin/optics/scattered.txt"

KERNEL_HEAD = '''"""Veil of all orders of scattering over that of one, as logarithms.

Made by `python -m tests.studies.veil.tables kernel`.

Beam of 25 degrees, a black ball of 70 mm at 1.25 m. Monte Carlo to a standard error of 5 %, then smoothed.
Order of the axes: TAU, SCATTERING_SHARE, ANGLE_DEG, RATIO; a line holds the ratios of three angles.
"""

'''
TWIN_HEAD = """# Light that the water around a lamp scatters.
# Made by `python -m tests.studies.veil.tables twin`.
# Five axes: b / (a + b), scattering lengths from the lamp, degrees off its axis, degrees of the light's way off the ray
# from it, degrees of that about the ray. Then logarithms: (5 axes) of light of two and more orders in all directions;
# (first 3 axes) of scattered light on a surface that faces the lamp.
"""


def write_kernel(found: Array, error: Array, path: Path = KERNEL) -> None:
    numbers = smoothed(found, error).reshape(-1)
    names = ("TAU", "SCATTERING_SHARE", "ANGLE_DEG", "RATIO")
    axes = (TAU, SHARE, ANGLE_DEG, RATIO)
    lines = [f"{name} = {axis}" for name, axis in zip(names, axes, strict=True)]
    rows = [", ".join(f"{x:.3f}" for x in numbers[i : i + 12]) for i in range(0, len(numbers), 12)]
    lines += ["# fmt: off", "LOG_TIMES = (", *(f"    {row}," for row in rows), ")", "# fmt: on"]
    path.write_text(KERNEL_HEAD + "\n".join(lines) + "\n", "ascii")


def write_twin(volume: Array, surface: Array, errors: tuple[Array, Array], path: Path = TWIN) -> None:
    names = ("share", "tau", "off_deg", "way_deg", "spin_deg")
    axes = (POINT_SHARE, POINT_TAU, OFF_DEG, WAY_DEG, SPIN_DEG)
    lines = [" ".join([name, *(f"{x:g}" for x in axis)]) for name, axis in zip(names, axes, strict=True)]
    for values, error in zip((volume, surface), errors, strict=True):
        numbers = smoothed(values, error).reshape(-1)
        lines += [" ".join(f"{x:.3f}" for x in numbers[i : i + 21]) for i in range(0, len(numbers), 21)]
    path.write_text(TWIN_HEAD + "\n".join(lines) + "\n", "ascii")


def main(which: Sequence[str]) -> None:
    if not which or "kernel" in which:
        write_kernel(*all_over_single())
    if not which or "twin" in which:
        volume, surface, *errors = of_points()
        write_twin(volume, surface, (errors[0], errors[1]))


if __name__ == "__main__":
    main(sys.argv[1:])
