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
    step = (far_m - near_m) / offsets.shape[1]
    t = near_m[:, None] + (torch.arange(offsets.shape[1], device=offsets.device) + offsets) * step[:, None]
    return _mean(field, rays, t, step[:, None])


def search(field: Field, rays: Rays, offsets: Tensor, fine: int) -> Seen:
    """What rays see of a field of which nobody knows where its surface is: samples in equal pieces of the whole way,
    one at each of `offsets` (n, s), tell where to take `fine` more, and these count."""
    far_m = leaving(field, rays)
    step = ((far_m - NEAREST_M) / offsets.shape[1])[:, None]
    with torch.no_grad():
        coarse = NEAREST_M + (torch.arange(offsets.shape[1], device=offsets.device) + offsets) * step
        weights = ray_weights(density(_distance(field, rays, coarse), field.beta_m), step) + 1e-4
        share = torch.cumsum(weights, dim=1) / weights.sum(dim=1, keepdim=True)
        wanted = (torch.arange(fine, device=offsets.device) + offsets[:, :fine]) / fine
        piece = torch.searchsorted(share, wanted.contiguous()).clamp_max(offsets.shape[1] - 1)
        before = torch.cat([torch.zeros_like(share[:, :1]), share[:, :-1]], dim=1).gather(1, piece)
        within = ((wanted - before) / (share.gather(1, piece) - before).clamp_min(1e-9)).clamp(0.0, 1.0)
        t = NEAREST_M + (piece + within) * step
        gaps = torch.diff(t, dim=1, append=far_m[:, None]).clamp_max(float(step.max()))
    return _mean(field, rays, t, gaps)


def _distance(field: Field, rays: Rays, t: Tensor) -> Tensor:
    return field.distance(_places(rays, t).reshape(-1, 3)).reshape(t.shape)


def _places(rays: Rays, t: Tensor) -> Tensor:
    return rays.origin_m[:, None] + t[..., None] * rays.toward[:, None]


def _mean(field: Field, rays: Rays, t: Tensor, step_m: Tensor) -> Seen:
    """Over samples at t (n, s), pieces of length step_m (n, s) or (n, 1), by their weights."""
    weights = ray_weights(density(_distance(field, rays, t), field.beta_m), step_m)
    counts = weights.detach() > NEGLIGIBLE
    row, piece = torch.nonzero(counts, as_tuple=True)
    there = field.seen(field.colour(_places(rays, t)[row, piece]), t[row, piece])
    sums = torch.zeros((len(t), 3), dtype=there.dtype, device=there.device)
    sums = sums.index_add(0, row, weights[row, piece, None] * there)
    total = torch.where(counts, weights, 0.0).sum(dim=1).clamp_min(NEGLIGIBLE)
    return Seen(sums / total[:, None], (weights * t).sum(dim=1))


def depth(rays: Rays, range_m: Tensor) -> Tensor:
    """Depth (n,) from the pivot along the axis."""
    return rays.ahead_m + range_m * rays.forward
