"""From distances to a surface to what a ray sees of it: density, weights, water. Nothing here is learnt.

Density as VolSDF has it (Yariv et al. 2021, arXiv 2106.12052); water as SeaThru-NeRF has it (Levy et al. 2023, arXiv
2304.07743), where all there is lies at the surface. Distances in metres, positive outside.
"""

from __future__ import annotations

import torch
from torch import Tensor

LEAST_TOTAL = 1e-6  # of weights: a ray that meets nothing has its weights divided by this, not by nothing


def density(sdf_m: Tensor, beta_m: Tensor) -> Tensor:
    """Density [1/m] at these distances: the distribution function of Laplace's law of scale beta, over beta."""
    half = 0.5 * torch.exp(-sdf_m.abs() / beta_m)
    return torch.where(sdf_m > 0, half, 1.0 - half) / beta_m


def ray_weights(sigma: Tensor, step_m: Tensor) -> Tensor:
    """Share (n, s) of what is seen that comes from each piece of a ray, of density (n, s) and length (n, s) or (n, 1).

    They add up to 1: no ray of ours ends in open water, or the lens would have told no distance there.
    """
    opacity = 1.0 - torch.exp(-sigma * step_m)
    clear = torch.cumprod(1.0 - opacity + 1e-10, dim=1)
    before = torch.cat([torch.ones_like(clear[:, :1]), clear[:, :-1]], dim=1)
    weights = opacity * before
    return weights / weights.sum(dim=1, keepdim=True).clamp_min(LEAST_TOTAL)


def through_water(colour: Tensor, range_m: Tensor, direct: Tensor, scatter: Tensor, veil: Tensor) -> Tensor:
    """Light (..., 3) that arrives from surfaces of `colour` (..., 3) at `range_m` (...).

    colour exp(-b_D t) + B_inf (1 - exp(-b_B t)); direct b_D and scatter b_B [1/m], veil B_inf, all (3,).
    """
    t = range_m[..., None]
    return colour * torch.exp(-direct * t) - veil * torch.expm1(-scatter * t)
