"""What is learnt: distances on a grid, colours as products of planes and lines, the water, and beta.

Colours are three sums of rank 16 (TensoRF's vector and matrix factors, Chen et al. 2022, arXiv 2203.09517), read by a
small network. All of it lives on one device, whichever it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from agent.reconstruction.field.density import through_water

RANK = 16
HIDDEN = 32
START_BETA_M, LEAST_BETA_M, MOST_BETA_M = 4e-3, 1.2e-3, 10e-3
PLANE_NOISE, LINE_NOISE = 0.1, 0.2  # of the start; lines begin about 1, so that a plane first reaches all along them
COLOUR_BIAS = -1.0  # softplus of it is 0.31, the middle of a picture in linear light
START_WATER = (0.10, 0.15, 0.05)  # b_D, b_B [1/m], B_inf: clear water
AXES = ((0, 1, 2), (0, 2, 1), (1, 2, 0))  # the two of each plane, and that of its line


class Box(NamedTuple):
    """A grid of points with a value each; the first is at `origin_m`, neighbours are `cell_m` apart."""

    origin_m: tuple[float, float, float]
    cell_m: float
    sdf_m: NDArray[np.float32]  # (nx, ny, nz) positive outside

    @property
    def size_m(self) -> tuple[float, float, float]:
        nx, ny, nz = self.sdf_m.shape
        return (nx - 1) * self.cell_m, (ny - 1) * self.cell_m, (nz - 1) * self.cell_m


class Field(nn.Module):
    """Distances, colours and water of one scene, as functions of places (n, 3) in the world."""

    def __init__(self, start: Box, plane_m: float, line_m: float, seed: int) -> None:
        super().__init__()
        made = torch.Generator().manual_seed(seed)
        self.origin_m: Tensor
        self.size_m: Tensor
        self.register_buffer("origin_m", torch.tensor(start.origin_m, dtype=torch.float32))
        self.register_buffer("size_m", torch.tensor(start.size_m, dtype=torch.float32))
        self.sdf_m = nn.Parameter(torch.from_numpy(np.ascontiguousarray(start.sdf_m, np.float32))[None, None])
        planes, lines = [], []
        for a, b, c in AXES:
            rows, cols = (max(2, math.ceil(start.size_m[k] / plane_m) + 1) for k in (a, b))
            along = max(2, math.ceil(start.size_m[c] / line_m) + 1)
            planes.append(nn.Parameter(PLANE_NOISE * torch.randn((1, RANK, rows, cols), generator=made)))
            lines.append(nn.Parameter(1.0 + LINE_NOISE * torch.randn((1, RANK, along, 1), generator=made)))
        self.planes, self.lines = nn.ParameterList(planes), nn.ParameterList(lines)
        self.inner = nn.Linear(3 * RANK, HIDDEN)
        self.outer = nn.Linear(HIDDEN, 3)
        with torch.no_grad():
            for layer in (self.inner, self.outer):
                bound = math.sqrt(6.0 / layer.in_features)
                layer.weight.copy_((2.0 * torch.rand(layer.weight.shape, generator=made) - 1.0) * bound)
                layer.bias.zero_()
            self.outer.bias.fill_(COLOUR_BIAS)
        # Softplus of these is what counts: coefficients of water are positive.
        raw = [math.log(math.expm1(value)) for value in START_WATER]
        self.water = nn.Parameter(torch.tensor(raw)[:, None].repeat(1, 3))
        self.log_beta = nn.Parameter(torch.tensor(math.log(START_BETA_M)))

    @property
    def beta_m(self) -> Tensor:
        """Width of the density about the surface."""
        return self.log_beta.clamp(math.log(LEAST_BETA_M), math.log(MOST_BETA_M)).exp()

    def unit(self, places_m: Tensor) -> Tensor:
        """Places (..., 3) in the box's own terms, -1 to 1 from side to side."""
        return (places_m - self.origin_m) / self.size_m * 2.0 - 1.0

    def distance(self, places_m: Tensor) -> Tensor:
        """Signed distance (n,) to the surface; beyond the box as at its nearest side."""
        grid = self.unit(places_m).flip(-1)[None, None, None]
        return _sample(self.sdf_m, grid)[0, 0, 0, 0]

    def colour(self, places_m: Tensor) -> Tensor:
        """Linear light (n, 3), red green blue, that leaves the surface there, as it would arrive without water."""
        unit, parts = self.unit(places_m), []
        for (a, b, c), plane, line in zip(AXES, self.planes, self.lines, strict=True):
            on_plane = _sample(plane, unit[:, (b, a)][None, None])[0, :, 0]
            along = torch.stack([torch.zeros_like(unit[:, c]), unit[:, c]], dim=-1)
            parts.append(on_plane * _sample(line, along[None, None])[0, :, 0])
        features = torch.cat(parts).T
        return functional.softplus(self.outer(torch.relu(self.inner(features))))

    def seen(self, colour: Tensor, range_m: Tensor) -> Tensor:
        """What arrives (..., 3) through so much water (...)."""
        direct, scatter, veil = functional.softplus(self.water)
        return through_water(colour, range_m, direct, scatter, veil)


def _sample(values: Tensor, grid: Tensor) -> Tensor:
    return functional.grid_sample(values, grid, mode="bilinear", padding_mode="border", align_corners=True)
