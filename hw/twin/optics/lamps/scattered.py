"""Light that particles scatter: once, by the phase function, and more often, by a table that a Monte Carlo has filled.

What goes less than 5 degrees aside is taken as going straight on: for the veil it makes no difference, and what is
left is smooth. The table (scattered.txt) is of one lamp in open water, for b = 1 and by what share of the attenuation
scattering is; any water's lengths are counted in its scattering lengths.
"""

from __future__ import annotations

import math
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

INDEX, SLOPE = 1.10, 3.5835  # Fournier-Forand: 0.018 of it goes back, Petzold's mean
STRAIGHT_RAD = math.radians(5.0)
SINES = 2048  # of the phase table, by the sine of half the angle

RANGE_STEP_M, RANGES = 0.02, 200  # of the table of points
SURFACE_STEP_M, SURFACES = 0.004, 1000  # of that of surfaces, which is so fine that a pixel takes the nearest range
OFFS, WAYS, SPINS = (
    17,
    13,
    3,
)  # off the axis and of the light's way, even in the sine of half the angle; cosine of the spin
FADE = 0.35  # as the table's maker has it


class Nodes(NamedTuple):
    """scattered.txt: logarithms, times tau^2 exp((a/b + FADE) tau)."""

    share: Array  # (s,) b / (a + b)
    tau: Array  # (t,)
    off_deg: Array
    way_deg: Array
    spin_deg: Array
    volume: Array  # (s, t, off, way, spin)
    surface: Array  # (s, t, off)


class Scattering(NamedTuple):
    """One water, three colours, float32."""

    phase: Floats  # (SINES,) per steradian, of what does not go straight on
    scatter: Floats  # (3,) 1/m, of the same
    extinct: Floats  # (3,) 1/m, its attenuation
    volume: Floats  # (RANGES, OFFS, WAYS, SPINS, 3) r^2 times light of two and more orders, per m and W/sr
    surface: Floats  # (SURFACES, OFFS, 3) r^2 times scattered light on a surface that faces the lamp, per W/sr


def phase(angle_rad: Array) -> Array:
    """(n,) share of scattered light per steradian."""
    nu, k = (3 - SLOPE) / 2, 4 / (3 * (INDEX - 1) ** 2)
    sine2 = np.sin(angle_rad / 2) ** 2
    d = k * sine2
    d = np.where(np.abs(d - 1) < 1e-5, 1 + 1e-5, d)
    v = d**nu
    near = (nu * (1 - d) - (1 - v) + (d * (1 - v) - nu * (1 - d)) / sine2) / (4 * np.pi * (1 - d) ** 2 * v)
    v180 = k**nu
    return np.asarray(near + (1 - v180) / (16 * np.pi * (k - 1) * v180) * (3 * np.cos(angle_rad) ** 2 - 1))


@lru_cache(maxsize=1)
def deflected() -> float:
    """Share of scattering that goes more than STRAIGHT_RAD aside."""
    edge = np.linspace(STRAIGHT_RAD, np.pi, 20_001)
    middle = (edge[1:] + edge[:-1]) / 2
    return float((2 * np.pi * np.sin(middle) * phase(middle)).sum() * (edge[1] - edge[0]))


@lru_cache(maxsize=1)
def read_nodes() -> Nodes:
    lines = (resources.files("hw.twin.optics.lamps") / "scattered.txt").read_text("ascii").splitlines()
    rows = [line.split() for line in lines if line and not line.startswith("#")]
    axes = [np.array(row[1:], float) for row in rows[:5]]
    sizes = [len(axis) for axis in axes]
    numbers = np.array([number for row in rows[5:] for number in row], float)
    split = int(np.prod(sizes))
    share, tau, off_deg, way_deg, spin_deg = axes
    return Nodes(
        share, tau, off_deg, way_deg, spin_deg, numbers[:split].reshape(sizes), numbers[split:].reshape(sizes[:3])
    )


def scattering(
    absorption_per_m: tuple[float, ...], scattering_per_m: tuple[float, ...], orders: bool = True
) -> Scattering:
    """The tables of one water. orders=False: once scattered light alone, attenuated in full, for who compares."""
    a, b = np.array(absorption_per_m, float), np.array(scattering_per_m, float)
    kept = deflected() if orders else 1.0
    angle = 2 * np.arcsin(np.linspace(0, 1, SINES))
    shape = phase(np.maximum(angle, STRAIGHT_RAD if orders else 1e-3)) / kept
    volume, surface = (
        _of_water(read_nodes(), a, b)
        if orders
        else (np.zeros((RANGES, OFFS, WAYS, SPINS, 3)), np.zeros((RANGES, OFFS, 3)))
    )
    return Scattering(*(np.ascontiguousarray(x, np.float32) for x in (shape, kept * b, a + kept * b, volume, surface)))


def _of_water(nodes: Nodes, a: Array, b: Array) -> tuple[Array, Array]:
    """Both tables over range in metres and sines of half angles, from those over scattering lengths and angles."""
    range_m = np.maximum(np.arange(RANGES), 1) * RANGE_STEP_M
    finely_m = np.maximum(np.arange(SURFACES), 1) * SURFACE_STEP_M
    off = np.degrees(2 * np.arcsin(np.linspace(0, 1, OFFS)))
    way = np.degrees(2 * np.arcsin(np.linspace(0, 1, WAYS)))
    volume, surface = np.empty((RANGES, OFFS, WAYS, SPINS, 3)), np.empty((SURFACES, OFFS, 3))
    for c in range(3):
        at_share = nodes.share, b[c] / (a[c] + b[c])
        decay = a[c] + FADE * b[c]
        of = _along(_along(nodes.surface, *at_share)[0], np.log(nodes.tau), np.log(b[c] * finely_m))
        surface[..., c] = np.exp(_along(of, nodes.off_deg, off, axis=1) - decay * finely_m[:, None])
        of = _along(_along(nodes.volume, *at_share)[0], np.log(nodes.tau), np.log(b[c] * range_m))
        of = _along(_along(of, nodes.off_deg, off, axis=1), nodes.way_deg, way, axis=2)
        # for b = 1 it is per scattering length and squared one; r^2 is taken out, a length is left
        volume[..., c] = np.exp(of - decay * range_m[:, None, None, None]) * b[c]
    return volume, surface


def _along(values: Array, nodes: Array, x: Array | float, axis: int = 0) -> Array:
    """Linear interpolation along one axis; the ends hold beyond them."""
    at = np.clip(np.atleast_1d(np.asarray(x, float)), nodes[0], nodes[-1])
    i = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    part = (at - nodes[i]) / (nodes[i + 1] - nodes[i])
    shape = [1] * values.ndim
    shape[axis] = len(at)
    part = part.reshape(shape)
    return np.asarray(np.take(values, i, axis) * (1 - part) + np.take(values, i + 1, axis) * part)
