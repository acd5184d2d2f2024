"""Where rays meet the field's surface, and what they see about it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from agent.reconstruction.field.density import density, ray_weights
from agent.reconstruction.field.rays import Rays
from agent.reconstruction.field.volume import Field

NEAREST_M = 0.03  # no surface is nearer: the port and what is before it
STRIDE, LEAST_STRIDE_M = 0.9, 2e-3  # share of the distance that a step may go, and how far it goes at least
HIT_M = 1.5e-3
NEGLIGIBLE = 0.003  # weight of a sample below which its colour is not asked for: a hundredth of a tone at most


class Seen(NamedTuple):
    """What rays (n,) see."""

    colour: Tensor  # (n, 3) linear light
    range_m: Tensor  # (n,) along the ray, mean over its samples' weights


@torch.no_grad()
def trace(field: Field, rays: Rays, start_m: Tensor, rounds: int) -> Tensor:
    """Range (n,) at which each ray meets the surface, going on from `start_m` (n,), or where it leaves the box."""
    leave = leaving(field, rays)
    t = torch.minimum(start_m, leave)
    for _ in range(rounds):
        s = field.distance(rays.origin_m + t[:, None] * rays.toward)
        t = torch.where(s < HIT_M, t, torch.minimum(t + STRIDE * s.clamp_min(LEAST_STRIDE_M), leave))
    return t


def leaving(field: Field, rays: Rays) -> Tensor:
    """Range (n,) at which rays that begin in the box leave it; NEAREST_M at least."""
    low, high = field.origin_m, field.origin_m + field.size_m
    side = torch.where(rays.toward > 0, high, low)
    across = (side - rays.origin_m) / torch.where(rays.toward.abs() < 1e-9, 1e-9, rays.toward)
    return across.amin(dim=1).clamp_min(NEAREST_M)


def look(field: Field, rays: Rays, near_m: Tensor, far_m: Tensor, offsets: Tensor) -> Seen:
    """Sample rays between near and far (n,), one sample in each of as many equal pieces as `offsets` (n, s) has.

    offsets: place of each sample within its piece, 0 to 1.
    """
    n, pieces = offsets.shape
    step = (far_m - near_m) / pieces
    t = near_m[:, None] + (torch.arange(pieces, device=offsets.device) + offsets) * step[:, None]
    places = rays.origin_m[:, None] + t[..., None] * rays.toward[:, None]
    sdf = field.distance(places.reshape(-1, 3)).reshape(n, pieces)
    weights = ray_weights(density(sdf, field.beta_m), step[:, None])
    row, piece = torch.nonzero(weights.detach() > NEGLIGIBLE, as_tuple=True)
    there = field.seen(field.colour(places[row, piece].detach()), t[row, piece])
    colour = torch.zeros((n, 3), dtype=there.dtype, device=there.device).index_add(0, row, weights[row, piece, None] * there)
    kept = torch.where(weights.detach() > NEGLIGIBLE, weights, 0.0)
    total = kept.sum(dim=1).clamp_min(NEGLIGIBLE)
    return Seen(colour / total[:, None], (weights * t).sum(dim=1))


def depth(rays: Rays, range_m: Tensor) -> Tensor:
    """Depth (n,) from the pivot along the axis."""
    return rays.ahead_m + range_m * rays.forward
